"""Convert a Stable-Baselines3 model and its `VecNormalize` to a `Policy`, checked against its environment."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.envs import TaskSpec, task_of_environment, task_spec
from perdure.envs.suites import task_source_digest
from perdure.errors import PerdureError, warn
from perdure.horizon import Countdown, Fixed, HorizonProtocol, TimeFeature
from perdure.policy.files import load_policy, save_policy
from perdure.policy.onnx import model_digest
from perdure.policy.policy import LARGEST_OBSERVATION, SEEN, SMALLEST_EPSILON, Normalizer, Policy, TaskInfo
from perdure.policy.readers.restricted_pickle import NUMPY_NAMES, Stub, read_numbers, read_pickle
from perdure.policy.readers.sb3 import USE_A_FUNCTION, Sb3Model, is_sb3_zip, read_sb3
from perdure.policy.reference import measure_reference, resolve_training_horizon
from perdure.runs import config_digest, file_digest, read_bounded, versions

NO_NORMALIZER = "none"
"""Says that observations were not normalized, where the model suggests otherwise."""
MAX_FILE = 64_000_000
"""Bytes; statistics of 100 numbers take 3,000."""
VEC_NORMALIZE = "stable_baselines3.common.vec_env.vec_normalize.VecNormalize"
RUNNING_MEAN_STD = "stable_baselines3.common.running_mean_std.RunningMeanStd"
_SPACES = {
    *(f"gym.spaces.{space}" for space in ("box.Box", "dict.Dict", "discrete.Discrete")),
    *(f"gymnasium.spaces.{space}" for space in ("box.Box", "dict.Dict", "discrete.Discrete")),
}
_RANDOM = {
    *(f"numpy.random._pickle.{name}" for name in ("__generator_ctor", "__bit_generator_ctor", "__randomstate_ctor")),
    *("numpy.random._pcg64.PCG64", "numpy.random._mt19937.MT19937", "numpy.random.bit_generator.SeedSequence"),
    "numpy.random.bit_generator.__pyx_unpickle_SeedSequence",
}
ALLOWED = {VEC_NORMALIZE, RUNNING_MEAN_STD, "collections.OrderedDict", *NUMPY_NAMES, *_SPACES, *_RANDOM}
"""What the pickle of a VecNormalize asks for: itself, statistics, arrays, spaces and their random generators."""


def import_sb3(
    path: str | Path,
    env: str,
    *,
    normalizer: str | Path | None = None,
    time_feature: str | None = None,
    training_horizon: int | None = None,
    trust: bool = False,
    measure: bool = True,
) -> Policy:
    """Return the deterministic policy of a Stable-Baselines3 or sb3-contrib model.

    Its actions are those of `model.predict(observation, deterministic=True)` up to rounding in 32 bits. Read are PPO,
    A2C, TRPO, SAC, TQC, TD3, DDPG, DQN, QR-DQN and ARS with MlpPolicy, LinearPolicy or MultiInputPolicy; actions may be
    continuous or discrete (Discrete, MultiDiscrete).

    Args:
        path: The zip that `model.save` wrote.
        env: The environment it was trained in, see `perdure.envs.task_of_environment`.
        normalizer: The file that `VecNormalize.save` wrote; "none" where only rewards were normalized.
        time_feature: "linear:1000" if the environment was wrapped in sb3-contrib's TimeFeatureWrapper with these steps;
            "linear" takes the training horizon.
        training_horizon: Steps of a training episode; by default those of the time feature, or the environment's own
            step limit.
        trust: Load the files with Stable-Baselines3 itself, which runs the code pickled in them.
        measure: Also measure 20 reference episodes within the training horizon, which takes some seconds.

    Raises:
        PerdureError: If a file is damaged or holds something that is not read, the environment cannot be made, or
            model, normalizer, time feature and environment do not fit together.
        OSError: If a file cannot be read.
    """
    task = task_of_environment(env)
    spec = task_spec(task)
    path = Path(path)
    written = _written(normalizer)
    read_model = read_sb3
    read_statistics = read_vecnormalize
    if trust:
        from perdure.policy.readers.trusted import load_sb3, load_vecnormalize

        read_model = load_sb3
        read_statistics = load_vecnormalize
    model = read_model(path)
    statistics = None
    if written is not None:
        statistics = read_statistics(written)
    if normalizer is None and model.settings.behind_vecnormalize:
        raise PerdureError(
            f"{path} was trained behind VecNormalize: give the file that its save() wrote with --normalizer "
            f"(normalizer=), or {NO_NORMALIZER!r} if only rewards were normalized"
        )
    _warn_of_normalizer(model, normalizer, written, statistics, str(path))
    steps = _time_feature_steps(time_feature)
    if training_horizon is not None:
        horizon = resolve_training_horizon(spec, training_horizon)
    else:
        horizon = resolve_training_horizon(spec, steps)
    if time_feature is not None:
        steps = steps or horizon
        limit = training_horizon or spec.default_horizon
        if steps != limit and (training_horizon is not None or spec.has_step_limit):
            warn(
                f"the time feature counts down from {steps} steps, but episodes of {spec.name} end after {limit}; "
                "TimeFeatureWrapper takes the environment's own limit if there is one"
            )
    policy = _policy(model, spec, statistics, steps, horizon, str(path))
    provenance = _provenance(model, path, written, env, time_feature)
    if statistics is not None and statistics.count:
        provenance[SEEN] = statistics.count
    engine = trained_on(model.gym, spec)
    if engine:
        provenance["engine"] = engine
    policy = replace(policy, provenance=provenance)
    if measure:
        policy = replace(policy, reference=measure_reference(policy))
    return policy


def import_file(path: Path, env: str, **options: Any) -> Policy:
    """Return what the reader of a file returns: `import_sb3`, `import_rsl_rl` for .pt, `import_onnx` for .onnx.

    Options are those of `import_sb3`.
    """
    from perdure.policy.readers.checkpoints import import_rsl_rl
    from perdure.policy.readers.onnx_network import import_onnx

    readers = {".pt": import_rsl_rl, ".onnx": import_onnx}
    read = readers.get(path.suffix.lower())
    if read is None:
        return import_sb3(path, env, **options)
    horizon = options.pop("training_horizon", None)
    given = [f"--{name.replace('_', '-')}" for name, value in options.items() if value not in (None, False)]
    if given:
        raise PerdureError(f"{', '.join(given)}: only for Stable-Baselines3 models; {path} is none")
    return read(path, env, training_horizon=horizon)


def import_once(path: Path, folder: Path, env: str, **options: Any) -> Path:
    """Return the file in `folder` that holds the imported policy; import it only if it is not there yet.

    The file's name contains a digest of the files' contents, the options and the versions that decide the outcome.

    Args:
        path: As in `import_sb3`.
        folder: Made if it is missing.
        env: As in `import_sb3`.
        options: `normalizer`, `time_feature`, `training_horizon` and `trust` of `import_sb3`.
    """
    normalizer = options.get("normalizer")
    written = _written(normalizer)
    identity: dict[str, Any] = {
        **options,
        "env": task_of_environment(env),
        "model": model_digest(path),
        "normalizer": None,
        "no normalizer": normalizer == NO_NORMALIZER,
        "versions": library_versions(),
    }
    if written is not None:
        identity["normalizer"] = file_digest(written)
    source = task_source_digest(identity["env"])
    if source:
        identity["source"] = source
    agent = path.parent / "params" / "agent.yaml"
    if agent.is_file():
        identity["agent"] = file_digest(agent)
    target = folder / f"{path.stem}-{config_digest(identity)[:12]}.safetensors"
    with suppress(PerdureError):  # a damaged file is made again
        if target.exists():
            load_policy(target)
            return target
    policy = import_file(path, env, **options)
    folder.mkdir(parents=True, exist_ok=True)
    return save_policy(policy, target)


def _written(normalizer: str | Path | None) -> Path | None:
    """Return the file with a normalizer's statistics; PerdureError if it is missing."""
    if normalizer is None or normalizer == NO_NORMALIZER:
        return None
    path = Path(normalizer)
    if not path.exists():
        raise PerdureError(f"--normalizer (normalizer=): there is no file {path}")
    return path


