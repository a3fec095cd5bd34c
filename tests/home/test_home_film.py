"""Films of episodes: the trajectory is that of the protocol; what stands beside what; who is said to act."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from perdure.errors import PerdureError
from perdure.film import GAP, strip_height
from perdure.home import film
from perdure.home.evaluate.day import DayProtocol, find_errands
from perdure.home.evaluate.execute import ExecutorOptions
from perdure.home.evaluate.policies import make_agents
from perdure.home.evaluate.protocol import EvaluationProtocol
from perdure.home.evaluate.strategy import Strategy
from perdure.home.film import SMALL, TITLE, Agent, Frame, film_episode, film_errands, record
from perdure.home.pictures import put, render_scene
from perdure.home.sim.scene import SceneOptions
from perdure.home.skills import SKILLS
from perdure.home.tasks.episodes import load_episodes
from perdure.home.tasks.planning import make_plan
from perdure.home.tasks.tasks import Stage
from tests.home.limits import shorten

SIZE = (96, 64)
ORACLES = dict.fromkeys(SKILLS, "oracle")


def agent(place="rl", policies=ORACLES, train_seed=0, **options):
    options = ExecutorOptions(settle_steps=2, **options)
    return Agent(EvaluationProtocol("set_table", place, policies=policies, options=options), train_seed)


@pytest.fixture(scope="module")
def episode():
    return load_episodes("set_table", "val")[3]


@pytest.fixture
def fast(monkeypatch):
    """Short episodes, small shadows."""
    monkeypatch.setattr("perdure.home.pictures.Studio.shadows", 256)
    shorten(monkeypatch, 2, 8)


def filmed(*arguments, **options):
    try:
        return film_episode(*arguments, **options)
    except PerdureError as error:
        if "no picture can be drawn" in str(error):
            pytest.skip("this machine has neither EGL nor OSMesa")
        raise


@pytest.mark.verify
def test_a_recording_is_the_trajectory_of_the_protocol(monkeypatch):
    """An executor that is not filmed has the same states. Skills are cut short."""
    for skill in SKILLS:
        monkeypatch.setattr(SKILLS[skill], "step_limit", 20 if skill == "navigate" else 4)
    episode, mine, shown = load_episodes("set_table", "val")[5], agent(eval_seed=1, scene=SceneOptions(rolling=0.0)), []
    frames, log = record(episode, mine, shown.append)
    assert (len(frames), frames) == (log.length, shown)
    assert (log.strategy, log.eval_seed) == (Strategy("rl", "drag only"), 1)

    alone, grippers = [], []

    def watch(world, running):
        alone.append(world.simulator(0).qpos.copy())
        grippers.append(world.simulator(0).data.site("gripper").xpos.copy())

    protocol = mine.protocol
    executor = film.Executor(protocol.skills(), make_agents(mine.policies, "rl"), protocol.options)
    list(executor.run([episode], watch))
    assert np.array_equal([frame.state for frame in frames], alone)

    scene = render_scene(episode, 1)
    for step in range(0, len(frames), 20):  # what is drawn is where the simulation was
        put(scene, frames[step].state)
        np.testing.assert_allclose(scene.gripper, grippers[step], atol=1e-9)


def test_a_caption_marks_no_stage_that_only_the_settling_time_reaches(episode, fast, monkeypatch):
    """The log does not count it either."""
    monkeypatch.setattr(film, "caption", lambda words, clock, done: done)
    monkeypatch.setattr(film.Running, "facts", lambda running, world, lane: running.settling)
    monkeypatch.setattr(Stage, "met", lambda stage, settling: settling > 0)
    frames, _ = record(episode, agent(), lambda frame: None)
    assert frames
    assert not any(reached for frame in frames for _, reached in frame.caption)


@pytest.mark.parametrize("name", ["film.mp4", "film.gif", "film.webp"])
def test_a_film_shows_every_part_of_the_episode(episode, tmp_path, fast, name):
    """2 s a second: 1 s of the episode is 0.5 s of film, which is 15 pictures of an MP4 and 6.25 of the others."""
    (log,) = filmed(episode, tmp_path / name, [agent()], size=SIZE, speed=2.0)
    seconds = log.length / 30.0
    assert [path.name for path in tmp_path.iterdir()] == [name]
    if name.endswith("mp4"):
        assert imageio_ffmpeg.count_frames_and_secs(str(tmp_path / name))[0] == int(15.0 * seconds) + 1
    else:
        with Image.open(tmp_path / name) as animation:
            assert animation.n_frames == int(6.25 * seconds) + 1


GRAYS = {"rl": (20, 60), "stop": (100, 140, 180, 220)}
"""What a stand-in shows of each agent: its states are grays."""


@pytest.fixture
def grays(monkeypatch):
    """Films of `GRAYS`."""

    class Studio:
        simulator = None

        def __init__(self, *given):
            pass

        def __enter__(self):
            return self

        def __exit__(self, *error):
            pass

        def take(self, camera, marks, path):
            return np.full((SIZE[1], SIZE[0], 3), self.simulator, dtype=np.uint8)

    def recorded(episode, agent):
        shown = GRAYS[agent.protocol.place]
        return [Frame(np.array([gray]), 0.0, "", film.caption("", ""), None, -1) for gray in shown], None

    monkeypatch.setattr(film, "record", recorded)
    monkeypatch.setattr(film, "Studio", Studio)
    monkeypatch.setattr(film, "Follower", lambda simulator: None)
    monkeypatch.setattr(film, "put", lambda simulator, state: setattr(Studio, "simulator", state[0]))


def test_errands_of_a_home_stand_side_by_side(tmp_path, fast):
    options = ExecutorOptions(settle_steps=2, planner="closed")
    days = DayProtocol(("set_table",), 1.0, EvaluationProtocol("set_table", "rl", policies=ORACLES, options=options))
    errands = find_errands(days, 0, (1, 2))
    assert errands[2].base != errands[1].base
    agents = {"set_table": Agent(days.protocol_of("set_table"))}
    path = tmp_path / "film.gif"
    try:
        logs = film_errands(errands, agents, path, size=SIZE, speed=4.0)
    except PerdureError as error:
        if "no picture can be drawn" in str(error):
            pytest.skip("this machine has neither EGL nor OSMesa")
        raise
    assert [log.index for log in logs] == [errands[1].index] * 2
    with Image.open(path) as shown:
        assert shown.size[0] == 2 * SIZE[0] + GAP
        picture = np.asarray(shown.convert("RGB"), dtype=int)
    top = strip_height([(TITLE, []), (SMALL, [])])
    rooms = picture[top : top + SIZE[1]]
    assert np.abs(rooms[:, : SIZE[0]] - rooms[:, SIZE[0] + GAP :]).max() > 50, "the robot stands elsewhere"


def test_the_shorter_half_waits_for_the_longer(episode, tmp_path, grays):
    speed = film.RATES[".gif"] / 30  # each step is one picture
    film_episode(episode, tmp_path / "film.gif", [agent("rl"), agent("stop")], "head", size=SIZE, speed=speed)
    seen = []
    with Image.open(tmp_path / "film.gif") as gif:
        assert gif.size[0] == 2 * SIZE[0] + GAP
        for number in range(gif.n_frames):
            gif.seek(number)
            middle = np.asarray(gif.convert("L"), dtype=float)[gif.size[1] // 2]
            seen.append((middle[: SIZE[0]].mean(), middle[-SIZE[0] :].mean()))
    np.testing.assert_allclose(seen, [(20, 100), (60, 140), (60, 180), (60, 220)], atol=6.0)


class Story:
    """A log of 200 steps: the bowl moves by 1 cm a step along x, and is released after step 60."""

    length, name = 200, "a log"
    targets = (SimpleNamespace(kind="024_bowl", goal=(0.61, 0.0, 0.0)),)
    release = SimpleNamespace(step=60, object_speed=0.3)

    def __init__(self):
        positions = np.zeros((self.length, 1, 3))
        positions[:, 0, 0] = 0.01 * np.arange(self.length)
        self.history = SimpleNamespace(facts=SimpleNamespace(object_positions=positions))


def words(frame):
    return [text for _, cells in frame.caption for text, _ in cells]


def test_a_release_is_shown_from_before_it_until_after_it_with_the_way_of_the_object(monkeypatch):
    monkeypatch.setattr(film, "placement", lambda log, target: log.release)
    frames = [Frame(np.array([step]), 0.0, "", [], None, -1) for step in range(200)]
    shown = film._around_release(frames, Story(), 0)
    assert [frame.state[0] for frame in shown] == list(range(15, 151))  # 1.5 s before, 3 s after
    assert words(shown[0]) == ["bowl in the hand", "1.5 s before the release"]
    assert words(shown[-1]) == ["released at 0.30 m/s, 0.89 m from its goal", "3.0 s after the release"]
    ends = [point[0] for point, _ in shown[-1].path]
    np.testing.assert_allclose(ends, 0.01 * np.arange(15, 151))
    colors = [color for _, color in shown[-1].path]
    assert len(set(colors[:46])) == len(set(colors[46:])) == 1
    assert colors[45] != colors[46]
    assert len(shown[60].path) == 61  # only what was until then


def test_a_release_at_the_end_waits_in_its_last_state_and_none_is_refused(monkeypatch):
    monkeypatch.setattr(film, "placement", lambda log, target: log.release)
    monkeypatch.setattr(Story, "release", SimpleNamespace(step=190, object_speed=0.3))
    frames = [Frame(np.array([step]), 0.0, "", [], None, -1) for step in range(200)]
    shown = film._around_release(frames, Story(), 0)
    assert len(shown) == 136
    assert [frame.state[0] for frame in shown[-3:]] == [199, 199, 199]
    monkeypatch.setattr(Story, "release", None)
    with pytest.raises(PerdureError, match="target 0 is never released in a log"):
        film._around_release(frames, Story(), 0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"speed": 0.0}, "speed"),
        ({"size": (95, 64)}, "even"),
        ({"camera": "x"}, "'x'"),
        ({"release": 2}, "0 to 1, not 2"),
    ],
)
def test_wrong_films_are_refused(episode, tmp_path, options, message):
    with pytest.raises(PerdureError, match=message):
        film_episode(episode, tmp_path / "film.mp4", [agent()], **options)


def test_a_live_view_shows_each_agent_in_turn(episode, fast, monkeypatch):
    """A server of mjviser that stops after the second episode; what it was shown are the recorded states."""
    shown, said, agents = [], [], [agent("rl"), agent("stop")]

    class Server:
        scene = SimpleNamespace(reset=lambda: shown.append([]))

        def __init__(self, port, verbose):
            assert port == 1234

        def get_port(self):
            return 1234

        def stop(self):
            said.append("stopped")

    class Scene:
        def __init__(self, server, model, num_envs):
            if len(shown) == 3:
                raise KeyboardInterrupt

        def update_from_mjdata(self, data):
            shown[-1].append(data.qpos.copy())

    monkeypatch.setitem(sys.modules, "viser", SimpleNamespace(ViserServer=Server))
    monkeypatch.setitem(sys.modules, "mjviser", SimpleNamespace(ViserMujocoScene=Scene))
    with pytest.raises(KeyboardInterrupt):
        film.serve_episode(episode, agents, 1234, speed=1000.0, report=said.append)
    for states, each in zip(shown, agents, strict=False):
        assert np.array_equal(states, [frame.state for frame in record(episode, each)[0]])
    assert said[0] == "http://localhost:1234"
    assert [agents[0].caption in said, agents[1].caption in said, said[-1]] == [True, True, "stopped"]


def test_captions_say_who_acts():
    assert agent().caption == "rl: the scripted oracle"
    mixed = agent("ik", {"pick": "oracle", "place": "oracle"})
    assert "learned: " in mixed.caption
    assert "oracle" in mixed.caption
    assert agent("stop", {}).caption == "stop: learned policies"
    assert mixed.title == "stop, lower 5 cm"
    waiting = agent("delta-50", {"place": "oracle"}, planner="closed")
    assert "50 steps, planned again after each skill" in waiting.title


def test_captions_say_what_is_done(episode):
    words = [film.skill_words(episode, step) for step in make_plan(episode.home_task)]
    again = replace(make_plan(episode.home_task)[0], attempt=4, scripted=True)
    assert film.skill_words(episode, again) == "navigate to open the drawer, attempt 4 (scripted)"
    for part in ("navigate to open the drawer", "open the drawer", "pick the bowl", "place the apple", "reset the arm"):
        assert part in words
