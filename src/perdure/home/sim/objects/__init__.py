"""The ten YCB objects of the benchmark as MuJoCo bodies that stand, tip, roll and come to rest.

Contents:
    KINDS, Kind     sizes, masses, shapes and friction
    short_name      a YCB name without its number
    Placement       where an object lies
    YcbObjects      boxes of the kinds, and how to add an object to a model
    AppleShape      collision shape of the apple
    OBJECT_BIT      collision bit that all objects share
"""

from perdure.home.sim.objects.kinds import KINDS, Kind, short_name
from perdure.home.sim.objects.placement import Placement
from perdure.home.sim.objects.shapes import AppleShape
from perdure.home.sim.objects.ycb import OBJECT_BIT, YcbObjects

__all__ = ["KINDS", "OBJECT_BIT", "AppleShape", "Kind", "Placement", "YcbObjects", "short_name"]
