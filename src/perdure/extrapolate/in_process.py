"""Evaluate one policy in this process: a function, a file of another library, or a `Policy`."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from perdure.envs import OpenEnv, open_env, refuse_import
from perdure.extrapolate.baselines import idle_baseline, with_reference
from perdure.extrapolate.errors import ExtrapolationError
from perdure.extrapolate.evaluate import ProgressCallback, evaluate_lanes
from perdure.extrapolate.idle import Idle
from perdure.extrapolate.lanes import FIRST_EVAL_SEED, Extrapolation, LaneSpec, whole
from perdure.extrapolate.result import TABLE, ExtrapolationResult, file_note
from perdure.extrapolate.score import make_score_scale, task_rate
from perdure.extrapolate.table import judge_table, lane_table, method_label
from perdure.horizon import Clock
from perdure.policy import FunctionPolicy, Policy, PolicyLike, TaskInfo, find_policy, load_policy
from perdure.policy.measure import resolve_training_horizon
from perdure.policy.onnx import OnnxModel, is_onnx
from perdure.policy.readers import is_sb3_zip
from perdure.report.fields import NAME
from perdure.runs import file_digest
from perdure.schema import SchemaError

if TYPE_CHECKING:
    import polars as pl


def extrapolate_policy(
    policy: Callable[..., Any] | Policy | str | Path,
    env: Any = None,
    *,
    out: str | Path | None = None,
    command: str = "",
    progress: ProgressCallback = lambda step, running: None,
    **options: Any,
) -> ExtrapolationResult:
    """Evaluate one policy in this process; `perdure.extrapolate.extrapolate` explains the arguments."""
    chosen = _Options(**options)
    if out is not None:  # fails before the work begins
        Path(out).mkdir(parents=True, exist_ok=True)
        if not os.access(out, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(out))
    digest = ""
    if isinstance(policy, str | Path) and not is_onnx(policy):
        digest = file_digest(find_policy(policy))  # of what is read now
    subject = _loaded(policy) if isinstance(policy, str | Path) else policy
    with open_env(chosen.env_of(subject, env)) as source:
        actor = with_reference(chosen.actor(subject, source), source)
        idle = idle_baseline(source)
        frame = _evaluate(actor, source, chosen, idle, progress)
    files = {}
    if digest and isinstance(subject, Policy):
        files[file_note(frame["policy"][0], frame["train_seed"][0])] = digest
    result = ExtrapolationResult(frame, None, files)
    if out is None:
        return result
    result.write(out, command)
    return replace(result, path=Path(out) / TABLE)


def _loaded(path: str | Path) -> Policy | OnnxModel:
    if Path(path).is_file() and is_sb3_zip(Path(path)):
        raise ExtrapolationError(f"{path} is a model of Stable-Baselines3: give Policy.from_sb3({str(path)!r}, env)")
    return OnnxModel.load(path) if is_onnx(path) else load_policy(path)


@dataclass(frozen=True)
class _Options:
    """Validated arguments."""

    steps: int = 100_000
    clocks: Sequence[str] | str | None = None
    eval_seeds: int = 20
    first_eval_seed: int = 0
    training_horizon: int | None = None
    recurrent: bool = False
    name: str | None = None

    def __post_init__(self) -> None:
        self.evaluation  # noqa: B018 - refuses numbers and clocks that make no sense
        if self.training_horizon is not None:
            whole("training_horizon", self.training_horizon, 1)
        if self.name is not None:
            try:
                NAME.check(self.name, "name")
            except SchemaError as error:
                raise ExtrapolationError(str(error)) from None

    @property
    def evaluation(self) -> Extrapolation:
        clocks: Any = (self.clocks,) if isinstance(self.clocks, str) else self.clocks
        if clocks is None or (isinstance(clocks, list | tuple) and not clocks):
            clocks = ("default",)
        return Extrapolation(
            (Path(),), self.steps, clocks, self.eval_seeds, first_eval_seed=self.first_eval_seed
        )  # its policies are not read

    def env_of(self, subject: Any, env: Any) -> Any:
        if env is not None:
            return env
        if not isinstance(subject, Policy):
            raise ExtrapolationError("env is missing: name the task, or give a factory or a VectorEnv")
        refuse_import(subject.task.name, (), "the policy")
        return subject.task.name

    def actor(self, subject: Any, source: OpenEnv) -> PolicyLike:
        if isinstance(subject, Policy):
            if self.recurrent or self.training_horizon is not None:
                raise ExtrapolationError("recurrent and training_horizon are for functions; a Policy knows its own")
            return subject
        if isinstance(subject, OnnxModel):
            self.check_times(subject)
        if not callable(subject):
            raise ExtrapolationError(
                f"policy must be a function of observations, a Policy or its file, not {type(subject).__name__}"
            )
        world = source.make([FIRST_EVAL_SEED] * (source.lanes or 1))
        spec, spaces = world.spec, world.spaces
        world.close()
        bounds = tuple(spec.action_low.tolist()), tuple(spec.action_high.tolist())
        label = self.label(subject)
        return FunctionPolicy(
            subject,
            TaskInfo(spec.name, spec.observation_size, *bounds, spec.discrete_actions),
            spaces,
            self.recurrent,
            self.clocks is not None,
            float(resolve_training_horizon(spec, self._known_horizon(subject))),
            {"method": label, "seed": 0},
        )

    def _known_horizon(self, subject: Callable[..., Any]) -> int | None:
        if self.training_horizon is None and isinstance(subject, OnnxModel):
            return subject.training_horizon
        return self.training_horizon

    def check_times(self, model: OnnxModel) -> None:
        if model.times == ("elapsed",):
            raise ExtrapolationError(
                f"{model.__name__} counts time itself; export it with a constant clock, or with none"
            )
        if bool(model.times) != (self.clocks is not None):
            has = "a time-to-go input, so name clocks" if model.times else "no time-to-go input, so it takes no clocks"
            raise ExtrapolationError(f"{model.__name__} has {has}")

    def label(self, subject: Any) -> str:
        if self.name is not None:
            return self.name
        if isinstance(subject, Policy):
            return method_label(subject, "policy")
        given = getattr(subject, "__name__", type(subject).__name__)
        return "function" if given == "<lambda>" else str(given)

    def lanes(self, actor: PolicyLike) -> list[LaneSpec]:
        clocks: tuple[Clock | None, ...] = (None,)
        if actor.has_clock:
            clocks = self.evaluation.deployment_clocks(actor.clock if isinstance(actor, Policy) else None)
            if not clocks:
                raise ExtrapolationError("a function stores no clock: name one, such as constant:500")
        return [LaneSpec(0, clock, seed) for clock in clocks for seed in self.evaluation.seeds]


def _evaluate(
    actor: PolicyLike, source: OpenEnv, options: _Options, idle: Idle, progress: ProgressCallback
) -> pl.DataFrame:
    import polars as pl

    assert actor.reference is not None
    lanes, steps = options.lanes(actor), options.evaluation.steps
    label, frames = options.label(actor.function if isinstance(actor, FunctionPolicy) else actor), []
    for group in source.groups(len(lanes)):
        chosen = [lanes[k] for k in group]
        world = source.make([FIRST_EVAL_SEED + lane.eval_seed for lane in chosen])
        try:
            records = evaluate_lanes([actor], chosen, steps, progress, world)
        finally:
            world.close()
        rows = lane_table([label], [actor], chosen, records, steps)
        frames.append(rows.head(len(dict.fromkeys(group)) * len(records.steps)))
    frame = pl.concat(frames)
    task = actor.task.name
    scale = make_score_scale(actor.reference, idle, task_rate(task))
    return judge_table(frame, [scale] * len(lanes))
