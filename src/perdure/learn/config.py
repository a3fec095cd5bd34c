"""PPO settings: the arguments of Stable-Baselines3's `PPO`, plus the horizon protocol."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, cast, get_args

from perdure.errors import PerdureError
from perdure.horizon import Fixed, HorizonProtocol, usual_preset
from perdure.learn.advantages import make_estimator
from perdure.learn.algorithm import Algorithm, Configuration, Stage

if TYPE_CHECKING:
    from perdure.envs import TaskSpec
    from perdure.policy import Policy

Activation = Literal["relu", "tanh", "elu", "selu", "leaky_relu", "sigmoid", "silu", "gelu", "softplus", "mish"]
Decay = Literal["none", "linear"]
Conditioning = Literal["concatenate", "film", "critic"]
OMITTED_DEFAULTS = (
    "learning_rate_decay",
    "log_std_end",
    "log_std_fall",
    "estimator",
    "conditioning",
    "clip_obs",
    "then",
)
"""Settings that stored runs and policy files name only where they differ from their default."""
CONTINUED_LOG_STD = -1.0
"""Largest log standard deviation with which training continues by default. At the usual start value of 0, noise as wide
as the action range would make a trained robot fall within steps."""


@dataclass(frozen=True)
class Further:
    """Further training of the same network, see `perdure.learn.recipe`.

    Raises:
        PerdureError: If a number is out of its range.
    """

    gamma: float = 0.999
    """Discount; that of the first training is kept where it is higher and below 1."""
    total_steps: int = 300_000
    """Environment steps."""
    disturb: tuple[str, ...] = ("action_noise:0.1",)
    """What disturbs every training episode, all together."""

    def __post_init__(self) -> None:
        if not 0 <= self.gamma <= 1:
            raise PerdureError(f"gamma is {self.gamma!r}; it must be a number in [0, 1]")
        if self.total_steps < 1:
            raise PerdureError(f"total_steps is {self.total_steps!r}; it must be at least 1")


@dataclass(frozen=True)
class PPOConfig(Configuration):
    """Settings of a training run, without task and seed. The defaults are those of Stable-Baselines3's ``PPO``.

    gamma is part of the protocol, because it belongs to the horizon.

    Raises:
        PerdureError: If a value is out of its range or the rollout cannot be cut into whole minibatches.
    """

    name: ClassVar[str] = "ppo"
    presets: ClassVar[tuple[str, ...]] = ("zoo", "cleanrl")

    protocol: HorizonProtocol = field(
        default_factory=lambda: HorizonProtocol(None, Fixed(1000), "truncated", gamma=0.99, normalizer_gamma=0.99)
    )
    """How training treats time: embedding, training horizon T, meaning of its end, discounts."""
    total_steps: int = 1_000_000
    """Environment steps to train for, over all environments; rounded up to whole rollouts."""
    n_envs: int = 1
    """Environments of one seed, stepped side by side."""
    n_steps: int = 2048
    """Steps of each environment in one rollout."""
    batch_size: int = 64
    """Transitions in one minibatch; must divide n_envs * n_steps."""
    n_epochs: int = 10
    """Passes over each rollout."""
    gae_lambda: float = 0.95
    """lambda of the generalized advantage estimate."""
    learning_rate: float = 3e-4
    """Adam's step size."""
    clip_range: float = 0.2
    """Epsilon of the clipped policy ratio."""
    ent_coef: float = 0.0
    """Weight of the entropy bonus."""
    vf_coef: float = 0.5
    """Weight of the value loss."""
    max_grad_norm: float = 0.5
    """Global norm to which a gradient is clipped."""
    hidden_sizes: tuple[int, ...] = (64, 64)
    """Widths of the hidden layers of the policy and of the value network, which share no weights."""
    activation: Activation = "tanh"
    """Non-linearity of the hidden layers."""
    log_std_init: float = 0.0
    """Start value of the log standard deviation, which does not depend on the observation."""
    ortho_init: bool = True
    """Orthogonal start weights; otherwise torch's default (uniform, 1 / sqrt(fan in))."""
    segment_steps: int = 50_000
    """Steps between checkpoints, rounded to whole rollouts. At each checkpoint the environments are rebuilt from
    (seed, segment), interrupted or not, so the result of a run depends on this number."""
    learning_rate_decay: Decay = "none"
    """`linear`: at iteration i of n the step size is learning_rate * (1 - (i + 1) / n), as SB3's linear schedule."""
    log_std_end: float | None = None
    """Upper limit of the log standard deviation, reached linearly from `log_std_init`; None: no limit. Deployment uses
    the mean action, so the policy must not rely on exploration noise."""
    log_std_fall: tuple[float, float] = (0.0, 0.6)
    """Shares of the run at which the upper limit starts and stops falling."""
    estimator: str = "discounted"
    """How advantages are estimated: `discounted` (GAE), or `average-reward`, with options such as
    `average-reward:reset_cost=10`."""
    conditioning: Conditioning = "concatenate"
    """How phi enters the networks: `concatenate` appends it to the observation; `film` lets it scale and shift the
    hidden layers, see `perdure.learn.networks`; `critic` shows it to the value network only."""
    clip_obs: float = 10.0
    """Normalized observations are clipped to +-clip_obs, as in Stable-Baselines3's VecNormalize."""
    then: Further | None = None
    """Further training in the same run; None: none."""

    def __post_init__(self) -> None:

        def require(condition: bool, name: str, valid: str) -> None:
            if not condition:
                raise PerdureError(f"{name} is {getattr(self, name)!r}; it must be {valid}")

        for name in ("total_steps", "n_envs", "n_steps", "batch_size", "n_epochs", "segment_steps"):
            require(getattr(self, name) >= 1, name, "at least 1")
        for each in dataclasses.fields(self):
            value = getattr(self, each.name)
            require(not isinstance(value, float) or math.isfinite(value), each.name, "a finite number")
        for name in ("learning_rate", "clip_range", "max_grad_norm", "clip_obs"):
            require(getattr(self, name) > 0, name, "a positive number")
        for name in ("ent_coef", "vf_coef"):
            require(getattr(self, name) >= 0, name, "0 or more")
        for name, kind in (("learning_rate_decay", Decay), ("conditioning", Conditioning), ("activation", Activation)):
            require(getattr(self, name) in get_args(kind), name, " or ".join(map(repr, get_args(kind))))
        require(0 <= self.gae_lambda <= 1, "gae_lambda", "in [0, 1]")
        ceiling = f"None or at most log_std_init = {self.log_std_init}"
        require(self.log_std_end is None or self.log_std_end <= self.log_std_init, "log_std_end", ceiling)
        begin, end = self.log_std_fall
        require(0 <= begin < end <= 1, "log_std_fall", "two shares that grow, from 0 to 1")
        if self.conditioning != "concatenate":
            reason = "'concatenate' for a policy without an embedding"
            require(self.protocol.embedding is not None, "conditioning", reason)
            reason = "'concatenate' if protocol.normalize_embedding is set"
            require(not self.protocol.normalize_embedding, "conditioning", reason)
        require(bool(self.hidden_sizes) and min(self.hidden_sizes) >= 1, "hidden_sizes", "widths")
        divisor = f"a divisor of n_envs * n_steps = {self.rollout_size}"
        require(self.rollout_size % self.batch_size == 0, "batch_size", divisor)
        require(
            self.learning_rate_decay == "none" or self.total_steps > self.rollout_size,
            "total_steps",
            f"more than one rollout of {self.rollout_size} steps, because learning_rate_decay is 'linear': the last "
            "iteration learns nothing",
        )
        make_estimator(self)  # refuses a name or a number that it does not know

    @property
    def rollout_size(self) -> int:
        """Return the transitions in one rollout."""
        return self.n_envs * self.n_steps

    @property
    def iteration_steps(self) -> int:
        """Return the environment steps of one iteration: one rollout."""
        return self.rollout_size

    @classmethod
    def methods(cls) -> tuple[str, ...]:
        """Return the methods of `perdure.learn.METHODS`."""
        from perdure.learn.presets import METHODS

        return tuple(METHODS)

    @classmethod
    def usual_preset(cls, task: str) -> str:
        """See `perdure.horizon.usual_preset`."""
        return usual_preset(task)

    @classmethod
    def of_method(cls, method: str, task: str, observation_size: int, preset: str | None, limit: int) -> Self:
        """See `perdure.learn.method_config`."""
        from perdure.learn.presets import method_config

        return cast(Self, method_config(method, task, observation_size, preset, limit))

    def make(self, spec: TaskSpec) -> Algorithm:
        """Return the learner, `perdure.learn.ppo.PPO`."""
        from perdure.learn.ppo import PPO

        return PPO(self, spec)

    def continued(self, policy: Policy) -> Self:
        """Return settings that fit a policy: its layers, activation and clipping, and less noise than at the start.

        Raises:
            PerdureError: No training here can continue a policy of this kind.
        """
        from perdure.learn.start import check_policy

        check_policy(policy)
        layers = sum(name.startswith("policy.") and name.endswith(".weight") for name in policy.weights)
        hidden = [policy.weights[f"policy.{layer}.bias"] for layer in range(layers - 1)]
        return dataclasses.replace(
            self,
            hidden_sizes=tuple(len(bias) for bias in hidden),
            activation=cast(Activation, policy.activation),  # another one is refused
            log_std_init=min(self.log_std_init, CONTINUED_LOG_STD),
            log_std_end=None,
            clip_obs=policy.normalizer.clip,
        )

    def stages(self, task: str) -> tuple[Stage, ...]:
        """Return the training of these settings and, where there is one, the further training that follows it."""
        if self.then is None:
            return (Stage(self),)
        from perdure.learn.recipe import further_config

        return Stage(self), Stage(further_config(self, task), self.then.disturb)

    def advice(self, facts: Mapping[str, float]) -> str:
        """Return that an early end pays, and the flag for a quieter start; "" where that does no lasting harm.

        With a discount PPO recovers. With the average reward a fall is a cost and ends nothing.
        """
        from perdure.learn.first_rollout import REWARD, ending_pays

        limited = self.protocol.gamma < 1 or self.estimator.partition(":")[0] != PPOConfig.estimator
        if limited or not ending_pays(facts):
            return ""
        return (
            f"a step of the first rollout earns {facts[REWARD]:.2f} and episodes end early, so an early end pays "
            "better than going on, which a method without a discount may learn; start with less noise: "
            f"--ppo.log-std-init {self.log_std_init - 1:g}"
        )

    def to_json(self) -> dict[str, Any]:
        """Return the settings as plain JSON values, without those of `OMITTED_DEFAULTS` that have their default."""
        values = {each.name: getattr(self, each.name) for each in dataclasses.fields(self)}
        for name in OMITTED_DEFAULTS:
            if values[name] == getattr(PPOConfig, name):
                del values[name]
        values["protocol"] = self.protocol.to_json()
        if self.then is not None:
            values["then"] = {**dataclasses.asdict(self.then), "disturb": list(self.then.disturb)}
        return {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}
