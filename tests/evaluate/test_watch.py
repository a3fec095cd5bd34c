"""Films show the very episode that was judged, around the step at which it fails."""

from __future__ import annotations

import base64
import io
from dataclasses import replace
from itertools import pairwise
from typing import ClassVar

import gymnasium
import imageio_ffmpeg
import numpy as np
import polars as pl
import pytest
from PIL import Image

from perdure.disturbances import parse_disturbances
from perdure.envs import make_world
from perdure.errors import PerdureError
from perdure.evaluate import Execution, Extrapolation, evaluate_files
from perdure.evaluate.options import Condition
from perdure.evaluate.reference import idle_baseline, with_reference
from perdure.evaluate.replay import RobotCamera, find_render_env, replay
from perdure.evaluate.stills import STILL_SIZE, add_stills
from perdure.evaluate.watch import BELOW, SUBTITLE, TITLE, Judge, watch
from perdure.film import GAP, RED, strip_height
from perdure.horizon import Constant
from perdure.policy import find_policy, load_policy, save_policy
from perdure.policy.onnx import export_onnx
from perdure.report import write_report
from perdure.report.page import STILLS

pytest.importorskip("mujoco")
CALM = ("none",)
NOTHING_LEFT, ALWAYS = Constant(0.0), Constant(500.0)
STEPS, SIZE = 400, (96, 64)
TOP, BOTTOM = (strip_height([(size, []) for size in sizes]) for sizes in ((TITLE, SUBTITLE), (BELOW,)))


@pytest.fixture(scope="module", autouse=True)
def measured_once(short_idle):
    """The reference episodes of a task are measured for the first film or judge, and kept."""
    found = {}

    def measure(policy, source):
        if policy.task.name not in found:
            found[policy.task.name] = with_reference(policy, source)
        return found[policy.task.name]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("perdure.evaluate.watch.with_reference", measure)
        patch.setattr("perdure.evaluate.reference.EPISODES", 6)
        patch.setattr("perdure.film.Renderer.shadows", 256)  # the large ones take most of the time
        yield


@pytest.fixture(scope="module")
def policy():
    return load_policy("Hopper-v3/geometric")


@pytest.fixture(scope="module")
def render_env(policy):
    return find_render_env(policy.task.name)


@pytest.fixture(scope="module")
def film(policy, tmp_path_factory):
    path = tmp_path_factory.mktemp("film") / "film.mp4"
    return watch(
        policy,
        path,
        clock=NOTHING_LEFT,
        beside=ALWAYS,
        disturb=CALM,
        until_failure=True,
        steps=STEPS,
        eval_seeds=2,
        size=SIZE,
    )


def pictures(path):
    reader = imageio_ffmpeg.read_frames(str(path))
    width, height = next(reader)["size"]
    return [np.frombuffer(data, np.uint8).reshape(height, width, 3) for data in reader]


def has_frame(panel):
    """Whether the panel's picture has a red edge; compression changes colors a little."""
    edge = panel[TOP + 1 : TOP + 4, 4:-4].reshape(-1, 3).mean(axis=0)
    return bool(np.abs(edge - RED).max() < 40)


class TestAFilmOfAFall:
    def test_has_the_episode_that_holds_on_the_left_and_the_fall_on_the_right(self, film):
        left, right = film.episodes
        assert (left.clock, left.outcome, left.end_step) == (ALWAYS, "holds", STEPS)
        assert (right.clock, right.outcome) == (NOTHING_LEFT, "falls")
        assert left.eval_seed == right.eval_seed == 0
        assert 50 < right.failed_step < 350
        assert film.sentences[1] == f"always 0 steps to go, start state 0: falls at step {right.failed_step}"

    def test_shows_the_fall_a_second_before_its_end(self, film):
        """25 pictures a second, one for each five steps of 0.008 s; the right panel gets a red frame at the fall."""
        shown = pictures(film.path)
        assert len(shown) == film.pictures
        failed = film.episodes[1].failed_step
        assert len(shown) == (failed + 125 - 1) // 5 + 1
        width = SIZE[0]
        assert shown[0].shape == (TOP + SIZE[1] + BOTTOM, 2 * width + GAP, 3)
        steps = 1 + 5 * np.arange(len(shown))
        assert [has_frame(each[:, width + GAP :]) for each in shown] == (steps >= failed).tolist()
        assert not any(has_frame(each[:, :width]) for each in shown)

    def test_moves(self, film):
        shown = pictures(film.path)
        body = np.stack([each[TOP + 8 : TOP + SIZE[1] - 8, 8 : SIZE[0] - 8] for each in shown]).astype(float)
        assert np.abs(np.diff(body, axis=0)).mean() > 0.5

    def test_is_of_the_environment_that_it_names(self, film):
        assert film.world.startswith("Hopper-v4, Gymnasium")


