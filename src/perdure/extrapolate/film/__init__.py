"""Films of a policy's failure, at the step that the verdict found.

| file | what it holds |
|---|---|
| `watch.py` | `watch`: find the moment, render it, write the film |
| `render_env.py` | the Gymnasium environment that is rendered instead of a task |
| `judge.py` | run and judge episodes in that environment |
| `replay.py` | step a judged episode again, with access to its simulation |
| `camera.py` | pictures of a MuJoCo simulation, with or without a display |
| `captions.py`, `mp4.py` | words in pictures; the file |
| `errors.py` | `FilmError` |

Needs the extra `perdure[film]`.
"""

from perdure.extrapolate.film.errors import FilmError
from perdure.extrapolate.film.watch import Film, watch

__all__ = ["Film", "FilmError", "watch"]
