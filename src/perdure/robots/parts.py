"""What a robot is told, what it sees, and measures of its walk."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from perdure.robots.contract import Command, Contract, FloatArray

MINUTE = 60.0


class Schedule:
    """The velocity command at each time of an episode."""

    def __init__(self, contract: Contract) -> None:
        """Read it from a contract; call `begin` before an episode."""
        self._contract, self.command = contract, contract.command

    def begin(self, rng: np.random.Generator) -> None:
        """Begin an episode."""
        self._rng, self._until = rng, 0.0 if self._contract.script or self._contract.random else math.inf

    def at(self, seconds: float) -> Command:
        """Return the command at a time, which must not go back; it is also kept as `command`."""
        if seconds >= self._until and (random := self._contract.random) is not None:
            drawn = self._rng.uniform(random.low, random.high) * (self._rng.random() >= random.standing)
            self.command, self._until = tuple(drawn.tolist()), seconds + self._rng.uniform(*random.seconds)
        elif seconds >= self._until:
            script, period = self._contract.script, self._contract.repeat
            within = math.fmod(seconds + 1e-9, period)
            now = max(row for row, each in enumerate(script) if each[0] <= within)
            ends = script[now + 1][0] if now + 1 < len(script) else period
            self.command, self._until = script[now][1:], seconds + ends - within
        return self.command


class Observer:
    """Observations of a contract: terms of `raw`, scaled and clipped, and their history."""

    def __init__(self, contract: Contract) -> None:
        """Lay out the terms and their history."""
        joints, phases, terms = len(contract.joints), len(contract.gait_offsets), contract.terms
        sizes = {"base_lin_vel": 3, "base_ang_vel": 3, "projected_gravity": 3, "command": 3, "joint_pos": joints}
        sizes |= {"joint_vel": joints, "actions": joints, "sin_phase": phases, "cos_phase": phases}
        ends = np.cumsum(list(sizes.values())).tolist()
        self.slots = {name: slice(end - sizes[name], end) for name, end in zip(sizes, ends, strict=True)}
        """Where each term is in `raw`."""
        self.slots |= {"command_lin_vel": slice(9, 11), "command_ang_vel": slice(11, 12)}
        self.raw = np.zeros(ends[-1])
        widths = [contract.size(term) for term in terms]
        self._chosen = np.concatenate([np.arange(ends[-1])[self.slots[term.name]] for term in terms])
        self._scale = np.concatenate([np.broadcast_to(t.scale, w) for t, w in zip(terms, widths, strict=True)])
        ranges = np.sort(np.repeat([term.clip for term in terms], widths, axis=0) * self._scale[:, None])
        self._low, self._high = ranges.clip(-contract.observation_clip, contract.observation_clip).T
        longest, begins = max(term.history for term in terms), np.cumsum([0, *widths])
        self._past, self._empty = np.zeros((longest, begins[-1])), True
        places, turn = np.arange(self._past.size).reshape(longest, -1), -1 if "newest" in contract.history_order else 1
        parts = [
            places[longest - term.history :, begin : begin + width][::turn]
            for term, begin, width in zip(terms, begins, widths, strict=False)
        ]
        by_step = contract.history_layout == "by step"
        self._order = np.hstack(parts if by_step else [part.ravel() for part in parts]).ravel()

    def begin(self) -> None:
        """Begin an episode: its first step fills the history."""
        self._empty = True

    def read(self) -> FloatArray:
        """Return the observation of what is in `raw` now."""
        step: FloatArray = np.minimum(np.maximum(self.raw[self._chosen] * self._scale, self._low), self._high)
        if len(self._past) == 1:
            return step
        self._past[:-1] = step if self._empty else self._past[1:]
        self._past[-1], self._empty = step, False
        return np.array(self._past.take(self._order))


class Walk:
    """Measures of a walk; a commanded path begins anew, where the robot is, every minute."""

    def __init__(self) -> None:
        """Begin at the origin, heading along x."""
        self._seconds = self._error = self._energy = self._length = self._yaw = self._last = 0.0
        self._turned, self._aside, self._minutes = 0.0, 0.0, 0
        self._anchor(0.0, 0.0)

    def _anchor(self, x: float, y: float) -> None:
        self._since, self._wanted, self._x, self._y, self._away = self._seconds, self._yaw, x, y, 0.0

    def move(
        self, place: Sequence[float], speeds: Sequence[float], command: Command, joules: float, seconds: float
    ) -> None:
        """Record a step: x, y, heading after it; forward and lateral velocity; command; positive work; its length."""
        (x, y, yaw), (forward, lateral, rate) = place, command
        self._yaw += math.remainder(yaw - self._last, math.tau)
        speed, angle = math.hypot(forward, lateral), self._wanted + math.atan2(lateral, forward)
        self._x += speed * math.cos(angle) * seconds
        self._y += speed * math.sin(angle) * seconds
        self._wanted += rate * seconds
        self._last, self._seconds, self._energy = yaw, self._seconds + seconds, self._energy + joules
        self._error += math.hypot(forward - speeds[0], lateral - speeds[1]) * seconds
        self._length += math.hypot(*speeds) * seconds
        ahead, left = x - self._x, y - self._y
        self._away = abs(left * math.cos(angle) - ahead * math.sin(angle)) if speed else math.hypot(ahead, left)
        if self._seconds - self._since >= MINUTE - 1e-6:
            self._turned, self._aside = self._turned + abs(self._yaw - self._wanted), self._aside + self._away
            self._minutes += 1
            self._anchor(x, y)

    def measures(self) -> dict[str, float | None]:
        """Return columns of the table (`MEASURES`) over all whole minutes; before the first one ends, in proportion."""
        turned, aside, minutes = self._turned, self._aside, float(self._minutes)
        if not minutes:
            turned, aside, minutes = abs(self._yaw - self._wanted), self._away, self._seconds / MINUTE
        return {
            "heading_error": math.degrees(turned) / minutes,
            "lateral_drift": aside / minutes,
            "velocity_error": self._error / self._seconds,
            "energy_per_meter": self._energy / self._length if self._length > 1.0 else None,
        }
