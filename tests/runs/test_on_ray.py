"""Units on a real Ray cluster of two nodes on this machine, one of which is killed midway."""

from pathlib import Path

import pytest

from perdure.runs import Store, Unit, run_missing

HERE = Path(__file__).parent


@pytest.mark.verify
def test_a_node_that_dies_midway_changes_no_result(cluster, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(HERE))
    log = tmp_path / "log"
    units = [
        Unit(f"u-{k}", {"k": k}, "scripted_units:sleep", {"log": str(log), "seconds": 1.5, "text": str(k)})
        for k in range(6)
    ]
    state = {"killed": False}

    def kill_a_node(status):
        if not state["killed"] and sum(each.state == "finished" for each in status.values()) >= 1:
            state["killed"] = True
            cluster.remove_node(max(cluster.worker_nodes, key=id), allow_graceful=False)

    run_missing(units, tmp_path / "store", f"ray:{cluster.address}", None, kill_a_node)
    assert state["killed"]
    store = Store(tmp_path / "store")
    assert [(store.get(each.key) / "text").read_text() for each in units] == [str(k) for k in range(6)]


@pytest.mark.verify
def test_a_unit_that_fails_on_ray_says_why(cluster, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(HERE))
    unit = Unit("bad", {}, "scripted_units:fail", {"message": "no such thing"})
    with pytest.raises(ValueError, match="no such thing"):
        run_missing([unit], tmp_path, f"ray:{cluster.address}")
