"""The example for other simulators: a log turned to their axes and back says the same."""

import importlib.util
import json
from pathlib import Path

import pytest
from home_stories import good
from polars.testing import assert_frame_equal
from test_failure_modes import placed_and_gone, set_table

from perdure.home.evaluate.analysis import analyze
from perdure.home.evaluate.files import read_logs

EXAMPLE = Path(__file__).parents[4] / "examples" / "habitat_log_to_perdure.py"


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("habitat_log_to_perdure", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def y_up(point):
    x, y, z = (float(value) for value in point)
    return [x, z, -y]


def as_json(log, episode_id):
    """A log as another simulator would write it, y up."""
    facts, record = log.history.facts, log
    return {
        "task": log.task,
        "split": "val",
        "episode_id": episode_id,
        "eval_seed": log.eval_seed,
        "steps": log.steps,
        "diverged": log.diverged,
        "targets": [
            {"kind": t.kind, "cylinder": t.cylinder, "container": t.container, "goal": y_up(t.goal)}
            for t in record.targets
        ],
        "skills": [
            {
                **{"name": run.skill, "target": run.target, "begin": run.begin, "end": run.end},
                **{"ending": run.ending, "forced": run.forced_release},
            }
            for run in log.runs
        ],
        "history": [
            {
                "objects": [y_up(point) for point in facts.object_positions[k]],
                "up": log.history.up[k].tolist(),
                "held": int(facts.held[k]),
                "gripper": y_up(log.history.gripper[k]),
                "base": [*y_up([*log.history.base[k, :2], 0.0]), float(log.history.base[k, 2])],
                "force": float(log.history.force[k]),
                "containers": {name: float(position[k]) for name, position in facts.containers.items()},
            }
            for k in range(len(facts))
        ],
    }


def test_another_simulators_log_says_what_ours_says(example, tmp_path, capsys):
    stories = (placed_and_gone(), placed_and_gone(then={"tilt": 90.0}), placed_and_gone({"forced": True}), set_table())
    logs = [good(), *(story.log() for story in stories)]
    content = {"control_hz": 30, "episodes": [as_json(log, k) for k, log in enumerate(logs)]}
    (tmp_path / "log.json").write_text(json.dumps(content))
    out = tmp_path / "logs.parquet"
    example.main([str(tmp_path / "log.json"), "--strategy", "story", "--train-seed", "100", "--out", str(out)])
    theirs, ours = read_logs(out), logs
    for index, (one, other) in enumerate(zip(theirs, ours, strict=True)):
        assert one.index == index
        assert (one.events, len(one.releases)) == (other.events, len(other.releases))
        left, right = analyze([one]), analyze([other])
        assert_frame_equal(left.stages, right.stages)
        named = ("index", "episode_hash")  # as each simulator names its episodes
        assert_frame_equal(left.failures.drop(named), right.failures.drop(named))
        unknown = (*named, "object_speed", "touches", "pushed")
        assert_frame_equal(left.placements.drop(unknown), right.placements.drop(unknown))
    assert {row[0] for row in analyze(theirs).failures.select("cause").rows()} == {"rolled", "tipped", "time-out"}
    assert "Failure modes" in capsys.readouterr().out
