"""The ten YCB objects of the benchmark as MuJoCo bodies that stand, tip, roll and come to rest.

Contents:
    KINDS, Kind     sizes, masses, shapes and friction
    YcbObjects      boxes of the kinds, and how to add an object to a model
"""

from perdure.home.objects.kinds import KINDS, Kind
from perdure.home.objects.ycb import YcbObjects

__all__ = ["KINDS", "Kind", "YcbObjects"]
