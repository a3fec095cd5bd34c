"""Running task plans over many episodes at once, open loop, and writing down what happened.

Contents:
    Executor, ExecutorOptions        the runner
    EpisodeLog, SkillRun             what it writes down
    Actor, Scripted, Learned         who acts
"""

from perdure.home.execute.actor import Actor, Scripted
from perdure.home.execute.executor import Executor, ExecutorOptions
from perdure.home.execute.learned import Learned
from perdure.home.execute.log import EpisodeLog, SkillRun

__all__ = ["Actor", "EpisodeLog", "Executor", "ExecutorOptions", "Learned", "Scripted", "SkillRun"]
