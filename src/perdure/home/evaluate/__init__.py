"""Evaluation: running episodes, writing logs, counting what stayed."""
