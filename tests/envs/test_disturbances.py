"""Disturbances against closed forms and against the same world without them."""

from types import SimpleNamespace

import gymnasium
import mujoco
import numpy as np
import pytest

from perdure.disturbances import Disturber, Effect, parse_disturbance, parse_disturbances
from perdure.envs import make_world
from perdure.envs.disturbances import SIMULATED, DisturbedWorld, disturbed_task
from perdure.envs.gymnasium import GymnasiumWorld
from perdure.errors import PerdureError
from perdure.policy import TaskInfo
from perdure.policy.closed_loop import check_fit
from perdure.wrappers import Disturb


class Echo(gymnasium.Env):
    """Observes the action that acted."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float64)
    action_space = gymnasium.spaces.Box(np.array([-1.0, 0.0]), np.array([1.0, 4.0]), dtype=np.float64)

    def reset(self, *, seed=None, options=None):
        return np.zeros(2), {}

    def step(self, action):
        return np.array(action, np.float64), 0.0, False, False, {}


def echoed(*texts, seeds=(5,), steps=4000, action=(0.0, 2.0), std=None):
    """The observations of every step, shape (steps, lanes, 2)."""
    world = GymnasiumWorld([Echo] * len(seeds), list(seeds))
    disturbed = DisturbedWorld(world, [parse_disturbance(text) for text in texts], seeds, std)
    disturbed.reset()
    return np.stack([disturbed.step(np.tile(action, (len(seeds), 1))).observations for _ in range(steps)])


def test_action_noise_has_the_stated_spread_and_never_leaves_the_box():
    acted = echoed("action_noise:0.1")[:, 0]
    assert acted.mean(axis=0) == pytest.approx([0.0, 2.0], abs=0.02)
    assert acted.std(axis=0) == pytest.approx([0.1, 0.2], rel=0.05)  # half ranges 1 and 2
    assert abs(np.corrcoef(acted[:-1, 0], acted[1:, 0])[0, 1]) < 0.05
    wild = echoed("action_noise:3", steps=500)[:, 0]
    assert wild.min(axis=0) == pytest.approx([-1.0, 0.0])
    assert wild.max(axis=0) == pytest.approx([1.0, 4.0])


def test_observation_noise_is_in_units_of_the_spread_in_training():
    seen = echoed("observation_noise:0.5", std=np.array([[2.0, 0.1]]))[:, 0]
    assert seen.std(axis=0) == pytest.approx([1.0, 0.05], rel=0.05)
    with pytest.raises(PerdureError, match="spread of the observations"):
        echoed("observation_noise:0.5")


def test_a_delayed_action_acts_that_many_steps_later():
    world = GymnasiumWorld([Echo], [0])
    disturbed = DisturbedWorld(world, [parse_disturbance("action_delay:3")], [0])
    for _ in range(2):  # the queue of one episode does not reach the next
        disturbed.reset()
        acted = [disturbed.step(np.array([[0.1 * k, 1.0]])).observations[0, 0] for k in range(1, 8)]
        assert acted == pytest.approx([0.0, 0.0, 0.0, 0.1, 0.2, 0.3, 0.4])


def test_an_episode_meets_the_same_draws_alone_and_beside_others():
    alone, beside = echoed("action_noise:0.1", steps=600), echoed("action_noise:0.1", seeds=(1, 5), steps=600)
    assert (alone[:, 0] == beside[:, 1]).all()
    assert not np.isclose(beside[:, 0], beside[:, 1]).all()


def pushed(*texts, steps=202):
    """Observations of a Hopper that does nothing, without ends."""
    world = make_world("gymnasium:Hopper-v4", [3])
    disturbed = DisturbedWorld(world, [parse_disturbance(text) for text in texts], [3])
    disturbed.reset()
    (env,) = world.environments
    env.unwrapped.model.opt.gravity[:] = 0.0  # it floats, so that it lasts
    env.unwrapped._healthy_z_range = env.unwrapped._healthy_angle_range = (-np.inf, np.inf)
    speeds = []
    for _ in range(steps):
        disturbed.step(np.zeros((1, 3)))
        speeds.append(env.unwrapped.data.qvel.copy())
    world.close()
    return np.array(speeds)


def test_a_push_changes_the_speed_of_the_root_once_in_200_steps():
    calm, disturbed = pushed(), pushed("push:0.5")
    assert (calm[:200] == disturbed[:200]).all()
    change = disturbed[200, 0] - calm[200, 0]
    assert 1e-3 < abs(change) < 0.6
    assert (pushed("push:0") == calm).all()


def test_a_lagging_action_approaches_the_command_geometrically():
    acted = echoed("lag:0.5", steps=4, action=(1.0, 4.0))[:, 0, 0]
    assert acted == pytest.approx([0.5, 0.75, 0.875, 0.9375])


BOX = """<mujoco><worldbody><body name="root" pos="0 0 1"><freejoint/>
<geom type="box" size=".1 .2 .3" euler="20 30 40" mass="5"/>{}</body></worldbody></mujoco>"""


def change(model, *texts):
    """Disturb a model of MuJoCo; return the disturber, whose lane 0 it is."""
    env = SimpleNamespace(unwrapped=SimpleNamespace(model=model, data=mujoco.MjData(model)))
    return Disturber("a box", parse_disturbances(texts), [0], None, None, [env])


def test_a_payload_equals_a_small_heavy_ball_in_front_of_the_center():
    mine = mujoco.MjModel.from_xml_string(BOX.format(""))
    change(mine, "payload:0.2")
    ball = '<geom type="sphere" size="1e-4" mass="1" pos="0.1 0 0"/>'
    theirs = mujoco.MjModel.from_xml_string(BOX.format(ball))

    def inertia(model):
        axes = np.zeros(9)
        mujoco.mju_quat2Mat(axes, model.body_iquat[1])
        return axes.reshape(3, 3) @ np.diag(model.body_inertia[1]) @ axes.reshape(3, 3).T

    assert mine.body_mass[1] == pytest.approx(theirs.body_mass[1])
    assert mine.body_ipos[1] == pytest.approx(theirs.body_ipos[1])
    assert inertia(mine) == pytest.approx(inertia(theirs), abs=1e-7)


def test_on_a_slope_a_free_body_falls_backward():
    model = mujoco.MjModel.from_xml_string(BOX.format(""))
    change(model, "slope:30")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.qacc[:3] == pytest.approx([-0.5 * 9.81, 0.0, -(3**0.5) / 2 * 9.81])


def test_half_the_time_step_keeps_the_control_rate():
    world = make_world("gymnasium:Hopper-v4", [0])
    env = world.environments[0].unwrapped
    before = env.dt, env.model.opt.timestep, env.frame_skip
    DisturbedWorld(world, [parse_disturbance("time_step:0.5")], [0])
    assert (env.dt, env.model.opt.timestep, env.frame_skip) == (before[0], before[1] / 2, before[2] * 2)
    world.close()


@pytest.mark.parametrize("steps", [1, 3, 6, 7, 12])
def test_a_time_step_is_the_one_that_its_label_names(steps):
    """Units of an evaluation read the label, which has six digits."""
    label = parse_disturbance(f"time_step:{4 / steps}").label
    world = make_world("gymnasium:Hopper-v4", [0])
    DisturbedWorld(world, [parse_disturbance(label)], [0])
    assert world.environments[0].unwrapped.frame_skip == steps
    world.close()


@pytest.mark.parametrize(("task", "level"), [("HalfCheetah-v4", 2.0), ("Hopper-v4", 3.0), ("Hopper-v4", 10.0)])
def test_a_time_step_that_changes_the_control_rate_is_refused(task, level):
    world = make_world(f"gymnasium:{task}", [0])
    with pytest.raises(PerdureError, match=rf"time_step:{level:g} is not \d divided by a whole number"):
        DisturbedWorld(world, [parse_disturbance(f"time_step:{level:g}")], [0])
    world.close()


def test_a_robot_with_discrete_actions_is_pushed():
    class Still(gymnasium.ActionWrapper):
        action_space = gymnasium.spaces.Discrete(1)

        def action(self, action):
            return np.zeros(3)

    def last(*disturbances):
        hopper = gymnasium.make("Hopper-v4", max_episode_steps=-1, terminate_when_unhealthy=False)
        env = Disturb(Still(hopper), disturbances, 0)
        env.reset(seed=0)
        return np.array([env.step(0)[0] for _ in range(203)])

    calm, pushed = last(), last("push:2")
    assert np.array_equal(calm[:200], pushed[:200])
    assert np.abs(calm[-1] - pushed[-1]).max() > 0.1


def test_factors_change_the_model():
    calm, heavy = make_world("gymnasium:Hopper-v4", [0]), make_world("gymnasium:Hopper-v4", [0])
    DisturbedWorld(heavy, [parse_disturbance(text) for text in ("mass:1.2", "friction:0.5", "strength:0.9")], [0])
    before, after = (world.environments[0].unwrapped.model for world in (calm, heavy))
    assert after.body_mass == pytest.approx(before.body_mass * [1, 1.2, 1, 1, 1])
    assert after.geom_friction[:, 0] == pytest.approx(0.5 * before.geom_friction[:, 0])
    assert after.actuator_gear == pytest.approx(0.9 * before.actuator_gear)
    assert after.body_subtreemass[1] == pytest.approx(after.body_mass[1:].sum())


HIDDEN = {"Hopper": 1, "Walker2d": 1, "HalfCheetah": 1, "Swimmer": 2, "Ant": 2, "Humanoid": 2}
"""Positions along the ground, which observations do not show."""


@pytest.mark.parametrize("task", SIMULATED)
def test_gymnasiums_copy_makes_the_same_steps_as_envpool(task):
    """From the state that EnvPool's first observation shows; positions along the ground do not matter."""
    pool, copy = make_world(task, [7]), make_world(disturbed_task(task, [parse_disturbance("push:1")]), [7])
    shown = pool.reset()[0]
    copy.reset()
    env = copy.environments[0].unwrapped
    state = np.concatenate([np.zeros(HIDDEN[task.split("-")[0]]), shown])[: env.model.nq + env.model.nv]
    check_fit(SimpleNamespace(task=TaskInfo.of(pool.spec)), copy)
    steps = 8
    if task.startswith("Humanoid"):  # its solver (PGS) stops at 1e-8, each version of MuJoCo elsewhere; then it drifts
        env.model.opt.tolerance, steps = 0.0, 2
    env.set_state(state[: env.model.nq], state[env.model.nq :])
    action = 0.125 * (np.arange(pool.spec.action_size)[None] % 3)  # exact in single precision
    for step in range(steps):
        ours, theirs = pool.step(action), copy.step(action)
        assert theirs.observations == pytest.approx(ours.observations, abs=1e-9), step
        assert theirs.rewards == pytest.approx(ours.rewards, abs=1e-5)  # EnvPool's rewards are float32
    pool.close()
    copy.close()


