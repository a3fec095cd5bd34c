"""Studies: a question, a grid of runs, and an analysis that reads tables only.

| file | what it holds |
|---|---|
| `study.py` | `Study`: scales, resumable steps, analysis; the registry |
| `run.py` | run the unfinished steps, then the analysis |
| `status.py` | remaining time and progress, read from the stores |
| `speed.py` | simulation speed of a task on this machine |
| `errors.py` | `StudyError` |
| `horizon/` | does a policy hold beyond its training horizon, and does a constant time-to-go help? |
| `placement/` | do placed objects stay, and which release strategy and which world decide it? |
"""

from perdure.studies.errors import StudyError
from perdure.studies.study import RunOptions, StepProgress, Study, StudyStep, find_study, list_studies

__all__ = ["RunOptions", "StepProgress", "Study", "StudyError", "StudyStep", "find_study", "list_studies"]
