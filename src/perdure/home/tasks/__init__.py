"""The benchmark: tasks, episodes and their generator, the PDDL domain and its planner."""
