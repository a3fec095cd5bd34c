"""Names of release strategies in logs: the strategy, and settings that differ from the default world."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import get_args

from perdure.home.errors import HomeError
from perdure.home.evaluate.execute import ExecutorOptions
from perdure.home.evaluate.protocol.release_choice import read_release
from perdure.home.sim.objects import AppleShape
from perdure.home.sim.world import Jaws, ReleaseVelocity, Rolling

USUAL = ExecutorOptions()
_ROLLING: dict[str, Rolling] = {each: each for each in get_args(Rolling)}
_APPLE: dict[str, AppleShape] = {f"{each}-apple": each for each in get_args(AppleShape)}
_RELEASE: dict[str, ReleaseVelocity] = {"base-velocity-removed": "base-removed", "released-at-zero-velocity": "zero"}
_JAWS: dict[str, Jaws] = {f"jaws-{each}": each for each in get_args(Jaws)}


def strategy_name(place: str, options: ExecutorOptions) -> str:
    """`place`, then what is unusual: `ik`, `ik drag`, `rl jaws-apart drag 240-hz`."""
    scene, words = options.scene, [place]
    words += [f"jaws-{options.jaws}"] if options.jaws != USUAL.jaws else []
    words += [scene.rolling] if scene.rolling != USUAL.scene.rolling else []
    words += [f"{scene.apple}-apple"] if scene.apple != USUAL.scene.apple else []
    words += [word for word, each in _RELEASE.items() if each == scene.release_velocity]
    words += [f"{scene.physics_hz}-hz"] if scene.physics_hz != USUAL.scene.physics_hz else []
    return " ".join(words)


@lru_cache(maxsize=64)
def read_strategy(name: str) -> tuple[str, ExecutorOptions]:
    """`place` and the world's settings from a name that `strategy_name` made; HomeError when it made none."""
    place, *words = name.split(" ")
    options = USUAL
    for word in words:
        if word in _ROLLING:
            options = replace(options, scene=replace(options.scene, rolling=_ROLLING[word]))
        elif word in _APPLE:
            options = replace(options, scene=replace(options.scene, apple=_APPLE[word]))
        elif word in _RELEASE:
            options = replace(options, scene=replace(options.scene, release_velocity=_RELEASE[word]))
        elif word in _JAWS:
            options = replace(options, jaws=_JAWS[word])
        elif (hertz := word.removesuffix("-hz")).isdigit() and int(hertz) > 0:
            options = replace(options, scene=replace(options.scene, physics_hz=int(hertz)))
    try:
        read_release(place)
    except HomeError:
        place = ""
    if not place or strategy_name(place, options) != name:
        raise HomeError(
            f"{name!r} is no release strategy of this package: these are rl, stop, ik, ik+, delta-N or delta-N-in-M, "
            f"then jaws-apart, drag, hull-apple, base-velocity-removed or released-at-zero-velocity, "
            f"and N-hz where they were chosen"
        )
    return place, options
