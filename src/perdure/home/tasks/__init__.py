"""The benchmark: tasks, episodes, the PDDL domain and its planner."""
