"""Studies: a question, a grid of runs, and an analysis that reads tables only. Run them from the root of a clone."""
