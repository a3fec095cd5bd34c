"""Pictures, films and a live view of a running world.

Contents:
    render_lane, Studio                             pictures of a lane
    goal_marks                                      marks of targets and goals in them
    film_episode, contact_sheet, FilmOptions        an episode that the oracle runs
    film_side_by_side, make_agent, Agent            an episode under several release strategies
    read_failures, sample_failures, Failure         failed episodes of logs
    logged_agent, replay_failure, Replay            their replay
    failure_sheet                                   eight pictures that show the cause of a failure
    save_picture                                    a picture as a file
    serve_episode                                   an episode live in a browser
"""

from perdure.home.video.browser import serve_episode
from perdure.home.video.failure_sheets import failure_sheet
from perdure.home.video.files import save_picture
from perdure.home.video.film import FilmOptions, contact_sheet, film_episode
from perdure.home.video.marks import goal_marks
from perdure.home.video.replay import Failure, Replay, logged_agent, read_failures, replay_failure, sample_failures
from perdure.home.video.side_by_side import Agent, film_side_by_side, make_agent
from perdure.home.video.studio import Studio, render_lane

__all__ = [
    "Agent",
    "Failure",
    "FilmOptions",
    "Replay",
    "Studio",
    "contact_sheet",
    "failure_sheet",
    "film_episode",
    "film_side_by_side",
    "goal_marks",
    "logged_agent",
    "make_agent",
    "read_failures",
    "render_lane",
    "replay_failure",
    "sample_failures",
    "save_picture",
    "serve_episode",
]
