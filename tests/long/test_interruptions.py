"""Commands interrupted at random moments leave no process behind, and what they leave can be continued.

Every command is run once undisturbed. Then it is interrupted by SIGKILL, SIGINT or SIGTERM at a random moment,
again and again, until one gets through. Its results must be those of the undisturbed run, byte for byte.
"""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

INTERRUPTIONS = int(os.environ.get("PERDURE_INTERRUPTIONS", "300"))
"""Over all commands together."""
SIGNALS = (signal.SIGKILL, signal.SIGINT, signal.SIGTERM)
CODES = {signal.SIGKILL: (-9,), signal.SIGINT: (130, -2), signal.SIGTERM: (143, -15)}
"""Exit codes; negative ones before the program has begun."""
PYTHON_STARTS = ("init_import_site", "Could not import runpy module")
"""What Python writes when SIGINT arrives before it runs a program; the exit code is then 1."""
ENDS_WITHIN, ORPHAN_SECONDS = 10.0, 2.0
"""Half a second is usual; more is allowed, because other processes may compute at the same time."""
COMMANDS = {
    "train": (
        *("train", "Hopper-v3", "--method", "ppo", "--seeds", "0", "1", "--out", "out", "--ppo.total-steps", "3072"),
        *("--ppo.segment-steps", "1024", "--ppo.n-steps", "256", "--ppo.batch-size", "64", "--ppo.hidden-sizes", "16"),
    ),
    "extrapolate": (
        "extrapolate",
        "Hopper-v3/ppo",
        "--steps",
        "3000",
        "--eval-seeds",
        "4",
        "--disturb",
        "none",
        "--out",
        "out",
    ),
    "home run": (
        "home",
        "run",
        "set_table",
        "--policies",
        "oracle",
        "--episodes",
        "2",
        "--max-episodes",
        "1",
        "--out",
        "out",
    ),
}
"""Long commands: whoever adds one adds it here. Each writes into the folder `out`."""
LONGEST_WAIT = 20.0
"""Seconds until an interruption; a study of minutes is interrupted many times on its way."""


def start(command, folder):
    folder.mkdir(parents=True, exist_ok=True)
    return subprocess.Popen(
        [sys.executable, "-m", "perdure", *command],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a shell ignores it for commands with "&"
    )


def session(leader):
    """Every process of the session that a command began."""
    found = []
    for each in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = each.read_text().rpartition(")")[2].split()
        except OSError:  # it has ended meanwhile
            continue
        if int(fields[3]) == leader and fields[0] != "Z":
            found.append(int(each.parent.name))
    return found


def results(folder):
    """What a finished command leaves, without what the store hides and groups, which may be cut otherwise."""
    files = [path for path in (folder / "out").rglob("*") if path.is_file()]
    names = {path.relative_to(folder): path for path in files}
    return {name: path.read_bytes() for name, path in names.items() if not _left_out(name)}


def _left_out(name):
    return "groups" in name.parts or any(part.startswith(".") for part in name.parts)


def check_no_orphan(process):
    end = time.monotonic() + ORPHAN_SECONDS
    while session(process.pid):
        assert time.monotonic() < end, f"left behind: {session(process.pid)}"
        time.sleep(0.05)


@pytest.mark.verify
@pytest.mark.parametrize("name", COMMANDS)
def test_interrupted_commands_leave_no_process_and_continue_to_the_same_bytes(tmp_path, name):
    command, rng = COMMANDS[name], random.Random(f"interruptions of {name}")
    began = time.monotonic()
    whole = start(command, tmp_path / "whole")
    _, errors = whole.communicate()
    assert whole.returncode == 0, errors
    seconds, expected = time.monotonic() - began, results(tmp_path / "whole")
    assert expected
    interrupted = finished = 0
    folder = tmp_path / "cut"
    while interrupted < INTERRUPTIONS // len(COMMANDS) or finished == 0:
        process = start(command, folder)
        how = rng.choice(SIGNALS)
        # After the last interruption it is left alone.
        wait = (
            rng.uniform(0.0, min(1.2 * seconds, LONGEST_WAIT)) if interrupted < INTERRUPTIONS // len(COMMANDS) else None
        )
        try:
            _, errors = process.communicate(timeout=wait)
        except subprocess.TimeoutExpired:
            interrupted += 1
            os.kill(process.pid, how) if how == signal.SIGKILL else os.killpg(process.pid, how)
            _, errors = process.communicate(timeout=ENDS_WITHIN)
            starting = process.returncode == 1 and any(words in errors for words in PYTHON_STARTS)
            assert starting or process.returncode in (0, *CODES[how]), errors  # 0: it was about to end
            check_no_orphan(process)
            continue
        assert process.returncode == 0, errors
        check_no_orphan(process)
        assert results(folder) == expected
        finished += 1
        shutil.rmtree(folder)
    print(f"{name}: {interrupted} interruptions, {finished} runs that got through, all equal")