class TestTheReplay:
    @pytest.fixture
    def episode(self, film):
        return film.episodes[1]

    def test_pays_what_the_judged_episode_paid_and_goes_on_after_its_end(self, policy, episode, render_env):
        instants = list(replay(policy, episode, render_env, episode.end_step + 30))
        assert [each.step for each in instants] == list(range(1, episode.end_step + 31))
        assert instants[episode.end_step - 1].total == pytest.approx(episode.total, rel=1e-12)
        assert instants[-1].total == instants[episode.end_step - 1].total

    @pytest.mark.parametrize("change", [{"total": 0.0}, {"end_step": 40}, {"clock": ALWAYS}, {"eval_seed": 5}])
    def test_of_another_episode_than_the_judged_one_is_refused(self, policy, episode, render_env, change):
        with pytest.raises(PerdureError, match=r"is not the one that was judged|when it was filmed"):
            list(replay(policy, replace(episode, **change), render_env, STEPS))

    def test_is_not_disturbed_by_the_camera(self, policy, episode, render_env):
        totals = []
        for instant in replay(policy, episode, render_env, episode.end_step):
            if instant.step == 20:
                with RobotCamera(instant.env, SIZE) as camera:
                    assert camera.take().std() > 5
            totals.append(instant.total)
        assert totals[-1] == episode.total


def test_without_a_failure_there_is_no_film_and_no_file(policy, tmp_path):
    with pytest.raises(PerdureError, match="none of 1 episodes of 400 steps fails under constant"):
        watch(policy, tmp_path / "film.mp4", clock=ALWAYS, disturb=CALM, until_failure=True, steps=STEPS, eval_seeds=1)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("film.avi", {}, "written as .mp4, .gif, .webp, not as film.avi"),
        ("film.mp4", {"steps": 0}, "at least 1, got 0"),
    ],
)
def test_wrong_numbers_and_names_are_refused(policy, tmp_path, name, options, message):
    with pytest.raises(PerdureError, match=message):
        watch(policy, tmp_path / name, **options)


def test_clocks_for_a_policy_without_time_are_refused(tmp_path):
    plain = load_policy("Hopper-v3/ppo")
    for options in ({"clock": ALWAYS}, {"beside": ALWAYS}):
        with pytest.raises(PerdureError, match="no time-to-go input"):
            watch(plain, tmp_path / "film.mp4", **options)


class TestTwins:
    @pytest.mark.parametrize(
        ("task", "env_id"),
        [("Hopper-v3", "Hopper-v4"), ("Ant-v5", "Ant-v5"), ("gymnasium:Hopper-v5", "Hopper-v5")],
    )
    def test_have_the_dynamics_of_the_task(self, task, env_id):
        assert find_render_env(task).env_id == env_id

    @pytest.mark.parametrize("task", ["Ant-v3", "Humanoid-v3", "Humanoid-v4", "Ant-v4", "Walker2d-v3"])
    def test_give_observations_of_the_same_length_and_zero_forces_where_envpool_does(self, task):
        world = make_world(task, [0])
        theirs = world.reset()[0]
        world.step(np.zeros((1, world.spec.action_size)))
        env = find_render_env(task).build()
        ours = env.reset(seed=0)[0]
        for _ in range(5):
            ours = env.step(env.action_space.sample())[0]
        assert ours.shape == theirs.shape
        if task in ("Ant-v3", "Humanoid-v3", "Humanoid-v4"):
            assert not theirs[-84:].any()
            assert not ours[-84:].any()
        assert ours[:20].all()

    @pytest.mark.parametrize("task", ["CheetahRun-v1", "perdure/HomePlace-v0", "Hopper-v9"])
    def test_do_not_exist_for_other_tasks(self, task):
        with pytest.raises(PerdureError, match=f"{task} cannot be filmed"):
            find_render_env(task)

    def test_an_environment_that_renders_no_array_is_refused(self):
        gymnasium.register("perdure-test-Dark-v0", Dark)
        with pytest.raises(PerdureError, match=r"cannot be filmed: it renders \[\x27human\x27\], and not rgb_array"):
            find_render_env("gymnasium:perdure-test-Dark-v0").build()


