"""Studies: a question, a grid of runs, and the analysis that answers it from tables alone."""
