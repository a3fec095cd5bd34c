"""Running task plans over many episodes at once, open loop, and writing down what happened.

Contents:
    Executor, ExecutorOptions    the runner
    EpisodeLog, SkillRun         what it writes down
"""

from perdure.home.evaluate.execute.executor import Executor, ExecutorOptions
from perdure.home.evaluate.execute.log import EpisodeLog, SkillRun

__all__ = ["EpisodeLog", "Executor", "ExecutorOptions", "SkillRun"]
