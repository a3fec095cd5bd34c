"""The study of chapter 2: do placed objects stay, and which release strategy and which world decide it?

| file | what it holds |
|---|---|
| `study.py` | the plan of steps and the study's scales |
| `grid.py` | the rows: task, release strategy, split, world, seeds |
| `row_step.py`, `unit_steps.py` | rows and single measurements as resumable steps |
| `hand_over.py` | descent and speed of the hand-over by inverse kinematics |
| `halt_in_noise.py` | apples that stay if the robot halts under exploration noise |
| `summaries.py`, `results.py` | rows from logs; the committed table of strategies |
| `schema.py` | what the table of strategies may hold |
| `release_speed.py` | the share of placements that stay, by release speed |
| `markdown.py` | tables for the documentation |
| `figure_*.py` | figures 2-1, 2-2, 2-3 and 2-5 of the thesis, strategies by world, release speed |
| `analyze.py`, `page.py` | writing all of it |
"""