def _policy(
    model: Sb3Model, spec: TaskSpec, statistics: Statistics | None, steps: int | None, horizon: int, what: str
) -> Policy:
    """Return the policy; `steps` are those of its time feature, `horizon` those of a training episode."""
    settings = model.settings
    _check_sizes(model, spec, steps, what)
    weights: dict[str, NDArray[np.float32]] = {}
    for i, (weight, bias) in enumerate(model.layers):
        weights |= {f"policy.{i}.weight": weight, f"policy.{i}.bias": bias}
    size = spec.observation_size + (steps is not None)
    normalizer = None
    normalizer_gamma = settings.gamma
    if statistics is not None:
        normalizer = statistics.normalizer
        normalizer_gamma = statistics.gamma
    if normalizer is not None and len(normalizer.mean) != size:
        raise PerdureError(
            f"{what}: the normalizer has statistics of {len(normalizer.mean)} numbers, but the policy is given {size}"
        )
    embedding = None
    clock = None
    if steps is not None:
        embedding = TimeFeature(steps)
        clock = Countdown(float(steps))
    protocol = HorizonProtocol(
        embedding=embedding,
        horizon=Fixed(horizon),
        end="truncated",
        gamma=min(settings.gamma, 1.0),
        normalizer_gamma=min(normalizer_gamma, 1.0),
        normalize_embedding=steps is not None and normalizer is not None,
    )
    return Policy(
        task=TaskInfo.of(spec),
        weights=weights,
        activation=settings.activation,
        normalizer=normalizer or Normalizer.identity(spec.observation_size),
        protocol=protocol,
        clock=clock,
        squash=settings.squash,
    )


