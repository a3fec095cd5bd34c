"""Executing task plans over many episodes at once, open loop.

Contents:
    Executor, ExecutorOptions    runs episodes and yields their logs
"""

from perdure.home.evaluate.execute.executor import Executor, ExecutorOptions

__all__ = ["Executor", "ExecutorOptions"]
