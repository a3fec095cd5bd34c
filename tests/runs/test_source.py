"""What was made by other source code is told from what this code made."""

import json
import shutil
import warnings

import pytest

from perdure.errors import OtherSourceWarning
from perdure.runs import Store
from perdure.runs.identity import PACKAGE, Identity, source_digest

CONFIG = {"gamma": 1.0}


def become(monkeypatch, digest):
    for module in ("identity", "store"):
        monkeypatch.setattr(f"perdure.runs.{module}.source_digest", lambda: digest)


def put(store, key):
    with store.workspace(key, CONFIG) as work:
        (work.folder / "curve.csv").write_text("done")


def test_the_digest_knows_every_python_file_and_no_other(tmp_path):
    copy = tmp_path / "one"
    shutil.copytree(PACKAGE / "runs", copy)
    before = source_digest(copy)
    other = shutil.copytree(copy, tmp_path / "two")
    (other / "notes.txt").write_text("no code")
    assert source_digest(other) == before
    for number, change in enumerate((("lock.py", "x = 1\n"), ("deep/new.py", ""))):
        changed = shutil.copytree(copy, tmp_path / f"changed-{number}")
        (changed / change[0]).parent.mkdir(exist_ok=True)
        (changed / change[0]).write_text(change[1])
        assert source_digest(changed) != before


def test_who_takes_what_other_code_made_is_warned_and_gets_it(tmp_path, monkeypatch):
    store = Store(tmp_path)
    become(monkeypatch, "old")
    put(store, "run/a")
    put(store, "run/b")
    become(monkeypatch, "new")
    put(store, "run/c")
    keys = ["run/a", "run/b", "run/c", "run/never"]
    with pytest.warns(OtherSourceWarning, match=r"2 of 3.*run/a") as told:
        store.warn_of_other_source(keys)
    assert len(told) == 1
    assert store.done("run/a", CONFIG)
    shutil.rmtree(store.get("run/a"))
    shutil.rmtree(store.get("run/b"))
    put(store, "run/a")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        store.warn_of_other_source(keys)


def test_work_that_two_codes_shared_is_of_neither(tmp_path, monkeypatch):
    store = Store(tmp_path)
    become(monkeypatch, "old")
    with pytest.raises(TypeError), store.workspace("run/a", CONFIG) as work:
        (work.folder / "half").write_text((work.folder / "half").touch())
    with pytest.raises(KeyboardInterrupt), store.workspace("run/b", CONFIG):
        raise KeyboardInterrupt
    become(monkeypatch, "new")
    for key in ("run/a", "run/b"):
        with store.workspace(key, CONFIG):
            pass
    assert Identity.read(store.get("run/b")).sources == ("new",), "an attempt that left nothing made nothing"
    for now in ("old", "new"):
        become(monkeypatch, now)
        with pytest.warns(OtherSourceWarning):
            store.warn_of_other_source(["run/a"])


def test_units_that_do_not_say_what_made_them_are_passed_over(tmp_path):
    store = Store(tmp_path)
    put(store, "run/a")
    path = store.get("run/a") / "unit.json"
    record = json.loads(path.read_text())
    assert record.pop("sources") == [source_digest()]
    path.write_text(json.dumps(record))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        store.warn_of_other_source(["run/a"])
    assert store.config("run/a") == CONFIG
