"""Studies: a question, a grid of runs, and an analysis that reads tables only.

| file | what it holds |
|---|---|
| `study.py` | what a study is: scales, steps of work, analysis; the registry |
| `run.py` | carrying out the steps that are not finished, then the analysis |
| `status.py` | what a study costs and how far it is, from its stores alone |
| `speed.py` | how fast this machine steps a task |
| `errors.py` | `StudyError` |
| `horizon/` | does a policy hold beyond its training horizon, and does a constant time-to-go help? |
| `placement/` | do placed objects stay, and which release strategy and which world decide it? |
"""

from perdure.studies.errors import StudyError
from perdure.studies.study import Count, How, Step, Study, find_study, list_studies

__all__ = ["Count", "How", "Step", "Study", "StudyError", "find_study", "list_studies"]
