"""Damping of drawers and doors, from the decay time of M3's motors.

M3 (hab-mobile-manipulation, `sim.py`) gives every furniture joint a Bullet velocity motor with target 0, gain 0.3 and
120 steps per second: each step leaves 0.7 of the speed, so speed decays as exp(-t / tau) with
tau = -1 / (120 ln 0.7) = 0.0234 s. As a viscous joint that is damping = inertia / tau. The motor's impulse limit
(1.0 N s per step) and the URDF's own damping and dry friction (0.01 each) are left out: they are far larger or far
smaller than anything the viscous term does at the speeds of a hand.
"""

import math

DECAY_TIME_S = -1.0 / (120.0 * math.log(1.0 - 0.3))
"""Time in which a free drawer or door loses 63 % of its speed, in [s]."""


def drawer_damping(mass: float) -> float:
    """Return the viscous damping of a drawer of `mass` [kg], in [N s/m]: mass / tau."""
    return mass / DECAY_TIME_S


def door_damping(mass: float, width: float, offset: float) -> float:
    """Return the viscous damping of a slab door, in [N m s/rad]: its moment of inertia about the hinge / tau.

    Mass in [kg]; width of the slab, and distance of its middle from the hinge, in [m].
    """
    inertia = mass * (width**2 / 12.0 + offset**2)
    return inertia / DECAY_TIME_S
