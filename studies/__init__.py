"""Studies: a question, a grid of runs, and an analysis that reads tables only. Run them from the root of a clone.

| file | what it holds |
|---|---|
| `__main__.py` | `python -m studies NAME`: run, show or analyze a study |
| `files.py` | what units left; tables, and their copies in pages |
| `horizon/` | does a policy hold beyond its training horizon, and does a constant time-to-go help? |
| `placement/` | do placed objects stay, and which release strategy and which world decide it? |
"""
