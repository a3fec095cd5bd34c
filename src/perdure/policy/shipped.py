"""Policies that come with the package, by name."""

from __future__ import annotations

from pathlib import Path

from perdure.policy.errors import PolicyFileError

SHIPPED = Path(__file__).parent / "shipped"
"""``shipped/TASK/METHOD.safetensors``"""


def shipped_policies() -> dict[str, Path]:
    """Name, such as "Hopper-v3/geometric", to file."""
    return {
        path.relative_to(SHIPPED).with_suffix("").as_posix(): path for path in sorted(SHIPPED.rglob("*.safetensors"))
    }


def find_policy(name: str) -> Path:
    """The file of that path, or the shipped policy of that name.

    Raises:
        PolicyFileError: If there is neither.
    """
    if Path(name).exists():
        return Path(name)
    shipped = shipped_policies()
    if name in shipped:
        return shipped[name]
    raise PolicyFileError(
        f"no policy file {name}, and no shipped policy of that name; shipped are {', '.join(shipped)}"
    )
