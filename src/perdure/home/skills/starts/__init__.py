"""Parts of start states that skills share, and the training episodes.

Contents:
    Start, Draw, begin, put, touching   a start state; draws one without contacts, brings a lane to it
    cache_folder, train_pool            generated episodes of the split `train`, kept in the user's cache
    stand, arm, containers              modules: where the robot stands, how it holds its arm, what is open
"""

from perdure.home.skills.starts.pool import cache_folder, train_pool
from perdure.home.skills.starts.start import Draw, Start, begin, put, touching

__all__ = ["Draw", "Start", "begin", "cache_folder", "put", "touching", "train_pool"]
