"""Episodes on disk: what is written is read, and nothing else is."""

import hashlib
import json
from dataclasses import replace

import pytest

from perdure.errors import PerdureError
from perdure.home.sim.apartments import make_apartment
from perdure.home.sim.objects import Placement
from perdure.home.tasks.episodes import (
    Episode,
    EpisodeSet,
    load_episodes,
    published_splits,
    read_episodes,
    write_episodes,
)
from perdure.home.tasks.tasks import TASKS

SOFA = "sofa|receptacle_aabb_Sofa_frl_apartment_sofa"
MIDDLE = "fridge|receptacle_aabb_middle_topfrl_apartment_refrigerator"


def episode(index=0, fingerprint=None):
    """A hand-made SetTable episode; where things lie does not matter to a file."""
    bowl = Placement("024_bowl", (1.0, 2.5, 0.7), (0.6, 0.0, 0.0, 0.8), SOFA)
    apple = Placement("013_apple", (0.1, -2.0, 1.2), (1.0, 0.0, 0.0, 0.0), MIDDLE)
    clutter = tuple(Placement("007_tuna_fish_can", (0.01 * k, 3.0, 0.4), (0.0, 0.0, 0.0, 1.0), SOFA) for k in range(23))
    home = fingerprint or make_apartment(2, 17).fingerprint
    return Episode("set_table", "val", index, 2, 17, home, {"top_door": 0.5}, (bowl, apple, *clutter), (bowl, apple))


@pytest.fixture
def written(tmp_path):
    path = tmp_path / "set_table_val.json"
    episodes = EpisodeSet("set_table", "val", {"seed": "7"}, (episode(0), episode(1)))
    write_episodes(path, episodes)
    return path, episodes


def test_what_is_written_is_read(written):
    path, episodes = written
    assert read_episodes(path) == episodes
    assert read_episodes(path)[1].name == "set_table/val/001"


def test_nothing_but_the_file_is_left_behind(written):
    path, _ = written
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_the_file_is_plain_json_with_one_episode_a_line(written):
    path, _ = written
    content = json.loads(path.read_text())
    assert (content["schema"], content["version"]) == ("perdure.home.episodes", 1)
    assert content["episodes"][0]["objects"][0] == [2, 1.0, 2.5, 0.7, 0.6, 0.0, 0.0, 0.8, 1]
    assert "start" not in path.read_text()
    assert sum(line.startswith('{"index"') for line in path.read_text().splitlines()) == 2


@pytest.mark.parametrize(
    ("old", "new"),
    [("2.5,", "2.6,"), ('"seed": "7"', '"seed": "8"'), ('"index":1', '"index":2'), ("024_bowl", "013_bowl")],
)
def test_a_file_edited_in_one_place_is_refused_by_its_name(written, old, new):
    path, _ = written
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(PerdureError, match=r"set_table_val\.json cannot be read"):
        read_episodes(path)


