"""An episode live in a browser: the oracle works, the page can be turned and zoomed."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from perdure.home.benchmark.episodes import Episode
from perdure.home.errors import HomeError
from perdure.home.evaluate.execute import ExecutorOptions
from perdure.home.sim.world import CONTROL_HZ, Lane, World
from perdure.home.video.narrate import Narrator
from perdure.home.video.render_episode import render_episode


def serve_episode(
    episode: Episode,
    port: int = 8080,
    speed: float = 1.0,
    seed: int = 0,
    rounds: int | None = None,
    tell: Callable[[str], None] = print,
) -> None:
    """Shows the oracle at an episode, over and over, on a page served on this machine.

    Args:
        episode: Which one.
        port: Of the server.
        speed: How much faster than life it runs.
        seed: Evaluation seed: draws where the robot starts.
        rounds: How often the episode is shown, for ever when None.
        tell: Called with the address, and with each new step of the plan.

    Raises:
        HomeError: If mjviser is not installed or the speed is none.
    """
    if not speed > 0.0:
        raise HomeError(f"the speed must be above 0, not {speed}")
    try:
        import mjviser
        import viser
    except ImportError as error:
        raise HomeError("a live view needs mjviser: pip install 'perdure[viewer]'") from error
    server = viser.ViserServer(port=port, verbose=False)
    tell(f"http://localhost:{server.get_port()}")
    try:
        shown = 0
        while rounds is None or shown < rounds:
            server.scene.reset()
            render_episode(episode, _Broadcast(mjviser, server, speed, tell), ExecutorOptions(eval_seed=seed))
            shown += 1
    finally:
        server.stop()


class _Broadcast:
    """Sends the world to the page after every control step, no faster than wanted."""

    def __init__(self, mjviser: Any, server: Any, speed: float, tell: Callable[[str], None]) -> None:
        self._mjviser, self._server, self._speed, self._tell = mjviser, server, speed, tell
        self._scene: Any = None
        self._due, self._words = 0.0, ""

    def __call__(self, world: World, double: Lane, narrator: Narrator) -> bool:
        if self._scene is None:
            self._scene = self._mjviser.ViserMujocoScene(self._server, double.model, num_envs=1)
            self._due = time.monotonic()
        self._scene.update_from_mjdata(double.data)
        told = narrator.tell()
        if told.words != self._words:
            self._words = told.words
            self._tell(f"{told.seconds:6.1f} s  {told.words}")
        self._due += 1.0 / (CONTROL_HZ * self._speed)
        time.sleep(max(0.0, self._due - time.monotonic()))
        return True
