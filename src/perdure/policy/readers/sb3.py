"""Read a Stable-Baselines3 or sb3-contrib zip without these libraries, without PyTorch and without running its code.

Settings are the plain JSON values of the zip's member `data`. Whatever is not plain JSON is stored there as pickled
code (`:serialized:`). It is never decoded. Beside it stand the texts of its parts, which say enough: the class of the
activation function, the shape and the bounds of a space.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perdure.errors import PerdureError
from perdure.policy.files import MOST_CHOICES
from perdure.policy.policy import TanhSquash
from perdure.policy.readers.restricted_pickle import TorchState, ZipMembers
from perdure.runs import read_bounded

USE_A_FUNCTION = "perdure.extrapolate(function, env=...) takes any function from observations to actions"
"""Where policies go that cannot be read."""
ACTOR_CRITIC = "stable_baselines3.common.policies"
SAC = "stable_baselines3.sac.policies"
TQC = "sb3_contrib.tqc.policies"
TD3 = "stable_baselines3.td3.policies"
DQN = "stable_baselines3.dqn.policies"
QRDQN = "sb3_contrib.qrdqn.policies"
ARS = "sb3_contrib.ars.policies"
EXTRACTORS = tuple(
    f"<class 'stable_baselines3.common.torch_layers.{name}'>" for name in ("FlattenExtractor", "CombinedExtractor")
)
"""Features extractors that only join the parts of an observation: of one vector, and of a dictionary."""
_LAYER = r"\.(\d+)\.(?:weight|bias)"


@dataclass(frozen=True)
class _Network:
    """Where the state dict of a policy class has the layers between observation and action."""

    layers: tuple[str, ...]
    """Numbered layers, PREFIX.0, PREFIX.2, ..., one prefix after another."""
    last: tuple[str, ...] = ()
    """Names that the layer after these may have."""
    others: str = ""
    """Pattern of the names of what else is there, such as a critic."""
    activation: str = "relu"
    """Between layers, by default."""


NETWORKS = {
    ACTOR_CRITIC: _Network(
        ("mlp_extractor.shared_net", "mlp_extractor.policy_net"),
        ("action_net",),
        rf"mlp_extractor\.value_net{_LAYER}|value_net\.(weight|bias)|log_std",
        "tanh",
    ),
    **dict.fromkeys(
        (SAC, TQC),
        _Network(("actor.latent_pi",), ("actor.mu.0", "actor.mu"), r"actor\.log_std((\.0)?\.(weight|bias))?|critic.*"),
    ),
    TD3: _Network(("actor.mu",), others=r"(actor_target|critic).*"),
    DQN: _Network(("q_net.q_net",), others=r"q_net_target\..*"),
    QRDQN: _Network(("quantile_net.quantile_net",), others=r"quantile_net_target\..*"),
    ARS: _Network(("action_net",), ("action_net",)),  # the linear policy of old versions has no number
}
"""By the module of the policy class."""
TORCH_ACTIVATIONS = {
    **{"ReLU": "relu", "Tanh": "tanh", "ELU": "elu", "SELU": "selu", "LeakyReLU": "leaky_relu", "Sigmoid": "sigmoid"},
    **{"SiLU": "silu", "GELU": "gelu", "Softplus": "softplus", "Mish": "mish"},
}
"""Classes of `torch.nn` and our names."""
_SIGNS = (
    ("ARS", "delta_std_schedule"),
    ("QRDQN", "n_quantiles"),
    ("DQN", "exploration_fraction"),
    ("TRPO", "cg_max_steps"),
    ("PPO", "clip_range"),
    ("A2C", "normalize_advantage"),
    ("TQC", "top_quantiles_to_drop_per_net"),
    ("SAC", "target_entropy"),
    ("TD3", "policy_delay"),
)
"""Algorithms, each with a setting that those below it do not have."""
_HARMLESS = {
    *("net_arch", "activation_fn", "squash_output", "clip_mean", "features_extractor_class"),
    *("use_sde", "log_std_init", "full_std", "use_expln", "ortho_init", "normalize_images", "n_critics", "n_quantiles"),
    *("optimizer_class", "optimizer_kwargs", "share_features_extractor", "features_extractor_kwargs", "with_bias"),
}
"""Settings of a policy that are read, or do not change what it does once it is trained."""
MAX_FILE = 1_000_000_000
"""Bytes of the zip."""
MAX_SETTINGS = 64_000_000
"""Bytes of its settings, unpacked; they may hold the last observations."""
MAX_WEIGHTS = 512_000_000
"""Bytes of its weights, unpacked."""
MAX_LAYERS = 32
Layer = tuple[NDArray[np.float32], NDArray[np.float32]]
"""Weight (in, out) and bias (out,)."""


@dataclass(frozen=True, eq=False)
class Sb3Model:
    """Contents of a zip that a policy needs."""

    settings: Sb3Settings
    layers: list[Layer]
    """From observation to action."""
    version: str
    """Of the Stable-Baselines3 that wrote it; "" if unknown."""
    gym: str = ""
    """The Gym or Gymnasium of training, such as "Gym 0.19.0"; "" if unknown."""


def read_sb3(path: Path) -> Sb3Model:
    """Return the deterministic policy in a zip that `model.save` wrote.

    Raises:
        PerdureError: If the zip is damaged, too large or holds a policy of a kind that is not read.
        OSError: If it cannot be read.
    """
    what = str(path)
    members = ZipMembers(read_bounded(path, MAX_FILE), what)
    settings = read_settings(members.read("data", MAX_SETTINGS), what)
    state = TorchState(members.read("policy.pth", MAX_WEIGHTS), f"{what}: policy.pth")
    version = ""
    if "_stable_baselines3_version" in members.names:
        version = members.read("_stable_baselines3_version", 100).decode("ascii", "replace")
    if not re.fullmatch(r"[\w.]+", version):
        version = ""
    return Sb3Model(settings, read_layers(state.names, state.array, settings, what), version, read_gym(members))


def read_gym(members: ZipMembers) -> str:
    """Return the Gym or Gymnasium that training ran on, as the zip's `system_info.txt` has it; "" if it does not."""
    if "system_info.txt" not in members.names:
        return ""
    text = members.read("system_info.txt", 100_000).decode("utf-8", "replace")
    found = dict(re.findall(r"^(?:- )?(Gym|Gymnasium): ([\w.+]{1,30})$", text, re.MULTILINE))
    for name in ("Gymnasium", "Gym"):
        if name in found:
            return f"{name} {found[name]}"
    return ""


