"""``perdure watch``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from perdure.cli.clocks import read_clock
from perdure.cli.parse import parse


@dataclass(frozen=True)
class WatchFlags:
    """Film a policy as it fails. Needs the extra perdure[film].

    EnvPool cannot render. The film, and the search for a failure, use Gymnasium's environment of the same name, on
    another build of MuJoCo.
    """

    policy: tyro.conf.Positional[str]
    """A policy file, or the name of a shipped policy."""
    clock: str | None = None
    """Clock of the policy: constant:0, periodic:500, countdown:1000, countdown (to the end), or default (its own
    clock), which is used if left out."""
    until_failure: bool = False
    """Film the first failure: 5 s before it and 1 s after it. Otherwise film the first 6 s."""
    beside: str | None = None
    """A second clock, such as constant:500, from the same start state: two films side by side."""
    out: Path = Path("film.mp4")
    """The film: .mp4 or .gif."""
    steps: int = 10_000
    """Steps of each episode, unless it ends earlier."""
    eval_seeds: int = 10
    """Start states among which a failure is searched for."""
    first_eval_seed: int = 0
    """First start state."""


def main(args: list[str]) -> None:
    """``perdure watch``."""
    flags = parse(WatchFlags, args, "watch")
    from perdure.evaluate.watch import watch
    from perdure.policy import load_policy

    policy = load_policy(flags.policy)
    film = watch(
        policy,
        flags.out,
        clock=read_clock("--clock", flags.clock, policy, flags.steps),
        beside=read_clock("--beside", flags.beside, policy, flags.steps),
        until_failure=flags.until_failure,
        steps=flags.steps,
        eval_seeds=flags.eval_seeds,
        first_eval_seed=flags.first_eval_seed,
    )
    print(
        "\n".join([*film.sentences, f"Filmed in {film.world}; a policy of EnvPool was trained on another build.", ""])
    )
    print(f"Film: {film.path.resolve()}")
