"""Pictures, films and a live view of a running world.

Contents:
    render_lane, Studio                         pictures of a lane
    goal_marks                                  what to point at in them
    film_episode, contact_sheet, FilmOptions    an episode that the oracle runs
    film_beside, make_take, Take                an episode under several placing arms, side by side
    read_failures, draw, Failure                failed episodes of logs
    take_again, run_again, Replay               the same, run again
    failure_sheet                               eight pictures of what the label of one is about
    save_picture                                as a file
    serve_episode                               live, in a browser
"""

from perdure.home.video.beside import Take, film_beside, make_take
from perdure.home.video.browser import serve_episode
from perdure.home.video.failures import failure_sheet
from perdure.home.video.files import save_picture
from perdure.home.video.film import FilmOptions, contact_sheet, film_episode
from perdure.home.video.marks import goal_marks
from perdure.home.video.replay import Failure, Replay, draw, read_failures, run_again, take_again
from perdure.home.video.studio import Studio, render_lane

__all__ = [
    "Failure",
    "FilmOptions",
    "Replay",
    "Studio",
    "Take",
    "contact_sheet",
    "draw",
    "failure_sheet",
    "film_beside",
    "film_episode",
    "goal_marks",
    "make_take",
    "read_failures",
    "render_lane",
    "run_again",
    "save_picture",
    "serve_episode",
    "take_again",
]
