"""Where skills begin in training, one file each, and the episodes they begin in.

Contents:
    STARTS                  a skill's name to its draw(episode, target, rng) -> Start
    ANY_HEADING             the same where half the robots face any way
    begin, put, touching    draws until the robot has room, and brings a lane there
    train_pool              generated episodes of the split `train`, kept in the user's cache
"""

from perdure.home.skills.starts import close_drawer, close_fridge, navigate, open_drawer, open_fridge, pick, place
from perdure.home.skills.starts.pool import cache_folder, train_pool
from perdure.home.skills.starts.start import Draw, Start, begin, put, touching

STARTS: dict[str, Draw] = {
    "pick": pick.draw,
    "place": place.draw,
    "open_drawer": open_drawer.draw,
    "close_drawer": close_drawer.draw,
    "open_fridge": open_fridge.draw,
    "close_fridge": close_fridge.draw,
    "navigate": navigate.draw,
}
"""Start distributions by the skill's name."""
ANY_HEADING: dict[str, Draw] = {"place": place.draw_any_heading}
"""Wider ones to learn from."""

__all__ = ["ANY_HEADING", "STARTS", "Draw", "Start", "begin", "cache_folder", "put", "touching", "train_pool"]
