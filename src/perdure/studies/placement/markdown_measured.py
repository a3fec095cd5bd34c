"""Tables of the two small measurements in Markdown: the hand-over, and halting under exploration noise."""

from __future__ import annotations

import polars as pl

from perdure.studies.placement.halt_in_noise import CASES
from perdure.studies.placement.markdown import markdown

NOISE_WORDS = {"none": "none, as in evaluation", "exp(-2)": "exp(-2), as at the end of training"}


def hand_over_measured(table: pl.DataFrame) -> str:
    """Return placements by descent and speed."""
    headings = ("descent", "speed", "did not stay", "height at release", "object speed at release")
    lines = [
        (
            f"{row['descent']:.2f} m",
            f"{row['speed']:.2f} m/s",
            f"{row['not_stable']} of {row['placements']}",
            f"{100 * row['release_height']:.1f} cm",
            f"{row['object_speed']:.3f} m/s",
            f"{row['out_of_reach']}, {row['blocked']}",
        )
        for row in table.iter_rows(named=True)
    ]
    return markdown((*headings, "out of reach, blocked"), lines)


def noise_measured(table: pl.DataFrame) -> str:
    """Return apples that stayed by noise, without and with the halt."""
    headings = ("noise (standard deviation)", "policy releases by itself", "robot stops for 0.5 s, then releases")
    found = {(row["halts"], row["noise"], row["parts"]): row for row in table.iter_rows(named=True)}
    lines = []
    for noise, parts in [(noise, parts) for halts, noise, parts in CASES if halts]:
        name = NOISE_WORDS.get(noise, noise) if parts == "base and arm" else f"{noise}, {parts} only"
        lines.append((name, _stayed(found.get((False, noise, parts))), _stayed(found.get((True, noise, parts)))))
    return markdown(headings, lines)


def _stayed(row: dict[str, int] | None) -> str:
    if row is None:
        return ""
    share = f" ({100 * row['stayed'] / row['commanded']:.0f} %)" if row["commanded"] else ""
    return f"{row['stayed']} of {row['commanded']}{share}"