def test_the_wrapper_shows_what_a_disturbed_world_shows():
    texts, std = ["action_noise:0.2", "observation_noise:0.1", "action_delay:1", "push:1", "mass:1.2"], np.arange(11.0)
    world = make_world("gymnasium:Hopper-v4", [3])
    disturbed = DisturbedWorld(world, parse_disturbances(texts), [3], std[None])
    env = Disturb(gymnasium.make("Hopper-v4", max_episode_steps=-1), texts, observation_std=std)
    for each in (*world.environments, env):
        each.unwrapped._healthy_z_range = each.unwrapped._healthy_angle_range = (-np.inf, np.inf)
        each.unwrapped._healthy_state_range = (-np.inf, np.inf)
    rng = np.random.default_rng(0)
    for seed in (3, None):  # the second episode goes on with the draws of the first
        assert (env.reset(seed=seed)[0] == disturbed.reset()[0]).all()
        for _ in range(210):
            action = rng.uniform(-1.0, 1.0, (1, 3)).astype(np.float32)
            step = disturbed.step(action)
            assert (env.step(action[0])[0] == step.observations[0]).all()
    disturbed.close()
    env.close()


def test_the_wrappers_draws_follow_its_own_seed_or_that_of_reset():
    def acted(seed, *resets):
        env = Disturb(Echo(), ["action_noise:0.1"], seed)
        for each in resets:
            env.reset(seed=each)
        return env.step(np.array([0.0, 2.0]))[0].tolist()

    assert acted(5, 1) == acted(5, 2) == acted(None, 5) == acted(None, 1, 5)
    assert acted(5, 1) not in (acted(5, 1, 1), acted(None, 1), acted(None, None))
    with pytest.raises(PerdureError, match="3 components"):
        Disturb(Echo(), ["observation_noise:0.1"], observation_std=np.ones(3))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("pushes:1", "push"),
        ("push", "name:level"),
        ("push:-1", "0 or more"),
        ("action_delay:0.5", "whole control steps"),
    ],
)
def test_what_is_no_disturbance_is_refused(text, words):
    with pytest.raises(PerdureError, match=words):
        parse_disturbance(text)


def test_a_world_that_cannot_be_pushed_says_which_can():
    push = [parse_disturbance("push:0.5")]
    assert disturbed_task("Hopper-v3", push) == "gymnasium:Hopper-v4"
    assert disturbed_task("gymnasium:Hopper-v5", push) == "gymnasium:Hopper-v5"
    assert disturbed_task("Hopper-v3", [parse_disturbance("action_noise:0.1")]) == "Hopper-v3"
    with pytest.raises(PerdureError, match="Hopper-v3"):
        disturbed_task("Reacher-v4", push)
    for task, words in {"Hopper-v3": "gymnasium:Hopper-v5", "gymnasium:Reacher-v4": "root does not move"}.items():
        world = make_world(task, [0])
        with pytest.raises(PerdureError, match=words):
            DisturbedWorld(world, push, [0])
        world.close()
    with pytest.raises(PerdureError, match="twice"):
        parse_disturbances(["push:0.5", "push:1"])


def test_labels_are_read_again():
    for name, kind in Effect.kinds().items():
        text = f"{name}:{kind.example:g}"
        assert parse_disturbance(text).label == text