def _check_sizes(model: Sb3Model, spec: TaskSpec, steps: int | None, what: str) -> None:
    inputs = len(model.layers[0][0])
    outputs = len(model.layers[-1][1])
    expected = spec.observation_size + (steps is not None)
    if inputs != expected:
        hint = ""
        if steps is not None:
            hint = " with the time feature"
        elif inputs == expected + 1:
            hint = " (was it trained with TimeFeatureWrapper? add --time-feature linear)"
        raise PerdureError(
            f"{what}: its network takes {inputs} numbers, but {spec.name} gives {expected}{hint}; with other "
            f"wrappers: {USE_A_FUNCTION}"
        )
    task = TaskInfo.of(spec)
    choices: tuple[int, ...] = ()
    if spec.discrete_actions:
        choices = task.choices
    if outputs != task.output_size or choices != model.settings.choices or (choices and spec.action_low.any()):
        raise PerdureError(
            f"{what}: its actions are {_actions_text(outputs, model.settings.choices)}, those of {spec.name} "
            f"{_actions_text(spec.action_size, choices)}"
        )
    if model.settings.action_bounds is None:
        return
    for name, written, needed in zip(
        ("lower", "upper"), model.settings.action_bounds, (spec.action_low, spec.action_high), strict=True
    ):
        if not np.allclose(written, needed, rtol=1e-5, atol=1e-6):
            raise PerdureError(
                f"{what}: its actions have the {name} bounds {written.tolist()}, those of {spec.name} "
                f"{np.asarray(needed).tolist()}; with a wrapper that rescales actions: {USE_A_FUNCTION}"
            )


def _actions_text(size: int, choices: tuple[int, ...]) -> str:
    """Return what actions are, in words."""
    if choices:
        return f"discrete with {' x '.join(map(str, choices))} choices from 0"
    return f"{size} continuous numbers"


def _warn_of_normalizer(
    model: Sb3Model, given: str | Path | None, file: Path | None, statistics: Statistics | None, what: str
) -> None:
    """Warn where a normalizer may be missing, or does not belong to the model."""
    settings = model.settings
    steps = settings.steps
    count = 0.0
    if statistics is not None:
        count = statistics.count
    text = ""
    if given is None and not settings.shows_vecnormalize:
        text = (
            f"{what} does not say whether it was trained behind VecNormalize. If so, its actions are wrong without "
            f"the file that save() wrote (--normalizer); if not, give --normalizer {NO_NORMALIZER}"
        )
    elif file is not None and settings.shows_vecnormalize and not settings.behind_vecnormalize:
        text = f"{what} was not trained behind VecNormalize, as far as it shows, but is given the statistics in {file}"
    elif steps and count and not 2 / 3 < count / steps < 1.5:  # it counts the steps, and one reset of each environment
        text = f"{what} was trained for {steps:,} steps, {file} for {count:,.0f}: were they saved together?"
    if text:
        warn(text)


def _time_feature_steps(written: str | None) -> int | None:
    """Return the steps of "linear:1000"; None where none are named."""
    if written is None:
        return None
    name, colon, number = written.partition(":")
    steps = 0
    if number.isascii() and number.isdigit() and len(number) < 10:
        steps = int(number)
    if name != "linear" or (colon and steps < 1):
        raise PerdureError(f"time_feature must be linear or linear:STEPS, for example linear:1000, got {written!r}")
    return steps or None


def _provenance(
    model: Sb3Model, path: Path, normalizer: Path | None, env: str, time_feature: str | None
) -> dict[str, Any]:
    settings = model.settings
    name = "".join(letter for letter in path.stem if letter.isprintable())
    provenance: dict[str, Any] = {
        # Models of one name are taken for training runs of one method, distinguished by their seeds.
        "method": f"SB3 {settings.algorithm} ({name})",
        "steps": settings.steps,
        "source": {"file": path.name, "sha256": file_digest(path), "stable-baselines3": model.version, "env": env},
        "versions": library_versions(),
    }
    if settings.seed is not None:
        provenance["seed"] = settings.seed
    if normalizer is not None:
        provenance["source"] |= {"normalizer": normalizer.name, "normalizer sha256": file_digest(normalizer)}
    if time_feature is not None:
        provenance["source"]["time feature"] = time_feature
    return provenance