class Dark(gymnasium.Env):
    """Lights up more with every step; a picture has odd sides."""

    metadata: ClassVar = {"render_modes": ["human"]}
    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (11,), np.float64)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float64)

    def __init__(self, render_mode=None):
        self.render_mode = render_mode

    def reset(self, *, seed=None, options=None):
        self.steps = 0
        return np.zeros(11), {}

    def step(self, action):
        self.steps += 1
        return np.zeros(11), 1.0, False, False, {}

    def render(self):
        return np.full((65, 97, 3), 10 * self.steps, np.uint8)


class Light(Dark):
    metadata: ClassVar = {"render_modes": ["rgb_array"], "render_fps": 2}


class Falls(Light):
    """An image of eleven numbers; falls at step 5."""

    observation_space = gymnasium.spaces.Box(-1.0, 1.0, (11, 1), np.float64)

    def reset(self, *, seed=None, options=None):
        return super().reset()[0][:, None], {}

    def step(self, action):
        observation, reward, *_ = super().step(action)
        return observation[:, None], reward, self.steps == 5, False, {}


def test_a_film_goes_on_after_a_fall_whatever_the_shape_of_observations(policy, tmp_path):
    gymnasium.register("perdure-test-Falls-v0", Falls)
    falling = replace(policy, task=replace(policy.task, name="gymnasium:perdure-test-Falls-v0"), clock=ALWAYS)
    film = watch(falling, tmp_path / "fall.gif", disturb=CALM, until_failure=True, steps=15, eval_seeds=1)
    assert film.pictures > 5


def test_any_environment_that_renders_an_array_is_filmed(policy, tmp_path):
    """Two steps a second, a picture for each: six seconds."""
    gymnasium.register("perdure-test-Light-v0", Light, max_episode_steps=30)
    lit = replace(policy, task=replace(policy.task, name="gymnasium:perdure-test-Light-v0"), clock=ALWAYS)
    film = watch(lit, tmp_path / "film.mp4", disturb=CALM, steps=15)
    shown = pictures(film.path)
    assert len(shown) == film.pictures == 12
    brightness = [each[TOP + 10 : TOP + 50, 10:80].mean() for each in shown]
    assert brightness == pytest.approx([10 * step for step in range(1, 13)], abs=4)
    with pytest.raises(PerdureError, match="exists and would be replaced"):
        watch(lit, film.path, steps=15)


def test_a_judge_compares_with_the_reference_of_the_file(policy, render_env):
    judge = Judge(policy, render_env.open(), 50, idle_baseline(render_env.open()))
    assert judge.policy.reference is policy.reference
    assert judge.scale.policy_state == "worked"
    assert judge.scale.idle_rate == pytest.approx(1.0, abs=0.1), "an alive bonus of 1 a step"
    assert judge.scale.training_rate == pytest.approx(policy.reference.rate, rel=0.2)


def test_two_policies_meet_the_same_push(policy, render_env):
    """From one start state; the first push comes after 200 steps, and a Hopper has no sideways velocity."""
    condition = Condition("push:0.5", parse_disturbances(["push:0.5"]), 230, 1)
    idle = idle_baseline(render_env.open())
    pushes = []
    for each in (policy, load_policy("Hopper-v3/ppo")):
        judge = Judge(each, render_env.open(), 230, idle)
        episode = judge.judge(None, 0, condition)
        found = {instant.step: instant.push for instant in replay(judge.policy, episode, render_env, 220)}
        pushes.append({step: push for step, push in found.items() if push is not None})
    assert [list(each) for each in pushes] == [[201], [201]]
    ours, theirs = (each[201] for each in pushes)
    assert ours == pytest.approx(theirs)
    assert 0.0 < abs(ours[0]) <= 0.5
    assert ours[1:].tolist() == [0.0, 0.0]


