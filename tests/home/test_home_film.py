"""Films of episodes: the trajectory is that of the protocol; what stands beside what; who is said to act."""

from dataclasses import replace

import imageio_ffmpeg
import numpy as np
import pytest
from PIL import Image

from perdure.errors import PerdureError
from perdure.film import GAP
from perdure.home import film
from perdure.home.agents.learned import Scripted
from perdure.home.agents.release import Ik
from perdure.home.agents.scripted import Oracle
from perdure.home.evaluate.execute import Executor, ExecutorOptions
from perdure.home.evaluate.policies import SHIPPED, SkillPolicy
from perdure.home.film import Agent, Caption, FilmOptions, Frame, film_episode, make_agent, record
from perdure.home.pictures import put, render_scene
from perdure.home.sim.scene import SceneOptions
from perdure.home.skills import get_skill
from perdure.home.tasks.episodes import load_episodes
from perdure.home.tasks.planning import make_plan

SIZE = (96, 64)
STEPS = 260
"""Until the first object is in the hand."""


@pytest.fixture(scope="module")
def episode():
    return load_episodes("set_table", "val")[3]


@pytest.fixture(autouse=True)
def fast(monkeypatch):
    monkeypatch.setattr("perdure.home.pictures.SHADOWS", 256)  # the large ones take most of the time


def filmed(*arguments):
    try:
        return film_episode(*arguments)
    except PerdureError as error:
        if "no picture can be drawn" in str(error):
            pytest.skip("this machine has neither EGL nor OSMesa")
        raise


class EnoughError(Exception):
    pass


def test_a_recording_is_the_trajectory_of_the_protocol():
    episode = load_episodes("set_table", "val")[5]
    options = ExecutorOptions(eval_seed=1, lanes=1, threads=1, scene=SceneOptions(rolling=0.0))
    oracle = film._oracle(episode)
    shown = []
    frames, log = record(episode, oracle, options, seconds=STEPS / 30, show=shown.append)
    assert log is None
    assert (len(frames), frames) == (STEPS, shown)

    alone, grippers = [], []

    def watch(world, episodes):
        alone.append(world.simulator(0).qpos.copy())
        grippers.append(world.simulator(0).data.site("gripper").xpos.copy())
        if len(alone) == STEPS:
            raise EnoughError

    agent = Oracle()
    names = {step.skill for step in make_plan(episode.home_task)}
    agents = {name: Scripted() if name == "reset_arm" else agent for name in names}
    with pytest.raises(EnoughError):
        next(Executor({name: get_skill(name) for name in names}, agents, options).run([episode], watch))
    assert np.array_equal([frame.state for frame in frames], alone)

    scene = render_scene(episode, 1)
    for step in range(0, STEPS, 20):  # what is drawn is where the simulation was
        put(scene, frames[step].state)
        np.testing.assert_allclose(scene.gripper, grippers[step], atol=1e-9)


@pytest.mark.parametrize("name", ["film.mp4", "film.gif"])
def test_a_film_shows_every_part_of_the_episode(episode, tmp_path, name):
    """8 s a second: 1 s of the episode is 0.125 s of film, which is 3.75 pictures of an MP4 and 1.6 of a GIF."""
    assert filmed(episode, tmp_path / name, FilmOptions(size=SIZE, speed=8.0, seconds=1.0)) == [None]
    assert [path.name for path in tmp_path.iterdir()] == [name]
    if name.endswith("gif"):
        with Image.open(tmp_path / name) as gif:
            assert gif.n_frames == 2
    else:
        assert imageio_ffmpeg.count_frames_and_secs(str(tmp_path / name))[0] == 4


