"""Several strategies in one film: what stands beside what, which one waits, who is said to act."""

import numpy as np
import pytest
from PIL import Image

from perdure.home.agents.oracle import Oracle
from perdure.home.agents.release import Ik
from perdure.home.benchmark.episodes import load_episodes
from perdure.home.errors import HomeError
from perdure.home.evaluate.protocol.policies import SHIPPED, SkillPolicy
from perdure.home.video import Agent, FilmOptions, film_side_by_side, make_agent, side_by_side
from perdure.home.video.frame_buffer import FrameBuffer
from perdure.render import RenderError

SIZE = (96, 64)


@pytest.fixture(scope="module")
def episode():
    return load_episodes("set_table", "val")[3]


def flat(value):
    return np.full((SIZE[1], SIZE[0], 3), value, dtype=np.uint8)


def test_a_reel_holds_its_last_picture():
    with FrameBuffer(0.1) as reel:
        for value in (10, 200):
            reel.add(flat(value))
        assert len(reel) == 2
        means = [reel.picture(number).mean() for number in (0, 1, 2, 99)]
    assert means == pytest.approx([10, 200, 200, 200], abs=2)


def test_the_shorter_half_waits_for_the_longer(episode, tmp_path, monkeypatch):
    """Left shows 20, 60; right shows 100, 140, 180, 220."""
    shown = {"left": (20, 60), "right": (100, 140, 180, 220)}

    class FrameWriter:
        def __init__(self, options, film, stack):
            self.after_step = film

    def render_episode(episode, film, seed, skill_agents, skills):
        for value in shown[skill_agents]:
            film.add(flat(value))

    monkeypatch.setattr(side_by_side, "FrameWriter", FrameWriter)
    monkeypatch.setattr(side_by_side, "render_episode", render_episode)
    agents = [Agent(f"{side} title", "caption", side, {}) for side in shown]
    film_side_by_side(episode, tmp_path / "film.gif", agents, FilmOptions(size=SIZE))
    film = Image.open(tmp_path / "film.gif")
    assert film.n_frames == 4
    seen = []
    for number in range(film.n_frames):
        film.seek(number)
        frame = np.asarray(film.convert("L"), dtype=float)[-SIZE[1] :]
        assert frame.shape[1] == 2 * SIZE[0] + side_by_side.GAP
        seen.append((frame[:, : SIZE[0]].mean(), frame[:, -SIZE[0] :].mean()))
    expected = [(20, 100), (60, 140), (60, 180), (60, 220)]
    assert np.abs(np.array(seen) - expected).max() < 6.0


def test_two_strategies_are_filmed(episode, tmp_path):
    agents = [make_agent("set_table", place, policies={"place": "oracle"}) for place in ("rl", "ik")]
    try:
        logs = film_side_by_side(episode, tmp_path / "film.mp4", agents, FilmOptions(size=SIZE, speed=8.0, seconds=0.5))
    except RenderError as error:
        if "no picture can be drawn" in str(error):
            pytest.skip("this machine has neither EGL nor OSMesa")
        raise
    assert logs == [None, None]  # the film ended before the episode
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]


def test_a_take_of_another_training_seed_may_have_only_place_from_it(tmp_path):
    mine = {"place": str(tmp_path / "seed-{seed}.safetensors")}
    (tmp_path / "seed-77.safetensors").write_bytes((SHIPPED / "tidy_house/place/seed-0.safetensors").read_bytes())
    with pytest.raises(HomeError, match="training seed 77"):
        make_agent("tidy_house", "rl", 77, mine)
    with pytest.raises(HomeError, match="seed-0"):
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
    with pytest.raises(HomeError, match="rl, stop, ik"):
        make_agent("set_table", "throw")


def test_captions_say_who_acts():
    oracle, learned = SkillPolicy("oracle", "", None), SkillPolicy("a file", "0123", object())
    assert "no learned policy" in side_by_side._caption({"pick": oracle, "place": oracle})
    mixed = side_by_side._caption({"pick": oracle, "place": learned})
    assert "learned: place;" in mixed
    assert "oracle" in mixed
    assert "oracle" not in side_by_side._caption({"pick": learned, "place": learned})
