"""Evaluation: running episodes, writing logs, counting what stayed.

Contents:
    execute     runs task plans, open loop
    protocol    episodes x training seeds x evaluation seeds, resumable
    outcomes    logs, success, failure causes, placements
    page        the outcomes as an offline page
"""
