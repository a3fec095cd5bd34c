"""``perdure import``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from perdure.cli.parse import parse


@dataclass(frozen=True)
class ImportFlags:
    """Convert a Stable-Baselines3 or sb3-contrib model to a policy file: PPO, A2C, TRPO, SAC, TQC, TD3 or DDPG."""

    model: tyro.conf.Positional[Path]
    """The zip that model.save() wrote."""
    env: str
    """The environment it was trained in. Hopper-v5 is Gymnasium's if Gymnasium can make it; envpool:Hopper-v5 is
    EnvPool's, which is faster."""
    out: Path = Path("policy.safetensors")
    """The file to write."""
    normalizer: str | None = None
    """The file that VecNormalize.save() wrote; "none" if only rewards were normalized."""
    time_feature: str | None = None
    """linear:1000 if trained in sb3-contrib's TimeFeatureWrapper with 1000 steps; linear takes the training
    horizon."""
    training_horizon: int | None = None
    """Steps of a training episode; the environment's own step limit if left out."""
    trust: bool = False
    """Load with Stable-Baselines3 itself, which runs code in the files. Only for files you trust."""


def main(args: list[str]) -> None:
    """``perdure import``."""
    flags = parse(ImportFlags, args, "import")
    from perdure.policy import save_policy
    from perdure.policy.readers import import_sb3

    policy = import_sb3(
        flags.model,
        flags.env,
        normalizer=flags.normalizer,
        time_feature=flags.time_feature,
        training_horizon=flags.training_horizon,
        trust=flags.trust,
    )
    print(save_policy(policy, flags.out))
