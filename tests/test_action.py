"""The steps of action.yml, run as GitHub runs them: inputs as variables, files for outputs and summary."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
ACTION = yaml.safe_load((ROOT / "action.yml").read_text())
EVALUATE = next(step for step in ACTION["runs"]["steps"] if step.get("id") == "evaluate")


def test_every_input_reaches_the_script_as_a_variable():
    given = {name.removeprefix("${{ inputs.").removesuffix(" }}") for name in EVALUATE["env"].values()}
    assert given == set(ACTION["inputs"]) - {"python-version"}
    assert "${{" not in EVALUATE["run"]


@pytest.mark.parametrize(
    ("policy", "code", "holds"), [("Hopper-v3/ppo-average-reward", 0, "true"), ("Hopper-v3/ppo-falls", 3, "false")]
)
def test_a_policy_that_falls_fails_the_job_and_leaves_its_report(tmp_path, policy, code, holds):
    given = {
        "POLICY": policy,
        "ENVIRONMENT": "",
        "REQUIRE": "holds",
        "ARGUMENTS": "--disturb standard-1 --steps 600 --eval-seeds 6",
        "OUT": str(tmp_path / "out"),
        "RUNNER_TEMP": str(tmp_path),
        "GITHUB_OUTPUT": str(tmp_path / "output"),
        "GITHUB_STEP_SUMMARY": str(tmp_path / "summary.md"),
        "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]),
    }
    script = ["bash", "-eo", "pipefail", "-c", EVALUATE["run"]]
    done = subprocess.run(script, env={**os.environ, **given}, capture_output=True, text=True)
    assert done.returncode == code, done.stderr
    assert (tmp_path / "output").read_text() == f"holds={holds}\n"
    assert "Hopper-v3" in (tmp_path / "summary.md").read_text()
    assert {"report.html", "junit.xml"} <= {path.name for path in (tmp_path / "out").iterdir()}