@pytest.fixture(scope="module")
def failing(tmp_path_factory):
    """Episodes with no steps left, which fall; calm ones would run in EnvPool."""
    path, out = find_policy("Hopper-v3/geometric"), tmp_path_factory.mktemp("failing")
    asked = Extrapolation((path,), STEPS, ("constant:0",), 2, disturb=("push:0.1",))
    return path, evaluate_files(asked, Execution(out, on="here", cores=1))


class TestStills:
    def drawn(self, failing, out, frame=None, path=None):
        """The file of the stills, in a folder that held others."""
        (out / STILLS).write_bytes(b"of an earlier table")
        add_stills(failing[1].frame if frame is None else frame, failing[1].files, [path or failing[0]], out, "here")
        return out / STILLS

    def test_show_the_start_and_the_first_fall_on_the_page(self, failing, tmp_path):
        """Two of two stills in a row; those from the fall on have a red edge."""
        shown = self.drawn(failing, tmp_path).read_bytes()
        width, height = STILL_SIZE
        sheet = np.asarray(Image.open(io.BytesIO(shown)).convert("RGB")).astype(int)
        below, above = strip_height([(BELOW, [])]), strip_height([(SUBTITLE, []), (SUBTITLE, [])])
        assert sheet.shape == (above + 2 * (height + below) + GAP, 2 * width + GAP, 3)
        rows, columns = (above, above + height + below + GAP), (0, width + GAP)
        cells = [sheet[y : y + height, x : x + width] for y in rows for x in columns]
        assert [bool(np.abs(cell[1:4] - RED).max() < 40) for cell in cells] == [False, False, True, True]
        inner = [cell[8:-8, 8:-8] for cell in cells]
        assert all(np.abs(one - other).mean() > 1 for one, other in pairwise(inner)), "it moves"
        assert len(shown) < 100_000
        page = write_report(failing[1].frame, tmp_path, "", (), stills=tmp_path / STILLS).read_text()
        assert base64.b64encode(shown).decode() in page

    def test_are_the_same_every_time(self, failing, tmp_path):
        folders = tmp_path / "a", tmp_path / "b"
        for folder in folders:
            folder.mkdir()
        first, second = (self.drawn(failing, folder) for folder in folders)
        assert first.read_bytes() == second.read_bytes()

    @pytest.mark.parametrize(
        "change", [{"outcome": "holds"}, {"return": 0.0}, {"disturbance": "none"}, {"task": "gymnasium:No-v0"}]
    )
    def test_there_are_none_of_what_did_not_fail_or_cannot_be_replayed(self, failing, tmp_path, change):
        """Without a push, EnvPool would have run the episode."""
        frame = failing[1].frame.with_columns(**{name: pl.lit(value) for name, value in change.items()})
        assert not self.drawn(failing, tmp_path, frame).exists()
        page = write_report(failing[1].frame, tmp_path, "", (), stills=tmp_path / STILLS).read_text()
        assert '<img alt="A failure' not in page

    def test_show_a_model_whose_noise_has_the_spread_of_observations_in_training(self, tmp_path):
        model = tmp_path / "walker.onnx"
        export_onnx(load_policy(find_policy("Hopper-v3/ppo")), model)
        disturb, env = ("observation_noise:0.1", "push:0.5"), "gymnasium:Hopper-v4"
        asked = Extrapolation((model,), 1000, eval_seeds=2, disturb=disturb, env=env, training_horizon=40)
        result = evaluate_files(asked, Execution(tmp_path, on="here", cores=1))
        assert self.drawn((model, result), tmp_path).exists()

    def test_there_are_none_of_another_policy(self, failing, tmp_path, policy):
        other = save_policy(replace(policy, provenance={}), tmp_path / "other.safetensors")
        assert not self.drawn(failing, tmp_path, path=other).exists()
