"""Films of the moment at which a policy fails, found by the verdict.

| file | what it holds |
|---|---|
| `watch.py` | `watch`: find the moment, render it, write the film |
| `twin.py` | the Gymnasium environment that stands in for a task, since EnvPool cannot render |
| `moment.py` | episodes judged in that environment |
| `replay.py` | an episode stepped once more, with its simulation to look at |
| `camera.py` | pictures of a MuJoCo simulation, with or without a display |
| `captions.py`, `mp4.py` | words in pictures; the file |
| `errors.py` | `FilmError` |

Needs the extra `perdure[film]`.
"""

from perdure.extrapolate.film.errors import FilmError
from perdure.extrapolate.film.watch import Film, watch

__all__ = ["Film", "FilmError", "watch"]
