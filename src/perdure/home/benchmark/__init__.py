"""The Home Assistant Benchmark: tasks, episodes, planner.

Contents:
    tasks       goals, skill sequences, stages, two ways of counting
    episodes    starts, goals and clutter, kept in files
    plan        the tasks in PDDL, and a planner
"""
