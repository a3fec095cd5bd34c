"""The command line in this process and in a separate one, and policies that are quickly made."""

import io
import os
import re
import signal
import subprocess
import sys
import warnings
from contextlib import redirect_stderr, redirect_stdout

import numpy as np
import pytest

from perdure.__main__ import main
from perdure.envs import make_world
from perdure.horizon import Constant, Fixed, HorizonProtocol, Linear
from perdure.policy import Normalizer, Policy, TaskInfo, save_policy
from perdure.runs import ONE_THREAD

TASK = "InvertedPendulum-v4"
OTHER_TASK = "Hopper-v3"
PROGRESS = re.compile(r"^\d\d:\d\d:\d\d  .*\n", re.MULTILINE)
"""Lines of progress, which a slow machine has time to print. They are no complaint."""


def make_policy(task, timed, seed=0):
    """A policy nobody trained: random weights, told the time if ``timed``."""
    world = make_world(task, [0])
    spec = world.spec
    world.close()
    embedding = Linear() if timed else None
    protocol = HorizonProtocol(embedding, Fixed(100), "terminated", gamma=1.0, normalizer_gamma=1.0)
    sizes = {"policy": spec.action_size, "value": 1}
    generator = np.random.default_rng(seed)
    weights = {}
    for network, outputs in sizes.items():
        shape = (spec.observation_size + protocol.embedding_size, outputs)
        weights[f"{network}.0.weight"] = (0.1 * generator.standard_normal(shape)).astype(np.float32)
        weights[f"{network}.0.bias"] = np.zeros(outputs, np.float32)
    return Policy(
        task=TaskInfo(spec.name, spec.observation_size, tuple(spec.action_low), tuple(spec.action_high)),
        weights=weights,
        activation="tanh",
        normalizer=Normalizer(np.zeros(spec.observation_size), np.ones(spec.observation_size)),
        protocol=protocol,
        clock=Constant(50.0) if timed else None,
        provenance={"method": "timed" if timed else "timeless", "seed": seed, "command": "made by a test"},
    )


@pytest.fixture(scope="session")
def files(tmp_path_factory):
    """A folder of files a user may hand over by mistake or on purpose. Tests only read it."""
    folder = tmp_path_factory.mktemp("files")
    timed = save_policy(make_policy(TASK, timed=True), folder / "timed.safetensors")
    save_policy(make_policy(TASK, timed=False), folder / "timeless.safetensors")
    save_policy(make_policy(OTHER_TASK, timed=False), folder / "other.safetensors")
    data = timed.read_bytes()
    (folder / "cut.safetensors").write_bytes(data[:-20])
    (folder / "edited.safetensors").write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    (folder / "foreign.txt").write_text("a shopping list\n")
    (folder / "empty").write_bytes(b"")
    return folder


@pytest.fixture(scope="session")
def process():
    """Runs ``perdure ARGUMENTS`` in a process of its own and returns it when it has finished; never waits for input.

    With a ``longest_file_kb``, writing more than that into one file fails, as if the disk were full.
    """

    def run(*arguments, cwd, longest_file_kb="unlimited", most_memory_kb="unlimited", **environment):
        limited = ["bash", "-c", f'ulimit -f {longest_file_kb} -v {most_memory_kb}; exec "$@"', "limited"]
        words = [each if isinstance(each, bytes) else str(each) for each in arguments]
        done = subprocess.run(
            [*limited, sys.executable, "-m", "perdure", *words],
            cwd=cwd,
            env={**os.environ, **ONE_THREAD, "COLUMNS": "80", **environment},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=300,
        )
        done.stderr = PROGRESS.sub("", done.stderr)
        return done

    return run


@pytest.fixture(scope="session")
def command():
    """Runs ``perdure ARGUMENTS`` in this process, which has its libraries loaded; returns what `process` returns."""

    def run(*arguments, cwd):
        out, err, code = io.StringIO(), io.StringIO(), 0
        handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
        with (
            pytest.MonkeyPatch.context() as patch,
            warnings.catch_warnings(),
            redirect_stdout(out),
            redirect_stderr(err),
        ):
            warnings.filterwarnings("ignore", category=DeprecationWarning)  # as in a separate process
            patch.chdir(cwd)
            patch.setenv("COLUMNS", "80")
            patch.setattr(sys, "unraisablehook", sys.unraisablehook)  # set back, as warnings are
            try:
                main(list(map(str, arguments)))
            except SystemExit as end:
                code = end.code or 0
            finally:
                for number, handler in handlers.items():
                    signal.signal(number, handler)
        return subprocess.CompletedProcess(arguments, code, out.getvalue(), PROGRESS.sub("", err.getvalue()))

    return run
