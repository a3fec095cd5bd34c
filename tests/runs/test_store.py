"""Store: a unit is there with all its files, or not at all."""

import json
import os
import signal
import subprocess
import sys
import textwrap

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, settings

from perdure.errors import PerdureError
from perdure.runs import Store, config_digest
from perdure.runs.store import read_progress

KEY = "Hopper-v3/geometric/seed-0"
CONFIG = {"gamma": 1.0, "protocol": {"horizon": [200, 1000]}, "seed": 0}


def put(store, key=KEY, config=CONFIG, text="done"):
    with store.workspace(key, config) as work:
        (work.folder / "curve.csv").write_text(text)


def fail_in(block, error):
    with block as work:
        (work.folder / "half").write_text("x")
        raise error


def hidden(store, name):
    folder = store.root / name
    return sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []


def start(script, *arguments):
    command = [sys.executable, "-c", textwrap.dedent(script), *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def test_a_unit_appears_only_when_its_block_ends(tmp_path):
    store = Store(tmp_path / "runs")
    with store.workspace(KEY, CONFIG) as work:
        (work.folder / "curve.csv").write_text("1,2")
        assert not store.done(KEY)
        assert not (store.root / KEY).exists()
        assert work.folder.stat().st_dev == store.root.stat().st_dev
    assert store.done(KEY)
    assert store.done(KEY, CONFIG)
    assert (store.get(KEY) / "curve.csv").read_text() == "1,2"
    assert store.config(KEY) == CONFIG
    assert hidden(store, ".working") == []


def test_a_block_that_is_not_complete_leaves_its_folder_for_the_next(tmp_path):
    store = Store(tmp_path)
    with store.workspace(KEY, CONFIG) as work:
        (work.folder / "checkpoint").write_text("1")
        work.complete = False
    assert not store.done(KEY)
    assert store.keys() == ()
    with store.workspace(KEY, CONFIG) as work:
        assert (work.folder / "checkpoint").read_text() == "1"
    assert store.done(KEY)
    assert hidden(store, ".working") == []


def test_a_missing_unit_is_refused_by_name(tmp_path):
    with pytest.raises(PerdureError, match="a/b"):
        Store(tmp_path).get("a/b")
    assert not Store(tmp_path / "never-made").done("a/b")


def test_another_config_under_the_same_key_is_refused_with_the_differing_fields(tmp_path):
    store = Store(tmp_path)
    put(store)
    other = {"gamma": 0.99, "protocol": {"horizon": [200, 500]}, "seed": 0, "steps": 7}
    for ask in (store.done, store.get):
        with pytest.raises(PerdureError) as refusal:
            ask(KEY, other)
    sentence = str(refusal.value)
    assert "gamma is 1.0 there and 0.99 here" in sentence
    assert "protocol.horizon[1] is 1000 there and 500 here" in sentence
    assert "steps is not set there and 7 here" in sentence
    assert "seed is" not in sentence
    with pytest.raises(PerdureError, match="gamma"), store.workspace(KEY, other):
        pytest.fail("the block must not run")


@pytest.mark.parametrize(
    ("old", "new"), [({"a": {}}, {}), ({"a": {}}, {"a": []}), ({"a": 1}, {"a": True}), ({"a": 1}, {"a": 1.0})]
)
def test_configs_that_python_might_call_equal_still_differ_and_are_named(tmp_path, old, new):
    store = Store(tmp_path)
    put(store, "unit", old)
    with pytest.raises(PerdureError, match="a is"):
        store.get("unit", new)


def test_the_digest_is_the_sha256_of_sorted_compact_json_whatever_the_order():
    # printf '{"a":[1,2],"b":0.5}' | sha256sum
    expected = "4b8a4d176b97e138cb0757014304f14d85691b24fa0981375208f3c15391c0a9"
    assert config_digest({"b": 0.5, "a": (1, 2)}) == expected
    assert config_digest({"a": [1, 2], "b": 0.5}) == expected


@pytest.mark.parametrize(
    ("config", "named"),
    [
        ({"a": {"gamma": float("nan")}}, "a.gamma = nan"),
        ({"horizon": float("inf")}, "horizon = inf"),
        ({"n": np.int64(3)}, "int64"),
        ({"path": object()}, "path"),
        ({3: "x"}, "3"),
        ([1, 2], "mapping"),
    ],
)
def test_what_json_cannot_hold_is_refused_by_its_field(tmp_path, config, named):
    with pytest.raises(PerdureError, match=named), Store(tmp_path).workspace("unit", config):
        pytest.fail("the block must not run")


BAD_KEYS = [
    "",
    "/",
    "..",
    "../x",
    "a/../b",
    "a//b",
    "/etc",
    "a/",
    ".hidden",
    "a/.b",
    "-rf",
    "a\\b",
    "a b",
    "a\0b",
    "\u00e9",
]


@pytest.mark.parametrize("key", [*BAD_KEYS, "a/unit.json", "a~b", "x" * 201, "<b>", "a\n", None])
def test_keys_that_leave_the_store_or_cannot_be_read_are_refused(tmp_path, key):
    store = Store(tmp_path / "root")
    for ask in (store.done, store.get):
        with pytest.raises(PerdureError, match="key"):
            ask(key)
    with pytest.raises(PerdureError, match="key"), store.workspace(key, {}):
        pytest.fail("the block must not run")
    assert not store.root.exists()


@settings(max_examples=200, deadline=None)
@given(st.text(alphabet="ab./\\~-_ \0()", max_size=12))
def test_every_accepted_key_is_a_folder_strictly_inside_the_root(key):
    store = Store("/nowhere/store")
    try:
        store.done(key)
    except PerdureError:
        return
    assert os.path.normpath(f"/nowhere/store/{key}") == f"/nowhere/store/{key}"
    assert os.path.normpath(f"/nowhere/store/{key}") != "/nowhere/store"


def test_a_symbolic_link_does_not_lead_out_of_the_store(tmp_path):
    (tmp_path / "outside").mkdir()
    (tmp_path / "root").mkdir()
    (tmp_path / "root" / "link").symlink_to(tmp_path / "outside")
    with pytest.raises(PerdureError, match="symbolic link"):
        put(Store(tmp_path / "root"), "link/unit")
    assert list((tmp_path / "outside").iterdir()) == []


def test_keys_lists_finished_units_only(tmp_path):
    store = Store(tmp_path)
    for key in ("b/two", "a", "b/one"):
        put(store, key)
    (tmp_path / "b" / "stray").mkdir()
    with store.workspace("b/three", CONFIG):
        assert store.keys() == ("a", "b/one", "b/two")
    assert store.keys("b") == ("b/one", "b/three", "b/two")


def test_a_unit_cannot_lie_inside_another_or_swallow_one(tmp_path):
    store = Store(tmp_path)
    put(store, "a/b")
    with pytest.raises(PerdureError, match="inside"):
        put(store, "a/b/c")
    with pytest.raises(PerdureError, match="blocks"):
        put(store, "a")
    (tmp_path / "file").write_text("x")
    with pytest.raises(PerdureError, match="blocks"):
        put(store, "file")


@pytest.mark.parametrize(
    "change",
    [
        {"key": 3},
        {"key": None},
        {"config": [1]},
        {"config": {"a": float("nan")}},
        {"sources": 7},
        {"sources": [1]},
        {"sources": None},
        {"sha256": None},
        {"more": 1},
    ],
    ids=str,
)
def test_a_record_that_is_none_is_refused(tmp_path, change):
    store = Store(tmp_path)
    with store.workspace("unit", {"a": 1}):
        pass
    path = store.get("unit") / "unit.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(PerdureError, match=r"unit\.json"):
        store.config("unit")
    path.write_text("[" * 100_000)
    with pytest.raises(PerdureError, match="damaged"):
        store.config("unit")


def test_a_report_that_cannot_be_read_is_none(tmp_path):
    store = Store(tmp_path)
    path = store.note_path("progress", "unit")
    path.parent.mkdir()
    for text in ("[" * 100_000, "{}", '{"done": "1", "total": 1, "facts": {}}', "1" * 10_000):
        path.write_text(text)
        assert read_progress(store, "unit") == (0.0, 1.0, {})
    path.write_text('{"done": 1, "total": 4, "facts": {"return": 2}}')
    assert read_progress(store, "unit") == (1.0, 4.0, {"return": 2})


def test_an_edited_or_damaged_record_is_refused(tmp_path):
    store = Store(tmp_path)
    put(store)
    record = store.get(KEY) / "unit.json"
    record.write_text(record.read_text().replace("1.0", "0.9"))
    with pytest.raises(PerdureError, match="changed"):
        store.config(KEY)
    for damage in ("", "{", "[]", json.dumps({"key": KEY}), json.dumps({"key": KEY, "config": CONFIG, "sources": 3})):
        record.write_text(damage)
        with pytest.raises(PerdureError, match="damaged"):
            store.get(KEY, CONFIG)


WRITER = """
    import os, sys, time
    from perdure.runs import Store
    from perdure.errors import PerdureError
    while not Store(sys.argv[1]).done("unit"):
        try:
            with Store(sys.argv[1]).workspace("unit", {"a": 1}) as work:
                for name in range(40):
                    (work.folder / str(name)).write_text(str(os.getpid()))
        except PerdureError as error:
            assert "run by another" in str(error) or "finished already" in str(error)
            time.sleep(0.01)
"""


def test_processes_that_want_one_unit_at_once_leave_one_whole_unit(tmp_path):
    processes = [start(WRITER, tmp_path) for _ in range(5)]
    assert [process.wait() for process in processes] == [0] * 5
    folder = Store(tmp_path).get("unit", {"a": 1})
    authors = {(folder / str(name)).read_text() for name in range(40)}
    assert len(authors) == 1
    assert sorted(path.name for path in folder.iterdir()) == sorted([*map(str, range(40)), "unit.json"])
    assert hidden(Store(tmp_path), ".working") == []


KILLED = """
    import sys, time
    from perdure.runs import Store
    with Store(sys.argv[1]).workspace("unit", {"a": 1}) as work:
        (work.folder / "half").write_text("x" * 1000)
        print("ready", flush=True)
        time.sleep(600)
"""


@pytest.mark.parametrize(("renames", "finished"), [(0, False), (1, False), (2, False), (3, True)])
def test_kill_9_at_any_rename_leaves_a_whole_unit_or_none(tmp_path, renames, finished):
    # A unit renames three times: its record when it begins and when it ends, then the folder itself.
    script = """
        import os, signal, sys
        from perdure.runs import Store
        left, rename = int(sys.argv[2]), os.replace
        def rename_or_die(source, target):
            global left
            if left == 0:
                os.kill(os.getpid(), signal.SIGKILL)
            rename(source, target)
            left -= 1
            if left == 0 and int(sys.argv[2]) == 3:
                os.kill(os.getpid(), signal.SIGKILL)
        os.replace = rename_or_die
        with Store(sys.argv[1]).workspace("unit", {"a": 1}) as work:
            (work.folder / "first").write_text("x")
    """
    assert start(script, tmp_path, renames).wait() == -signal.SIGKILL
    store = Store(tmp_path)
    assert store.done("unit") == finished
    if not finished:
        put(store, "unit", {"a": 1})
    first = ["first"] if renames > 0 else []  # what the killed attempt had written is there for the next
    expected = sorted([*first, "unit.json", *([] if finished else ["curve.csv"])])
    assert sorted(path.name for path in store.get("unit").iterdir()) == expected
    assert hidden(store, ".working") == []


def test_a_workspace_survives_errors_and_is_promoted_when_it_finishes(tmp_path):
    store = Store(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        fail_in(store.workspace(KEY, CONFIG), KeyboardInterrupt)
    assert not store.done(KEY)
    with store.workspace(KEY, CONFIG) as work:
        assert (work.folder / "half").read_text() == "x"
        (work.folder / "policy").write_text("p")
    assert (store.get(KEY, CONFIG) / "policy").read_text() == "p"
    assert hidden(store, ".working") == []
    with pytest.raises(PerdureError, match="finished"), store.workspace(KEY, CONFIG):
        pytest.fail("the block must not run")


def test_a_workspace_survives_kill_9_and_has_one_worker_at_a_time(tmp_path):
    store = Store(tmp_path)
    process = start(KILLED, tmp_path)
    assert process.stdout.readline() == "ready\n"
    with pytest.raises(PerdureError, match="another process"), store.workspace("unit", {"a": 1}):
        pytest.fail("the block must not run")
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    with store.workspace("unit", {"a": 1}) as work:
        assert (work.folder / "half").read_text() == "x" * 1000
    assert store.done("unit")


def test_a_workspace_begun_with_another_config_is_refused(tmp_path):
    store = Store(tmp_path)
    with pytest.raises(RuntimeError), store.workspace("unit", {"steps": 50}):
        raise RuntimeError  # an attempt that left nothing blocks nobody
    with pytest.raises(ZeroDivisionError), store.workspace("unit", {"steps": 100}) as work:
        (work.folder / "half").write_text(str(1 / (work.folder / "half").write_text("")))
    with pytest.raises(PerdureError, match=r"steps.*100.*200"), store.workspace("unit", {"steps": 200}):
        pytest.fail("the block must not run")
    (work.folder / "unit.json").unlink()  # what made the other file is no longer known
    with pytest.raises(PerdureError, match="damaged"), store.workspace("unit", {"steps": 200}):
        pytest.fail("the block must not run")


def test_workspaces_of_nested_keys_do_not_meet(tmp_path):
    store = Store(tmp_path)
    with store.workspace("a", {}) as one, store.workspace("b/a", {}) as other:
        outer, inner = one.folder, other.folder
        assert inner != outer
        assert inner not in outer.parents
        assert outer not in inner.parents
    assert store.keys() == ("a", "b/a")
