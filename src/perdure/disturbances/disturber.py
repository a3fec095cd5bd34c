"""`Disturber`: how disturbances act together on the robots of several lanes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from perdure.disturbances.vocabulary import Disturbance, Effect, FloatArray, IntArray, Robots, Simulator
from perdure.errors import PerdureError


class Disturber:
    """What disturbances do to the actions, the robots and the observations of n lanes.

    Call `begin` before an episode begins, `act` before each step, and `observe` for each observation. `box` is the
    lowest and the highest action, each of shape (action_size,), None where actions are not a box; the models of
    `environments`, of Gymnasium's MuJoCo and one for each lane, are changed. An environment that observes the last
    action has the attribute `policy_action`: it gets the policy's own there, since a robot knows no other.

    Raises:
        PerdureError: If a disturbance cannot be applied here.
    """

    def __init__(
        self,
        name: str,
        disturbances: Sequence[Disturbance],
        seeds: Sequence[int],
        box: tuple[FloatArray, FloatArray] | None,
        observation_std: FloatArray | None,
        environments: Sequence[Any] = (),
    ) -> None:
        ordered = sorted(disturbances, key=lambda each: (each.kind.place, each.name))
        for each in ordered:
            if each.kind.needs_action_box and (box is None or not np.isfinite(box).all()):
                raise PerdureError(f"{each.name} needs actions in a finite box, those of {name} are not")
        told = [each for each in environments if hasattr(each.unwrapped, "policy_action")]
        self._told = [each.unwrapped for each in told if each.action_space == each.unwrapped.action_space]
        self.robots = Robots(name, seeds, box, observation_std)
        needing = [each.name for each in ordered if each.kind.needs_simulator()]
        if needing:
            self.robots.simulators = _simulators(name, environments, needing, len(seeds))
        effects = [each.kind(each, self.robots) for each in ordered]
        self._models = _Models([each for each in effects if each.overrides("change_model")], self.robots.simulators)
        # Most effects act in one method: the others are not called in every step.
        self._on_begin = [each for each in effects if each.overrides("on_begin")]
        self._on_action = [each for each in effects if each.overrides("on_action")]
        self._on_state = [each for each in effects if each.overrides("on_state")]
        self._on_observation = [each for each in effects if each.overrides("on_observation")]

    def begin(self, lanes: IntArray) -> None:
        """Begin an episode in each of these lanes, before they are reset."""
        self.robots.episodes[lanes] += 1
        self._models.update(lanes, np.zeros(len(lanes), np.int64))
        for effect in self._on_begin:
            effect.on_begin(lanes)

    def act(self, actions: FloatArray, lanes: IntArray, elapsed: IntArray) -> FloatArray:
        """Return the actions that act, still to be clipped; change the models and states of the robots.

        Args:
            actions: Of the policy, shape (n, action_size).
            lanes: Lane numbers, shape (n,).
            elapsed: Steps before this one, shape (n,).
        """
        if self._told:
            for lane, own in zip(lanes, actions, strict=True):
                self._told[lane].policy_action = own.clip(self.robots.low, self.robots.high)
        self._models.update(lanes, elapsed)
        for effect in self._on_action:
            actions = _where_it_acts(effect, effect.on_action, actions, lanes, elapsed)
        for effect in self._on_state:
            if effect.disturbance.is_timed:
                acts = effect.disturbance.acts(elapsed)
                effect.on_state(lanes[acts], elapsed[acts])
            else:
                effect.on_state(lanes, elapsed)
        return actions

    def observe(self, observations: FloatArray, lanes: IntArray, elapsed: IntArray) -> FloatArray:
        """Return the observations that the policy gets.

        Args:
            observations: Of the world, shape (n, observation_size); may be changed in place.
            lanes: Lane numbers, shape (n,).
            elapsed: Steps since reset, shape (n,).
        """
        for effect in self._on_observation:
            observations = _where_it_acts(effect, effect.on_observation, observations, lanes, elapsed)
        return observations


def _where_it_acts(
    effect: Effect,
    method: Callable[[FloatArray, IntArray, IntArray], FloatArray],
    rows: FloatArray,
    lanes: IntArray,
    elapsed: IntArray,
) -> FloatArray:
    """Return what a method of an effect makes of these rows, and the rows themselves where it does not act.

    It is called for all rows: an effect may remember what it does not change yet.
    """
    if not effect.disturbance.is_timed:
        return method(rows, lanes, elapsed)
    changed = method(rows.copy(), lanes, elapsed)
    return np.where(effect.disturbance.acts(elapsed)[:, None], changed, rows)


def _simulators(name: str, environments: Sequence[Any], needing: Sequence[str], lanes: int) -> list[Simulator]:
    """Return MuJoCo's model and data of each lane; PerdureError if an environment has none."""
    import mujoco

    found = []
    for env in environments:
        model = getattr(env.unwrapped, "model", None)
        data = getattr(env.unwrapped, "data", None)
        if isinstance(model, mujoco.MjModel) and isinstance(data, mujoco.MjData):
            found.append(Simulator(env.unwrapped, model, data))
    if len(found) < lanes:
        raise PerdureError(
            f"{name}: {', '.join(needing)} needs an environment of Gymnasium whose `unwrapped` has MuJoCo's `model` "
            "and `data`, such as gymnasium:Hopper-v5"
        )
    return found