MUJOCO_BINDINGS = (0, 24)
"""The first Gym whose environments can use MuJoCo's own Python package. Before it, all used mujoco-py."""


def trained_on(gym: str, spec: TaskSpec) -> str:
    """Return the engine of training, as far as a model says; "" if it does not, or the task is not MuJoCo's.

    Args:
        gym: As in `Sb3Model`.
        spec: Of the task that the model acts in.
    """
    if not gym or "MuJoCo" not in spec.engine:
        return ""
    name, _, version = gym.partition(" ")
    parts = [int(each) for each in re.findall(r"\d+", version)[:2]]
    mujoco = "MuJoCo of unknown version"
    if name == "Gym" and tuple(parts) < MUJOCO_BINDINGS:
        mujoco = "MuJoCo 2.1 or older (mujoco-py)"
    return f"{gym}, {mujoco}"


def library_versions() -> dict[str, str]:
    """Return the versions of the libraries that decide what an imported policy does in its reference episodes."""
    return versions("envpool", "gymnasium", "mujoco", "numpy")


# Observation statistics of a VecNormalize, without running its pickle


@dataclass(frozen=True, eq=False)
class Statistics:
    """Observation statistics of a VecNormalize."""

    normalizer: Normalizer | None
    """None if it normalizes rewards only."""
    gamma: float
    """Discount of the running return whose spread scaled the rewards."""
    count: float = 0.0
    """Observations seen; 0: unknown."""


def read_vecnormalize(path: Path) -> Statistics:
    """Return the statistics that `VecNormalize.save` wrote to a file.

    Raises:
        PerdureError: If the file is damaged, is something else, asks for functions that a VecNormalize does not
            need, or holds statistics that are not finite.
        OSError: If it cannot be read.
    """
    saved = read_pickle(read_bounded(path, MAX_FILE), ALLOWED, f"the normalizer {path}")
    if not (isinstance(saved, Stub) and saved.function == VEC_NORMALIZE and isinstance(saved.state, dict)):
        raise PerdureError(f"{path} is not a saved VecNormalize of Stable-Baselines3")
    return _statistics(saved.state, str(path))


def _statistics(state: dict[Any, Any], what: str) -> Statistics:
    gamma = _single(state, "gamma", what)
    if state.get("norm_obs") is False:
        return Statistics(None, gamma)
    statistics = state.get("obs_rms")
    if not isinstance(statistics, dict):
        statistics = {"": statistics}
    means = []
    variances = []
    for name in sorted(statistics):  # the order in which Gymnasium joins the parts of a dictionary
        part = statistics[name]
        if not (isinstance(part, Stub) and isinstance(part.state, dict)):
            raise PerdureError(f"{what} holds no observation statistics")
        means.append(_number(part.state, "mean", what).ravel())
        variances.append(_number(part.state, "var", what).ravel())
    if not means:
        raise PerdureError(f"{what} holds no observation statistics")
    clip, epsilon = (_single(state, name, what) for name in ("clip_obs", "epsilon"))
    count = _single(part.state, "count", what)
    normalizer = checked_normalizer(np.concatenate(means), np.concatenate(variances), clip, epsilon, what)
    return Statistics(normalizer, gamma, count)


def checked_normalizer(
    mean: NDArray[np.float64], var: NDArray[np.float64], clip: float, epsilon: float, what: str
) -> Normalizer:
    """Return a normalizer; PerdureError if shapes differ, a number is not finite or a variance is negative."""
    fits = mean.shape == var.shape and np.isfinite(mean).all() and np.isfinite(var).all()
    if not fits or not (var + epsilon > 0).all() or not (clip > 0 and 0 <= epsilon < np.inf):
        raise PerdureError(f"{what} holds statistics that are not finite, negative variances or a clip of 0")
    return Normalizer(mean, var, min(clip, LARGEST_OBSERVATION), max(epsilon, SMALLEST_EPSILON))


def _single(state: dict[Any, Any], name: str, what: str) -> float:
    found = _number(state, name, what)
    if found.size != 1:
        raise PerdureError(f"{what}: {name} must be one number, but there are {found.size}")
    return float(found.item())


