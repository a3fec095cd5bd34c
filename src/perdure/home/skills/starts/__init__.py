"""Parts of start states that skills share, and the training episodes.

Contents:
    Start, Draw, begin, put, touching         a start state; draws one without contacts, brings a lane to it
    stand_near, stand_in, stand_anywhere      where the robot stands
    draw_arm                                  how it holds its arm
    draw_open, carried, front_frame, ...      drawers and the fridge
    cache_folder, train_pool                  generated episodes of the split `train`, kept in the user's cache
"""

from perdure.home.skills.starts.arm import draw_arm
from perdure.home.skills.starts.containers import (
    DRAWER_OPEN,
    carried,
    draw_open,
    front_frame,
    front_of,
    handle,
    is_drawer,
    link_number,
    needed_container,
    open_links,
)
from perdure.home.skills.starts.pool import cache_folder, train_pool
from perdure.home.skills.starts.stand import Rectangle, stand_anywhere, stand_in, stand_near
from perdure.home.skills.starts.start import Draw, Start, begin, put, touching

__all__ = [
    "DRAWER_OPEN",
    "Draw",
    "Rectangle",
    "Start",
    "begin",
    "cache_folder",
    "carried",
    "draw_arm",
    "draw_open",
    "front_frame",
    "front_of",
    "handle",
    "is_drawer",
    "link_number",
    "needed_container",
    "open_links",
    "put",
    "stand_anywhere",
    "stand_in",
    "stand_near",
    "touching",
    "train_pool",
]