class _Models:
    """The models of all lanes, changed by the effects that act on them now."""

    def __init__(self, effects: Sequence[Effect], simulators: Sequence[Simulator]) -> None:
        self._effects = effects
        self._simulators = simulators
        at_first = [effect.disturbance.onset == 0 for effect in effects]
        self._acting = np.tile(np.array(at_first, bool)[:, None], len(simulators))
        """Whether each effect acts in each lane, shape (effects, lanes)."""
        self._is_timed = any(effect.disturbance.is_timed for effect in effects)
        self._originals: list[_Original] = []
        if self._is_timed:
            self._originals = [_Original(each.model) for each in simulators]
        if effects:
            for lane in range(len(simulators)):
                self._change(lane)

    def update(self, lanes: IntArray, elapsed: IntArray) -> None:
        """Change the models of lanes in which an effect begins or ends after so many steps."""
        if not self._is_timed:
            return
        acting = np.array([effect.disturbance.acts(elapsed) for effect in self._effects])
        for row in np.flatnonzero((acting != self._acting[:, lanes]).any(axis=0)):
            lane = int(lanes[row])
            self._acting[:, lane] = acting[:, row]
            self._originals[lane].restore()
            self._change(lane)

    def _change(self, lane: int) -> None:
        """Change a model that is as it was."""
        model = self._simulators[lane].model
        before = [getattr(model, name).copy() for name in _INERTIAL]
        for effect, acts in zip(self._effects, self._acting[:, lane], strict=True):
            if acts:
                effect.change_model(model)
        after = [getattr(model, name) for name in _INERTIAL]
        if not all(map(np.array_equal, before, after)):
            import mujoco

            mujoco.mj_setConst(model, mujoco.MjData(model))


_INERTIAL = ("body_mass", "body_inertia", "body_ipos", "body_iquat", "dof_armature")
"""Arrays of a model from which MuJoCo derives others (`mj_setConst`)."""
_ASSETS = ("mesh_", "tex_", "hfield_", "skin_", "bvh_", "flex_", "_")
"""How the names of large arrays begin that are not put back, and private names."""


class _Original:
    """The numbers of a model, to be put back: its arrays but those of `_ASSETS`, its options and its statistics."""

    def __init__(self, model: Any) -> None:
        self._arrays: list[tuple[Any, Any]] = []
        self._numbers: list[tuple[Any, str, float]] = []
        for owner in (model, model.opt, model.stat):
            for name in dir(owner):
                if name.startswith(_ASSETS):
                    continue
                value = getattr(owner, name)
                if isinstance(value, np.ndarray):
                    self._arrays.append((value, value.copy()))
                elif isinstance(value, int | float) and owner is not model:
                    self._numbers.append((owner, name, value))

    def restore(self) -> None:
        """Put them back."""
        for array, values in self._arrays:
            array[...] = values
        for owner, name, value in self._numbers:
            setattr(owner, name, value)