def test_the_shorter_half_waits_for_the_longer(episode, tmp_path, monkeypatch):
    """Left shows 20, 60; right shows 100, 140, 180, 220: a stand-in draws each state in its own gray."""
    shown = {"left": (20, 60), "right": (100, 140, 180, 220)}

    def recorded(episode, agent, *given):
        caption = Caption(0.0, 1, "", (("pick_0", False),))
        return [Frame(np.array([v]), caption, None, -1) for v in shown[agent.skill_agents]], None

    class Studio:
        simulator = None

        def __init__(self, *given):
            pass

        def __enter__(self):
            return self

        def __exit__(self, *error):
            pass

        def take(self, camera, marks):
            return np.full((SIZE[1], SIZE[0], 3), self.simulator, dtype=np.uint8)

    monkeypatch.setattr(film, "record", recorded)
    monkeypatch.setattr(film, "Studio", Studio)
    monkeypatch.setattr(film, "Follower", lambda simulator: None)
    monkeypatch.setattr(film, "put", lambda simulator, state: setattr(Studio, "simulator", state[0]))
    agents = [Agent(f"{side} title", "caption", side, {}) for side in shown]
    options = FilmOptions("plan", SIZE, speed=film.RATES[".gif"] / 30)  # each step is one picture
    film_episode(episode, tmp_path / "film.gif", options, agents)
    seen = []
    with Image.open(tmp_path / "film.gif") as gif:
        assert gif.size[0] == 2 * SIZE[0] + GAP
        for number in range(gif.n_frames):
            gif.seek(number)
            middle = np.asarray(gif.convert("L"), dtype=float)[gif.size[1] // 2]
            seen.append((middle[: SIZE[0]].mean(), middle[-SIZE[0] :].mean()))
    np.testing.assert_allclose(seen, [(20, 100), (60, 140), (60, 180), (60, 220)], atol=6.0)


def test_two_strategies_are_filmed(episode, tmp_path):
    agents = [make_agent("set_table", place, policies={"place": "oracle"}) for place in ("rl", "ik")]
    options = FilmOptions(size=SIZE, speed=8.0, seconds=0.5)
    assert filmed(episode, tmp_path / "film.mp4", options, agents) == [None, None]  # the film ended before the episode
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"speed": 0.0}, "speed"),
        ({"seconds": 0.0}, "longer than"),
        ({"size": (95, 64)}, "even"),
        ({"camera": "x"}, "'x'"),
    ],
)
def test_wrong_films_are_refused(options, message):
    with pytest.raises(PerdureError, match=message):
        FilmOptions(**options)


def test_another_training_seed_may_change_the_place_policy_alone(tmp_path):
    mine = {"place": str(tmp_path / "seed-{seed}.safetensors")}
    (tmp_path / "seed-77.safetensors").write_bytes((SHIPPED / "tidy_house/place/seed-0.safetensors").read_bytes())
    with pytest.raises(PerdureError, match="training seed 77"):
        make_agent("tidy_house", "rl", 77, mine)
    with pytest.raises(PerdureError, match="seed-0"):
        make_agent("tidy_house", "rl", 0, mine, vary="place")
    (tmp_path / "seed-0.safetensors").write_bytes((tmp_path / "seed-77.safetensors").read_bytes())
    assert "every skill" in make_agent("tidy_house", "rl", 77, mine, vary="place").caption


def test_an_agent_acts_as_in_the_protocol():
    agent = make_agent("set_table", "ik", policies={"place": "oracle", "pick": "oracle"})
    assert isinstance(agent.skill_agents["place"], Ik)
    assert isinstance(agent.skill_agents["pick"], Oracle)
    assert agent.title.startswith("ik: ")
    waiting = make_agent("set_table", "delta-50", policies={"place": "oracle"})
    assert waiting.skills["place"].limit == 250
    assert "50 steps" in waiting.title
    with pytest.raises(PerdureError, match="rl, stop, ik"):
        make_agent("set_table", "throw")


def test_captions_say_who_acts():
    oracle, learned = SkillPolicy("oracle"), SkillPolicy("a file", "0123")
    assert "no learned policy" in film.acting({"pick": oracle, "place": oracle})
    mixed = film.acting({"pick": oracle, "place": learned})
    assert "learned: place;" in mixed
    assert "oracle" in mixed
    assert "oracle" not in film.acting({"pick": learned, "place": learned})


def test_captions_say_what_is_done(episode):
    words = [film.skill_words(episode, step) for step in make_plan(episode.home_task)]
    again = replace(make_plan(episode.home_task)[0], attempt=4, scripted=True)
    assert film.skill_words(episode, again) == "navigate to open the drawer, attempt 4 (scripted)"
    for part in ("navigate to open the drawer", "open the drawer", "pick the bowl", "place the apple", "reset the arm"):
        assert part in words
