"""Running task plans over many episodes at once, open loop, and writing down what happened.

Contents:
    Executor, ExecutorOptions        the runner
    EpisodeLog, SkillRun             what it writes down
    Actor                            who acts:
    Scripted, Learned, Predicting    a skill's own motion, a policy of perdure, anybody's
"""

from perdure.home.execute.actor import Actor, Scripted
from perdure.home.execute.executor import Executor, ExecutorOptions
from perdure.home.execute.learned import Learned
from perdure.home.execute.log import EpisodeLog, SkillRun
from perdure.home.execute.predicting import Predicting

__all__ = ["Actor", "EpisodeLog", "Executor", "ExecutorOptions", "Learned", "Predicting", "Scripted", "SkillRun"]
