"""Names of release strategies in logs: the strategy, and settings that differ from the default world."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any, get_args

from perdure.home.errors import HomeError
from perdure.home.evaluate.execute import ExecutorOptions
from perdure.home.evaluate.protocol.release_choice import read_release
from perdure.home.sim.objects import AppleShape
from perdure.home.sim.world import Jaws, Rolling

USUAL = ExecutorOptions()
_JAWS: dict[str, Jaws] = {f"jaws-{each}": each for each in get_args(Jaws)}
_SCENE: dict[str, tuple[str, Any]] = {
    **{each: ("rolling", each) for each in get_args(Rolling)},
    **{f"{each}-apple": ("apple", each) for each in get_args(AppleShape)},
    "base-velocity-removed": ("release_velocity", "base-removed"),
    "released-at-zero-velocity": ("release_velocity", "zero"),
    "no-clutter": ("clutter", False),
    "no-sleep": ("sleep", False),
}
"""Word in a name: field of `SceneOptions` and its value."""


def strategy_name(place: str, options: ExecutorOptions) -> str:
    """`place`, then what is unusual: `ik`, `ik drag`, `rl jaws-apart drag 240-hz`."""
    scene, words = options.scene, [place]
    words += [f"jaws-{options.jaws}"] if options.jaws != USUAL.jaws else []
    words += [
        word for word, (name, value) in _SCENE.items() if getattr(scene, name) == value != getattr(USUAL.scene, name)
    ]
    words += [f"{scene.physics_hz}-hz"] if scene.physics_hz != USUAL.scene.physics_hz else []
    return " ".join(words)


@lru_cache(maxsize=64)
def read_strategy(name: str) -> tuple[str, ExecutorOptions]:
    """`place` and the world's settings from a name that `strategy_name` made; HomeError when it made none."""
    place, *words = name.split(" ")
    options = USUAL
    try:
        for word in words:
            if word in _SCENE:
                options = replace(options, scene=replace(options.scene, **dict([_SCENE[word]])))
            elif word in _JAWS:
                options = replace(options, jaws=_JAWS[word])
            elif (hertz := word.removesuffix("-hz")).isascii() and hertz.isdecimal():
                options = replace(options, scene=replace(options.scene, physics_hz=int(hertz)))
        read_release(place)
    except HomeError:
        place = ""
    if not place or strategy_name(place, options) != name:
        raise HomeError(
            f"{name!r} is no release strategy of this package: these are rl, stop, ik, ik+, delta-N or delta-N-in-M, "
            f"then jaws-apart, drag, hull-apple, base-velocity-removed or released-at-zero-velocity, no-clutter, "
            f"no-sleep and N-hz (120 or more, a multiple of 30) where they were chosen"
        )
    return place, options