def test_a_file_cut_short_missing_or_of_another_kind_is_refused_by_its_name(written, tmp_path):
    path, _ = written
    whole = path.read_text()
    path.write_text(whole[: len(whole) // 2])
    with pytest.raises(PerdureError, match=r"set_table_val\.json cannot be read"):
        read_episodes(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(PerdureError, match=r"set_table_val\.json cannot be read"):
        read_episodes(path)
    with pytest.raises(PerdureError, match=r"missing\.json cannot be read"):
        read_episodes(tmp_path / "missing.json")
    path.write_text('{"schema": "something else"}')
    with pytest.raises(PerdureError, match=r"set_table_val\.json cannot be read"):
        read_episodes(path)
    path.write_text(whole.replace('"version": 1', '"version": 2'))
    with pytest.raises(PerdureError, match=r"set_table_val\.json cannot be read .* version"):
        read_episodes(path)


def test_a_file_with_a_right_hash_but_wrong_content_is_refused_by_its_name(written, monkeypatch):
    path, _ = written
    monkeypatch.setattr("perdure.home.tasks.episodes._digest", lambda content: "same")
    path.write_text(json.dumps(json.loads(path.read_text()) | {"sha256": "same", "kinds": ["024_bowl"]}))
    with pytest.raises(PerdureError, match=r"set_table_val\.json cannot be read"):
        read_episodes(path)


def nested(levels):
    value = 1
    for _ in range(levels):
        value = [value]
    return value


WRONG = {
    "a kind before the first": lambda c: c["episodes"][0]["objects"][0].__setitem__(0, -1),
    "a receptacle behind the last": lambda c: c["episodes"][0]["objects"][0].__setitem__(8, 99),
    "half a kind": lambda c: c["episodes"][0]["goals"][0].__setitem__(0, 0.5),
    "nan as a coordinate": lambda c: c["episodes"][0]["objects"][0].__setitem__(1, float("nan")),
    "null as a coordinate": lambda c: c["episodes"][0]["objects"][0].__setitem__(1, None),
    "a coordinate of 400 digits": lambda c: c["episodes"][0]["objects"][0].__setitem__(1, 10**400),
    "a coordinate far away": lambda c: c["episodes"][0]["objects"][0].__setitem__(1, 1e6),
    "a quaternion of length 2": lambda c: c["episodes"][0]["objects"][0].__setitem__(4, 2.0),
    "text as opened": lambda c: c["episodes"][0].update(opened="top_door"),
    "null as opened": lambda c: c["episodes"][0].update(opened={"top_door": None}),
    "infinitely open": lambda c: c["episodes"][0].update(opened={"top_door": float("inf")}),
    "a negative index": lambda c: c["episodes"][0].update(index=-1),
    "a huge index": lambda c: c["episodes"][0].update(index=10**30),
    "text as apartment": lambda c: c["episodes"][0].update(apartment=["a", 1, ""]),
    "no episode": lambda c: c.update(episodes=[]),
    "another task": lambda c: c.update(task="clean_up"),
    "numbers as notes": lambda c: c.update(made_with={"seed": 7}),
    "deep notes": lambda c: c.update(made_with={"seed": nested(900)}),
    "an unknown kind": lambda c: c["kinds"].__setitem__(0, "999_elephant"),
    "another field": lambda c: c.update(more=1),
}


@pytest.mark.parametrize("change", WRONG.values(), ids=WRONG)
def test_content_that_no_episode_can_have_is_refused_though_its_hash_fits(written, change):
    path, _ = written
    content = json.loads(path.read_text())
    change(content)
    content.pop("sha256")
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    path.write_text(json.dumps(content | {"sha256": hashlib.sha256(text.encode()).hexdigest()}))
    with pytest.raises(PerdureError, match=r"set_table_val\.json"):
        read_episodes(path)


def test_json_that_is_nested_too_deep_is_refused_by_its_name(written):
    path, _ = written
    path.write_text("[" * 100_000)
    with pytest.raises(PerdureError, match=r"set_table_val\.json cannot be read"):
        read_episodes(path)


def test_an_episode_made_for_other_furniture_is_refused():
    assert episode().apartment() == make_apartment(2, 17)
    with pytest.raises(PerdureError, match="was made for apartment macro2_micro17 0123456789ab, but this version"):
        episode(fingerprint="0123456789ab").apartment()


def test_episodes_that_do_not_fit_their_task_are_refused():
    good = episode()
    with pytest.raises(PerdureError, match="24 objects and 2 goals; set_table has 25 and 2"):
        Episode("set_table", "val", 0, 2, 17, "", {}, good.objects[:-1], good.goals)
    with pytest.raises(PerdureError, match="a goal for 013_apple where its target is 024_bowl"):
        Episode("set_table", "val", 0, 2, 17, "", {}, good.objects, good.goals[::-1])
    with pytest.raises(PerdureError, match="length 1"):
        Placement("024_bowl", (0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0), SOFA)
    with pytest.raises(PerdureError, match="finite"):
        Placement("024_bowl", (0.0, float("nan"), 0.0), (1.0, 0.0, 0.0, 0.0), SOFA)


def test_unpublished_and_unknown_episodes_are_refused():
    for split in ("train", "test"):
        with pytest.raises(PerdureError, match=f"named '{split}'; there are val, eval, eval-2"):
            load_episodes("set_table", split)
    with pytest.raises(PerdureError, match="tidy_house, prepare_groceries, set_table"):
        load_episodes("clean_up", "val")
    with pytest.raises(PerdureError, match="has episodes 0 to 0, not 1"):
        EpisodeSet("set_table", "val", {}, (episode(),))[1]


def test_a_task_without_published_episodes_is_named_and_another_ones_files_are_not_taken_for_its_own(
    written, monkeypatch
):
    path, _ = written
    monkeypatch.setattr("perdure.home.tasks.episodes.DATA", path.parent)
    monkeypatch.setitem(TASKS, "set", replace(TASKS["set_table"], name="set"))
    assert published_splits("set_table") == ("val",)
    assert published_splits("set") == ()
    with pytest.raises(PerdureError, match="no episodes of set are published"):
        load_episodes("set", "val")
