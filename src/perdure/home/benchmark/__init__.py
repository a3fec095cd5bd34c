"""The Home Assistant Benchmark: what is asked of the robot.

Contents:
    tasks       goals, skill sequences, stages, two ways of counting
    episodes    starts, goals and clutter, kept in files
    plan        the tasks in PDDL, and a planner
"""
