"""perdure: train a policy in finite episodes, deploy it without end, and know beforehand whether it holds.

| package | what it is for |
|---|---|
| `perdure.horizon` | the horizon protocol: embeddings of the time-to-go, training horizons, clocks |
| `perdure.disturbances` | noise, delay, pushes and changed physics, in evaluation and in training |
| `perdure.wrappers` | Gymnasium wrappers for other learners: horizons, the time-to-go, disturbances |
| `perdure.envs` | vectorized environments with one interface (`World`) |
| `perdure.policy` | policies, each stored in one file; import from other libraries |
| `perdure.learn` | PPO in JAX with a configurable horizon; training methods |
| `perdure.evaluate` | evaluation far beyond training: `perdure.extrapolate`, `perdure.compare`; `perdure.cure` |
| `perdure.stats` | intervals over training runs, differences, survival curves |
| `perdure.sequential` | intervals that stay valid while episodes are added |
| `perdure.film` | pictures and films of simulations; `perdure.evaluate.watch` films a policy as it fails |
| `perdure.report` | figures and an HTML report from evaluation tables |
| `perdure.home` | the Home Assistant Benchmark |
| `perdure.runs` | resumable units of work, on this machine or on a cluster |

The names below are the ones most programs need. Each is loaded at its first use, so ``import perdure`` is fast.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from perdure.envs import list_tasks, make_world
    from perdure.evaluate import Extrapolation, ExtrapolationResult, extrapolate
    from perdure.evaluate.callback import VerdictCallback
    from perdure.evaluate.compare import compare
    from perdure.evaluate.cure import cure
    from perdure.horizon import (
        Constant,
        Countdown,
        Fixed,
        Geometric,
        HorizonProtocol,
        Infinite,
        Linear,
        Periodic,
        Uniform,
        parse_clock,
    )
    from perdure.learn import PPOConfig, TrainRun, method_config, train
    from perdure.policy import Policy, load_policy, save_policy
    from perdure.report import read_table, write_report

__all__ = [
    "Constant",
    "Countdown",
    "Extrapolation",
    "ExtrapolationResult",
    "Fixed",
    "Geometric",
    "HorizonProtocol",
    "Infinite",
    "Linear",
    "PPOConfig",
    "Periodic",
    "Policy",
    "TrainRun",
    "Uniform",
    "VerdictCallback",
    "compare",
    "cure",
    "extrapolate",
    "list_tasks",
    "load_policy",
    "make_world",
    "method_config",
    "parse_clock",
    "read_table",
    "save_policy",
    "train",
    "write_report",
]

_NAMES = {
    "envs": ("list_tasks", "make_world"),
    "evaluate": ("Extrapolation", "ExtrapolationResult", "extrapolate"),
    "evaluate.callback": ("VerdictCallback",),
    "evaluate.compare": ("compare",),
    "evaluate.cure": ("cure",),
    "horizon": (
        *("Constant", "Countdown", "Fixed", "Geometric", "HorizonProtocol"),
        *("Infinite", "Linear", "Periodic", "Uniform", "parse_clock"),
    ),
    "policy": ("Policy", "load_policy", "save_policy"),
    "learn": ("PPOConfig", "TrainRun", "method_config", "train"),
    "report": ("read_table", "write_report"),
}
_HOME = {name: package for package, names in _NAMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
