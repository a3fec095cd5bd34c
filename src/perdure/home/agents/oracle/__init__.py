"""A scripted oracle: the field's sense-plan-act baseline, with full knowledge of the world.

It shows that the benchmark can be solved: what a policy lacks is the policy's.

Contents:
    Oracle    acts in every skill but `reset_arm`, which is scripted anyway
"""

from perdure.home.agents.oracle.actor import Oracle

__all__ = ["Oracle"]
