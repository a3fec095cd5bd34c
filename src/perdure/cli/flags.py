"""Flags that several commands share."""

from __future__ import annotations

from typing import Annotated

import tyro

Cores = Annotated[int | None, tyro.conf.arg(help="Cores to use; all by default. Results do not depend on it.")]
On = Annotated[
    str,
    tyro.conf.arg(
        help="Where to run: here (this process), local (a process for each core), ray (a local Ray) or ray:ADDRESS (a "
        "Ray cluster)."
    ),
]