def _number(state: dict[Any, Any], name: str, what: str) -> NDArray[np.float64]:
    if name not in state:
        raise PerdureError(f"{what} has no {name}")
    return read_numbers(state[name], f"{what}: {name}")


# Models in folders


@dataclass(frozen=True)
class FoundModel:
    """A model, and what files beside it say of its training, as `import_sb3` takes it; None where they do not."""

    path: Path
    env: str | None = None
    normalizer: str | None = None
    time_feature: str | None = None
    unread: str = ""
    """What else changes what the model observes; "" if nothing does."""


_CHECKPOINT = re.compile(r"(.+)_(\d+)_steps")
_PAIR = re.compile(r"^(?:- |  )- - (\w+)\n    - (.*(?:\n {6}.*)*)", re.MULTILINE)
"""A pair of an `OrderedDict` as `yaml.dump` writes it. A YAML library would call what the file names; this is text."""


def find_models(path: Path, tell: Callable[[str], None] = lambda sentence: None) -> list[FoundModel]:
    """Return the models that a path means: a zip; in a folder every zip, checkpoints by their steps.

    A run of RL Baselines3 Zoo, `ENV_1/`, holds its settings in `ENV/`, on Hugging Face beside the zip. It means
    `ENV.zip`, else `best_model.zip`, else its checkpoints. `tell` gets a sentence on what is there and what is taken.
    """
    if path.is_file():
        if not is_sb3_zip(path):
            return []
        return [_found(path, _settings_of(path.parent))]
    zips = [each for each in path.glob("*.zip") if each.name != "train_eval_metrics.zip"]  # Hugging Face: RL Zoo's log
    if not zips or any(path.glob("*.safetensors")):
        return []
    zips.sort(key=lambda each: (_checkpoint_steps(each), each.name))
    settings = _settings_of(path)
    taken = zips
    rest = "all"
    if settings is not None:
        for name in ("best_model.zip", f"{settings.name}.zip"):  # the second, if it is there
            if path / name in zips:
                taken = [path / name]
    if taken != zips:
        rest = f"{taken[0].name} (name another file to evaluate that one)"
    tell(f"{path} holds {', '.join(each.name for each in zips)}; evaluating {rest}")
    return [_found(each, settings) for each in taken]


def _checkpoint_steps(path: Path) -> int:
    """Return the steps after which a checkpoint was written; 0 for other models."""
    found = _CHECKPOINT.fullmatch(path.stem)
    if not found:
        return 0
    return int(found[2])


def _settings_of(folder: Path) -> Path | None:
    """Return the folder with the settings of a run of RL Baselines3 Zoo, perhaps the same; None for other folders."""
    places = (folder / "args.yml", *folder.glob("*/args.yml"))
    found = [each.parent for each in places if each.is_file() and each.with_name("config.yml").is_file()]
    if len(found) != 1:
        return None
    return found[0]


def _pairs(path: Path) -> dict[str, str]:
    with path.open("rb") as file:
        found = _PAIR.findall(file.read(1_000_000).decode("utf-8", "replace"))
    if not found:
        raise PerdureError(f"{path} is not as RL Baselines3 Zoo writes it (yaml.dump of an OrderedDict)")
    return {name: " ".join(value.strip("'\"").split()) for name, value in found}


def _found(path: Path, folder: Path | None) -> FoundModel:
    """Return a model with what the settings in a folder say."""
    places = []
    step = _CHECKPOINT.fullmatch(path.stem)
    if step:
        places.append(path.with_name(f"{step[1]}_vecnormalize_{step[2]}_steps.pkl"))
    if folder is not None:
        places += [folder / "vec_normalize.pkl", folder / "vecnormalize.pkl"]
    normalizer = next((str(each) for each in places if each.is_file()), None)
    if folder is None:
        return FoundModel(path, normalizer=normalizer)
    args = _pairs(folder / "args.yml")
    config = _pairs(folder / "config.yml")
    if config.get("normalize", "false") == "false":
        normalizer = NO_NORMALIZER
    elif normalizer is None:
        raise PerdureError(f"{path} was trained behind VecNormalize, but {places[-1]} is missing")
    changes = {name: config.get(name, "null") for name in ("env_wrapper", "frame_stack")}
    changes["env_kwargs"] = args.get("env_kwargs", "null")
    time_feature = None
    if re.fullmatch(r"(- )?[\w.]+\.TimeFeatureWrapper", changes["env_wrapper"]):
        time_feature = "linear"
        del changes["env_wrapper"]
    unread = [f"{name} {value}" for name, value in changes.items() if value not in ("null", "1", "{}")]
    return FoundModel(path, args.get("env"), normalizer, time_feature, ", ".join(unread))
