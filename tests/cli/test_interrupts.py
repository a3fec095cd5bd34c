"""Ctrl-C and SIGTERM end a command and its workers; the same command continues."""

import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

WITHIN_S = 300
"""On an idle machine it takes half a second; more is allowed, because others compute at the same time. A command that
waits for its pending work takes many minutes."""
START_S = 300
HEARS_CTRL_C = ("env", "--default-signal=INT")
"""A command that a shell starts in the background ignores it, and so does all that it starts."""
COMMANDS = {
    "train": ("train", "Hopper-v3", "--ppo.total-steps", "1e8", "--seeds", "0", "1", "--cores", "1", "--out", "out"),
    "extrapolate": ("extrapolate", "HalfCheetah-v3/ppo", "--steps", "1000000", "--eval-seeds", "4", "--out", "out"),
    "home run": ("home", "run", "set_table", "--eval-seeds", "30", "--out", "out"),
}


@pytest.mark.parametrize(
    ("name", "how"),
    [
        ("train", signal.SIGINT),
        ("extrapolate", signal.SIGINT),
        ("home run", signal.SIGTERM),
    ],
)
def test_a_command_that_is_interrupted_ends_at_once_with_its_workers(tmp_path, name, how):
    command = [*HEARS_CTRL_C, sys.executable, "-m", "perdure", *COMMANDS[name]]
    process = subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        wait_until(lambda: list(tmp_path.glob("out/.working/*/unit.json")), START_S)
        time.sleep(0.3)
        workers = children(process.pid)
        assert workers
        if how == signal.SIGINT:
            os.killpg(process.pid, how)  # as a terminal does
        else:
            process.send_signal(how)
        _, errors = process.communicate(timeout=WITHIN_S)
        assert process.returncode == {signal.SIGINT: 130, signal.SIGTERM: 143}[how]
        assert errors.splitlines()[-1].startswith("perdure: interrupted; ")
        assert errors.endswith("run the same command to continue\n")
        assert "Traceback" not in errors
        wait_until(lambda: not any(Path(f"/proc/{worker}").exists() for worker in workers), WITHIN_S)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)  # the group outlives its leader as long as a worker is left


def children(parent):
    return [int(each) for each in Path(f"/proc/{parent}/task/{parent}/children").read_text().split()]


def wait_until(condition, seconds):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)


DROPPED = """
import time, weakref
import perdure.cli
from perdure.__main__ import main

class Nothing: pass

def wait(ended):
    print("ready", flush=True)
    time.sleep(60)

def run(arguments):
    try:
        nothing = Nothing()
        reference = weakref.ref(nothing, wait)
        del nothing  # what a callback raises is dropped, as at the end of an import
        time.sleep(60)
    finally:
        time.sleep(0.5)
        print("cleaned", flush=True)

perdure.cli.run = run
main()
"""


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interruption_that_python_drops_comes_again_and_once(number, code):
    process = subprocess.Popen(
        [sys.executable, "-c", DROPPED, "train"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "ready\n"
    process.send_signal(number)
    output, errors = process.communicate(timeout=WITHIN_S)
    assert (process.returncode, errors) == (code, "perdure: interrupted; run the same command to continue\n")
    assert output == "cleaned\n"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("extrapolate", "a.safetensors"), "run the same command to continue"),
        (("home", "run", "set_table"), "run the same command to continue"),
        (("train", "Hopper-v3", "--on", "ray:auto"), "run the same command to continue"),
        (("extrapolate", "a.onnx", "--env", "Hopper-v5"), "run the same command to continue"),
        (("extrapolate", "my_policies:walk", "--env", "Hopper-v5"), "the same command starts from the beginning"),
        (("home", "video", "set_table"), "the same command starts from the beginning"),
        (("watch", "a.safetensors"), "the same command starts from the beginning"),
    ],
)
def test_only_a_command_that_resumes_offers_to_continue(command, tmp_path, monkeypatch, arguments, told):
    def run(words):
        raise KeyboardInterrupt

    monkeypatch.setattr("perdure.cli.run", run)
    ended = command(*arguments, cwd=tmp_path)
    assert (ended.returncode, ended.stderr) == (130, f"perdure: interrupted; {told}\n")
