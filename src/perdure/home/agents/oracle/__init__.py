"""A scripted oracle: the field's sense-plan-act baseline, with full knowledge of the world.

It shows that the benchmark is solvable, so the failures of a learned policy are its own.

Contents:
    Oracle    acts in every skill but `reset_arm`, which is scripted anyway
"""

from perdure.home.agents.oracle.oracle import Oracle

__all__ = ["Oracle"]