def is_sb3_zip(path: Path) -> bool:
    """Return whether a file is meant to be a model of Stable-Baselines3: named .zip, or a zip archive."""
    if path.suffix.lower() == ".zip":
        return True
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(4) == b"PK\x03\x04"


# Settings


@dataclass(frozen=True, eq=False)
class Sb3Settings:
    """Settings of the policy in a zip."""

    algorithm: str
    """Such as "PPO"."""
    policy_module: str
    """Module of the policy class, a key of ``NETWORKS``."""
    activation: str
    squash: TanhSquash | None
    """How the output goes through tanh and is stretched to the action box; None: it does not."""
    action_bounds: tuple[NDArray[np.float64], NDArray[np.float64]] | None
    """As written in the zip, rounded; None where it does not say."""
    choices: tuple[int, ...]
    """How many values each component of a discrete action has; empty: actions are continuous."""
    observation_kind: str
    """Name of the space of the observations, such as "Box"."""
    gamma: float
    behind_vecnormalize: bool
    """Whether training certainly ran behind a VecNormalize."""
    shows_vecnormalize: bool
    """Whether the file would show a VecNormalize: models of PPO, A2C, TRPO and ARS that were trained do."""
    seed: int | None
    steps: int | None
    """Environment steps trained, those of earlier trainings included where the file shows them."""


def read_settings(data: bytes, what: str) -> Sb3Settings:
    """Return the settings in `data`; PerdureError if it is no JSON, or of a policy that is not read."""
    try:
        values = json.loads(data)
    except (ValueError, RecursionError):
        raise PerdureError(f"{what}: its settings ('data') are not readable JSON") from None
    if not isinstance(values, dict):
        raise PerdureError(f"{what}: its settings ('data') are not a table")
    observation_kind = _observation_kind(_table(values, "observation_space"), what)
    action_space = _table(values, "action_space")
    choices = _choices(action_space, what)
    kwargs = _table(values, "policy_kwargs")
    policy_class = _table(values, "policy_class")
    module = _policy_module(policy_class, what)
    _check_kwargs(kwargs, what)
    squash = None
    if not choices:
        squash = _squash(values, module, what)
    shows = module in (ACTOR_CRITIC, ARS)
    return Sb3Settings(
        algorithm=next((name for name, sign in _SIGNS if sign in values), "model"),
        policy_module=module,
        activation=_activation(kwargs, module, what),
        squash=squash,
        action_bounds=_action_bounds(action_space),
        choices=choices,
        observation_kind=observation_kind,
        gamma=_float(values.get("gamma", 0.99), "gamma", what),
        behind_vecnormalize=shows and values.get("_last_original_obs") is not None,
        shows_vecnormalize=shows and values.get("_last_obs") is not None,
        seed=_whole(values.get("seed")),
        steps=_trained_steps(values),
    )


