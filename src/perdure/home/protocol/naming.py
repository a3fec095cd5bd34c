"""How logs and figures call an arm: how objects are placed, and what differs from the usual world."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import get_args

from perdure.home.errors import HomeError
from perdure.home.execute import ExecutorOptions
from perdure.home.protocol.placing import placing
from perdure.home.world import Jaws, Rolling

USUAL = ExecutorOptions()
_ROLLING: dict[str, Rolling] = {each: each for each in get_args(Rolling)}
_JAWS: dict[str, Jaws] = {f"jaws-{each}": each for each in get_args(Jaws)}


def arm_name(place: str, options: ExecutorOptions) -> str:
    """`place`, then what is unusual: `ik`, `ik drag`, `rl jaws-apart drag 240-hz`."""
    scene, words = options.scene, [place]
    words += [f"jaws-{options.jaws}"] if options.jaws != USUAL.jaws else []
    words += [scene.rolling] if scene.rolling != USUAL.scene.rolling else []
    words += [f"{scene.physics_hz}-hz"] if scene.physics_hz != USUAL.scene.physics_hz else []
    return " ".join(words)


@lru_cache(maxsize=64)
def read_arm(name: str) -> tuple[str, ExecutorOptions]:
    """`place` and the world's settings from a name that `arm_name` made; HomeError when it made none."""
    place, *words = name.split(" ")
    options = USUAL
    for word in words:
        if word in _ROLLING:
            options = replace(options, scene=replace(options.scene, rolling=_ROLLING[word]))
        elif word in _JAWS:
            options = replace(options, jaws=_JAWS[word])
        elif (hertz := word.removesuffix("-hz")).isdigit() and int(hertz) > 0:
            options = replace(options, scene=replace(options.scene, physics_hz=int(hertz)))
    try:
        placing(place)
    except HomeError:
        place = ""
    if not place or arm_name(place, options) != name:
        raise HomeError(
            f"{name!r} is no arm of this package: these are rl, stop, ik, ik+, delta-N or delta-N-in-M, "
            f"then jaws-apart, drag and N-hz where they were chosen"
        )
    return place, options
