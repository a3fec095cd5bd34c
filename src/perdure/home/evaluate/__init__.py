"""Evaluation: running episodes, writing logs, counting what stayed.

Contents:
    log         what is kept of an executed episode
    execute     runs task plans, open loop
    protocol    episodes x training seeds x evaluation seeds, resumable
    outcomes    log files, success, failure causes, placements
    page        the outcomes as an offline page
"""