def _trained_steps(values: dict[str, Any]) -> int | None:
    """Return the environment steps of all trainings: `learn` begins to count anew when a model is trained further.

    The number of updates goes on. An on-policy learner makes `n_epochs` of them for each rollout, or fewer with a
    limit on the divergence.
    """
    steps = _whole(values.get("num_timesteps"))
    rollout = _whole(values.get("n_steps"))
    updates = _whole(values.get("_n_updates"))
    if not (steps and rollout and updates):
        return steps
    environments = _whole(values.get("n_envs")) or 1
    epochs = _whole(values.get("n_epochs")) or 1
    return max(steps, updates // epochs * rollout * environments)


def _squash(values: dict[str, Any], module: str, what: str) -> TanhSquash | None:
    """Return how the output goes through tanh, by the defaults of the policy's class; None: it does not."""
    kwargs = _table(values, "policy_kwargs")
    clip = _float(kwargs.get("clip_mean", 2.0), "clip_mean", what)
    if module in (SAC, TQC) and values.get("use_sde") is True and clip > 0:
        return TanhSquash(clip)
    squashes = module != ACTOR_CRITIC
    if module == ARS:  # its linear policy does not, its perceptron does
        squashes = "ARSLinearPolicy." not in _short(_table(values, "policy_class").get("__init__"))
    if module in (ACTOR_CRITIC, ARS):
        squashes = kwargs.get("squash_output", squashes) is True
    if squashes:
        return TanhSquash()
    return None


def _table(values: dict[str, Any], name: str) -> dict[str, Any]:
    table = values.get(name)
    if not isinstance(table, dict):
        return {}
    return table


def _observation_kind(space: dict[str, Any], what: str) -> str:
    """Return the name of a space whose observations a perceptron reads as one vector; PerdureError for others."""
    kind = _kind(space)
    shape = space.get("_shape", space.get("shape"))
    if isinstance(shape, list) and len(shape) == 3 and space.get("dtype") == "uint8":
        raise PerdureError(f"{what} is for image observations: {USE_A_FUNCTION}")
    if kind not in ("Box", "Discrete", "MultiDiscrete", "Dict"):
        raise PerdureError(
            f"{what} is for {kind} observations; only vectors (Box), whole numbers (Discrete, MultiDiscrete) and "
            f"dictionaries of these are read from zips: {USE_A_FUNCTION}"
        )
    return kind


def _choices(space: dict[str, Any], what: str) -> tuple[int, ...]:
    """Return how many values each component of a discrete action has; empty for a box."""
    kind = _kind(space)
    if kind == "Box":
        return ()
    if kind not in ("Discrete", "MultiDiscrete"):
        raise PerdureError(
            f"{what} is for {kind} actions; only continuous ones (Box) and discrete ones (Discrete, MultiDiscrete) are "
            f"read from zips: {USE_A_FUNCTION}"
        )
    numbers = _written_numbers(str(space.get("n", space.get("nvec")))[:10_000])
    if numbers is None or not len(numbers) or not ((numbers >= 1) & (numbers <= MOST_CHOICES)).all():
        raise PerdureError(f"{what} does not say how many discrete actions it has")
    return tuple(int(each) for each in numbers)


def _action_bounds(space: dict[str, Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    low = _written_numbers(space.get("low"))
    high = _written_numbers(space.get("high"))
    if low is None or high is None:
        return None
    return low, high


def _written_numbers(text: Any) -> NDArray[np.float64] | None:
    """Parse numbers as NumPy prints them; return None if some are abbreviated."""
    if not isinstance(text, str) or "..." in text:
        return None
    try:
        return np.array([float(word) for word in text.replace("[", " ").replace("]", " ").split()])
    except ValueError:
        return None


def _kind(space: dict[str, Any]) -> str:
    """Return the name of a space's class."""
    found = re.fullmatch(r"<class '[\w.]*?(\w+)'>", _short(space.get(":type:")))
    if found is None:
        return "unknown"
    return found[1]


def _policy_module(policy_class: dict[str, Any], what: str) -> str:
    module = policy_class.get("__module__")
    if not isinstance(module, str) or module not in NETWORKS:
        memory = ""
        if "recurrent" in _short(module):
            memory = " (for RecurrentPPO, its predict with recurrent=True)"
        raise PerdureError(
            f"{what}: its policy class comes from {_short(module)}; read are the MlpPolicy and MultiInputPolicy of "
            f"PPO, A2C, TRPO, SAC, TQC, TD3, DQN, QR-DQN and ARS{memory}: {USE_A_FUNCTION}"
        )
    return module


def _check_kwargs(kwargs: dict[str, Any], what: str) -> None:
    unread = sorted({key for key in kwargs if not key.startswith(":")} - _HARMLESS)
    if _short(kwargs.get("features_extractor_class", EXTRACTORS[0])) not in EXTRACTORS:
        unread.append("features_extractor_class")
    if unread:
        raise PerdureError(
            f"{what}: its policy has the setting {_short(unread[0])}, which is not read: {USE_A_FUNCTION}"
        )


def _activation(kwargs: dict[str, Any], module: str, what: str) -> str:
    written = kwargs.get("activation_fn")
    if written is None:
        return NETWORKS[module].activation
    found = re.fullmatch(r"<class 'torch\.nn\.modules\.activation\.(\w+)'>", _short(written))
    if found is None or found[1] not in TORCH_ACTIVATIONS:
        raise PerdureError(
            f"{what}: its activation function is {_short(written)}; known are {', '.join(TORCH_ACTIVATIONS)}: "
            f"{USE_A_FUNCTION}"
        )
    return TORCH_ACTIVATIONS[found[1]]


def _float(value: Any, name: str, what: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < 1e9:
        raise PerdureError(f"{what}: {name} must be a number, 0 or more; it is {_short(value)}")
    return float(value)


def _whole(value: Any) -> int | None:
    if type(value) is int and 0 <= value < 2**63:
        return value
    return None


def _short(value: Any) -> str:
    """Return a value from the file for a message: printable, and not long."""
    if isinstance(value, list):  # perhaps nested too deeply to be written out
        return "a list"
    if isinstance(value, dict):
        return "a table"
    return "".join(letter if letter.isprintable() else "?" for letter in str(value)[:120])


# Weights


def read_layers(
    names: list[str], array: Callable[[str], NDArray[np.float32]], settings: Sb3Settings, what: str
) -> list[Layer]:
    """Return the layers between observation and action; `array` returns the weights of one of the `names`.

    Raises:
        PerdureError: If the network has other parts than a perceptron, or layers do not fit together.
    """
    layer_names = _layer_names(names, settings, what)
    if len(layer_names) > MAX_LAYERS:
        raise PerdureError(f"{what} has {len(layer_names)} layers; at most {MAX_LAYERS} are read")
    layers = []
    for name in layer_names:
        weight = array(f"{name}.weight")
        if settings.policy_module == ARS and f"{name}.bias" not in names:
            bias = np.zeros(weight.shape[:1], np.float32)
        else:
            bias = array(f"{name}.bias")
        layers.append((weight, bias))
    size: int | None = None
    for name, (weight, bias) in zip(layer_names, layers, strict=True):
        if weight.ndim != 2 or bias.shape != weight.shape[:1] or size not in (None, weight.shape[1]):
            raise PerdureError(f"{what}: layer {name!r} does not fit the layer before it")
        size = weight.shape[0]
    layers = [(np.ascontiguousarray(weight.T), bias) for weight, bias in layers]
    if settings.policy_module == QRDQN:
        layers[-1] = _mean_of_quantiles(layers[-1], sum(settings.choices), what)
    return layers


def _mean_of_quantiles(layer: Layer, choices: int, what: str) -> Layer:
    """Return the layer whose outputs are the mean quantile of each choice: the mean of a linear layer is one."""
    weight, bias = layer
    if not choices or len(bias) % choices:
        raise PerdureError(f"{what}: its network has {len(bias)} quantiles of {choices} actions, which does not fit")
    means = [each.reshape(*each.shape[:-1], -1, choices).mean(axis=-2, dtype=np.float64) for each in (weight, bias)]
    return means[0].astype(np.float32), means[1].astype(np.float32)


def _layer_names(names: list[str], settings: Sb3Settings, what: str) -> list[str]:
    network = NETWORKS[settings.policy_module]
    layers: list[str] = []
    for prefix in network.layers:
        layers += _numbered(names, prefix)
    layers += [name for name in network.last if f"{name}.weight" in names][:1]
    read = "|".join(map(re.escape, (*network.layers, *network.last)))
    known = rf"({read})(\.\d+)?\.(weight|bias)|{network.others}"
    unknown = [name for name in names if not re.fullmatch(known, name)]
    if unknown or not layers:
        part = "no layers"
        if unknown:
            part = "".join(letter for letter in unknown[0][:80] if letter.isprintable())
        raise PerdureError(f"{what}: its policy is not a plain perceptron, it has {part!r}: {USE_A_FUNCTION}")
    return layers


def _numbered(names: list[str], prefix: str) -> Iterator[str]:
    """Yield PREFIX.0, PREFIX.2, ...: between them stand the activation functions, which have no weights."""
    found = [re.fullmatch(rf"{re.escape(prefix)}\.(\d{{1,4}})\.weight", name) for name in names]
    for place in sorted({int(match[1]) for match in found if match}):
        yield f"{prefix}.{place}"
