"""The study of chapter 2: do placed objects stay, and which release strategy and which world decide it?

| file | what it holds |
|---|---|
| `grid.py` | the rows: task, release strategy, split, world, seeds |
| `tables.py` | the committed tables, the rows of new logs, tables of the pages |
| `figures.py` | success by rolling resistance; placements that stay by release speed |
| `study.py` | units of work; analysis |
"""
