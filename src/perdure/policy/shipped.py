"""Policies that come with the package, by name."""

from __future__ import annotations

from difflib import get_close_matches
from pathlib import Path

from perdure.policy.errors import PolicyFileError
from perdure.policy.hub import policy_in_cache, policy_in_folder

SHIPPED = Path(__file__).parent / "shipped"
"""`TASK/METHOD.safetensors`; skills of the home benchmark as `home/TASK/SKILL/seed-K.safetensors`."""


def shipped_policies() -> dict[str, Path]:
    """Return name, such as "Hopper-v3/geometric" or "home/set_table/place/seed-0", to file."""
    return {
        path.relative_to(SHIPPED).with_suffix("").as_posix(): path for path in sorted(SHIPPED.rglob("*.safetensors"))
    }


LABELS = {
    "HalfCheetah-v3/geometric": "holds under constant:500 in 9 of 10 episodes; turns over under constant:0",
    "HalfCheetah-v3/ppo": "turns over and stays so in 2 of 10 episodes, holds in 7",
    "Hopper-v3/geometric": "holds under constant:500, falls within 300 steps under constant:0",
    "Hopper-v3/geometric-zoo": "never worked: it stands still and lives on the alive bonus",
    "Hopper-v3/linear-random": "fails silently under constant:500: it stands still after 200 steps",
    "Hopper-v3/ppo": "falls, half of its episodes by step 4,000",
    "Hopper-v3/ppo-zoo": "never worked: it stands still and lives on the alive bonus",
    "Walker2d-v3/geometric": "holds under constant:500",
    "Walker2d-v3/ppo": "falls, half of its episodes by step 4,000",
}
"""Outcomes of the shipped locomotion policies after 100,000 steps, judged by `perdure extrapolate` from the start
states 0 to 9. Each is one training seed, chosen on other start states to show one of the ways to hold or to fail: they
are examples, no comparison of methods."""


def find_policy(name: str | Path) -> Path:
    """Return a policy's file.

    Args:
        name: A file; a folder that holds one policy; a shipped policy, such as "Hopper-v3/geometric"; or a model
            "ORG/NAME" that Hugging Face's tools have downloaded (see `perdure.policy.hub`).

    Raises:
        PolicyFileError: If there is none; the message offers the nearest names.
    """
    shipped, path = shipped_policies(), Path(name)
    if path.is_dir() and str(name) in shipped and not any(path.glob("*.safetensors")):
        raise PolicyFileError(
            f"{name} is a shipped policy, but there is a folder {path.resolve()}: name a policy file in it, or run the "
            "command in another folder"
        )
    if path.exists():
        return policy_in_folder(path) if path.is_dir() else path
    if str(name) in shipped:
        return shipped[str(name)]
    if downloaded := policy_in_cache(str(name)):
        return downloaded
    nearest = get_close_matches(str(name), shipped, n=2, cutoff=0.5)
    hint = f"did you mean {' or '.join(nearest)}? " if nearest else ""
    raise PolicyFileError(
        f"there is no policy file {name}, and no shipped policy of that name; {hint}`perdure list policies` shows all"
    )
