"""Evolution strategies (Salimans et al., 2017) for perdure: a package of its own that touches no file of perdure."""

from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np

from perdure.horizon import Fixed, HorizonProtocol
from perdure.learn.algorithm import Configuration, Metrics
from perdure.policy import Normalizer, Policy, TaskInfo


@dataclass(frozen=True)
class EvolutionStrategies(Configuration):
    """A linear policy: each environment tries a perturbation of its weights, or the opposite one."""

    name: ClassVar[str] = "evolution-strategies"
    protocol: HorizonProtocol = field(default_factory=lambda: HorizonProtocol(None, Fixed(200), "truncated", 1.0, 1.0))
    total_steps: int = 48_000
    n_envs: int = 16
    segment_steps: int = 16_000
    sigma: float = 0.5
    step_size: float = 4.0

    @classmethod
    def of_method(cls, method, task, observation_size, preset, limit):
        return cls()

    @property
    def iteration_steps(self):
        return self.n_envs * self.protocol.horizon.steps

    def make(self, spec):
        return Learner(self, spec)


class State(NamedTuple):
    weights: np.ndarray


class Learner:
    diagnostics = ("norm",)

    def __init__(self, config, spec):
        self.config, self.spec = config, spec

    def init(self, seed, start=None):
        return State(np.zeros((self.spec.observation_size + 1, self.spec.action_size)))

    def start(self, state, slot, observations, *, seed, segment):
        return state, slot

    def iterate(self, state, slot, *, seed, iteration):
        config, world = self.config, slot.world
        rng = np.random.default_rng([seed, iteration])
        half = rng.normal(size=(config.n_envs // 2, *state.weights.shape))
        noise = np.concatenate([half, -half])
        tried = state.weights + config.sigma * noise
        observations, returns = world.reset(), np.zeros(config.n_envs)
        lengths = np.zeros(config.n_envs)
        alive = np.arange(config.n_envs)
        for _ in range(config.protocol.horizon.steps):
            inputs = np.concatenate([observations, np.ones((len(alive), 1))], axis=1)
            actions = np.einsum("ni,nia->na", inputs, tried[alive])
            step = world.step(np.clip(actions, self.spec.action_low, self.spec.action_high), alive)
            returns[alive] += step.rewards
            lengths[alive] += 1
            alive, observations = alive[~step.ended], step.observations[~step.ended]
            if not len(alive):
                break
        ranks = returns.argsort().argsort() / (config.n_envs - 1) - 0.5
        weights = state.weights + config.step_size * np.einsum("n,nia->ia", ranks, noise) / config.n_envs
        steps = np.full(config.n_envs, (iteration + 1) * config.iteration_steps)
        return (
            State(weights),
            slot,
            Metrics(np.stack([steps, returns, lengths], axis=1), {"norm": float(np.linalg.norm(weights))}),
        )

    def observation_std(self, state):
        return np.ones(self.spec.observation_size)

    def policy(self, state):
        weights = state.weights.astype(np.float32)
        layer = {"policy.0.weight": weights[:-1], "policy.0.bias": weights[-1]}
        identity = Normalizer.identity(self.spec.observation_size)
        return Policy(TaskInfo.of(self.spec), layer, "tanh", identity, self.config.protocol)
