"""Single Gymnasium environments as lanes: the counting environment's numbers are known by hand."""

import gymnasium
import numpy as np
import pytest
from counting import Counting, factories, first_starts
from gymnasium.envs.registration import EnvSpec
from worlds import counting_world

from perdure.envs import make_world
from perdure.envs.gymnasium import GymnasiumWorld
from perdure.errors import PerdureError


def test_every_number_of_the_counting_environment_arrives() -> None:
    world = counting_world([5, 6], falls_after=3)
    starts = [first_starts(seed, 1)[0] for seed in (5, 6)]
    assert world.reset().tolist() == [[starts[0], 0], [starts[1], 0]]
    first = world.step(np.array([[0.25], [-9.0]]))
    assert first.observations.tolist() == [[starts[0], 1], [starts[1], 1]]
    assert first.rewards.tolist() == [10.25, 9.0]  # the action -9 is clipped to -1
    second = world.step(np.array([[0.0], [0.5]]))
    assert second.rewards.tolist() == [20.0, 20.5]
    assert not second.ended.any()
    third = world.step(np.array([[0.5]]), np.array([1]))
    assert third.observations.tolist() == [[starts[1], 3]]
    assert third.rewards.tolist() == [30.5]
    assert third.terminated.tolist() == [True]
    assert third.elapsed.tolist() == [3]


def test_a_lane_draws_its_starts_from_its_seed_alone() -> None:
    world = counting_world([5, 6])
    starts = [world.reset()[0, 0]]
    for _ in range(3):
        world.reset(np.array([1, 0]))  # twice as often as lane 0 alone would make lane 1 differ, not lane 0
        starts.append(world.reset(np.array([0]))[0, 0])
    expected = first_starts(5, 7)
    assert starts == [expected[0], expected[2], expected[4], expected[6]]


def test_only_the_lanes_that_are_named_are_stepped() -> None:
    built = [Counting() for _ in range(3)]
    world = GymnasiumWorld([lambda one=one: one for one in built], [1, 2, 3])
    world.reset()
    for _ in range(4):
        world.step(np.zeros((1, 1)), np.array([2]))
    world.step(np.zeros((2, 1)), np.array([1, 2]))
    assert [one.steps for one in built] == [0, 1, 5]
    assert [one.resets for one in built] == [1, 1, 1]


def test_a_dictionary_observation_is_joined_in_the_order_of_its_space() -> None:
    world = counting_world([5], as_dict=True)
    assert world.spec.observation_size == 2
    world.reset()
    assert world.step(np.zeros((1, 1))).observations.tolist() == [[first_starts(5, 1)[0], 1]]


def test_a_time_limit_inside_a_factory_is_reported_as_truncated() -> None:
    world = GymnasiumWorld([lambda: gymnasium.wrappers.TimeLimit(Counting(), 2)], [5])
    world.reset()
    world.step(np.zeros((1, 1)))
    step = world.step(np.zeros((1, 1)))
    assert step.truncated[0]
    assert not step.terminated[0]


def test_a_registered_environment_comes_without_its_own_limit() -> None:
    world = make_world("gymnasium:Pendulum-v1", [3])
    assert world.spec.default_horizon == 200
    assert world.spec.engine == f"Gymnasium {gymnasium.__version__}"
    world.reset()
    for _ in range(201):
        step = world.step(np.zeros((1, 1)))
    assert not step.ended[0]
    assert step.elapsed[0] == 201


def test_a_limit_inside_a_registered_environment_is_lifted_and_says_the_training_horizon(monkeypatch) -> None:
    inner = EnvSpec("Limited-v0", lambda: gymnasium.wrappers.TimeLimit(Counting(), 2))
    monkeypatch.setitem(gymnasium.registry, "Limited-v0", inner)
    world = make_world("gymnasium:Limited-v0", [5])
    assert world.spec.default_horizon == 2
    world.reset()
    assert [bool(world.step(np.zeros((1, 1))).ended[0]) for _ in range(3)] == [False] * 3


def test_a_mujoco_environment_names_its_engine() -> None:
    mujoco = pytest.importorskip("mujoco")
    engine = make_world("gymnasium:Hopper-v5", [3]).spec.engine
    assert engine == f"Gymnasium {gymnasium.__version__}, MuJoCo {mujoco.__version__}"


class Worded(Counting):
    """Its actions are words."""

    def __init__(self) -> None:
        super().__init__()
        self.action_space = gymnasium.spaces.Text(5)


def test_what_does_not_fit_the_contract_is_refused_with_a_reason() -> None:
    with pytest.raises(PerdureError, match="Text"):
        GymnasiumWorld([Worded], [1])
    with pytest.raises(PerdureError, match=r"2.*1"):
        GymnasiumWorld(factories(2), [1])
    with pytest.raises(PerdureError, match="same spaces"):
        GymnasiumWorld([Counting, lambda: Counting(as_dict=True)], [1, 2])
    with pytest.raises(PerdureError, match="did you mean 'gymnasium:Pendulum-v1"):
        make_world("gymnasium:pendulum-v1", [1])
    with pytest.raises(PerdureError, match=r"did you mean 'gymnasium:gymnasium\.envs:Pendulum-v1"):
        make_world("gymnasium:gymnasium.envs:Pendulm-v1", [1])
    with pytest.raises(PerdureError, match="no_such_module"):
        make_world("gymnasium:no_such_module:Thing-v0", [1])


def test_observations_of_varying_length_are_refused() -> None:
    class Varying(Counting):
        def __init__(self) -> None:
            super().__init__()
            self.observation_space = gymnasium.spaces.Sequence(gymnasium.spaces.Box(0, 1, (1,)))

    with pytest.raises(PerdureError, match="vector"):
        GymnasiumWorld([Varying], [1])


def test_closing_closes_every_environment_once() -> None:
    closed = []

    class Closing(Counting):
        def close(self) -> None:
            closed.append(self)

    world = GymnasiumWorld([Closing, Closing], [1, 2])
    world.close()
    world.close()
    assert len(closed) == 2


def test_environments_made_before_one_that_fails_are_closed() -> None:
    closed = []

    class Closing(Counting):
        def close(self) -> None:
            closed.append(self)
            raise OSError("it does not close")

    def fails() -> None:
        raise RuntimeError("no more")

    with pytest.raises(PerdureError, match="no more"):
        GymnasiumWorld([Closing, Closing, fails], [1, 2, 3])
    assert len(closed) == 2
    with pytest.raises(PerdureError, match="same spaces"):
        GymnasiumWorld([Closing, lambda: Closing(as_dict=True)], [1, 2])
    assert len(closed) == 4


def test_one_environment_for_two_lanes_is_refused() -> None:
    one = gymnasium.make("Pendulum-v1")
    with pytest.raises(PerdureError, match="same environment"):
        GymnasiumWorld([lambda: one, lambda: one], [0, 1], "pendulum")
