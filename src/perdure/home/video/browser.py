"""A live view of the oracle in a browser; the view can be turned and zoomed."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from perdure.home.benchmark.episodes import Episode
from perdure.home.errors import HomeError
from perdure.home.evaluate.execute import ExecutorOptions
from perdure.home.sim.world import CONTROL_HZ, Simulator, VectorSimulator
from perdure.home.video.narrate import Narrator
from perdure.home.video.render_episode import render_episode


def serve_episode(
    episode: Episode, port: int = 8080, speed: float = 1.0, seed: int = 0, report: Callable[[str], None] = print
) -> None:
    """Show the oracle in an episode, over and over, on a page served by this machine.

    Args:
        episode: The episode.
        port: Port of the server.
        speed: Playback speed relative to real time.
        seed: Evaluation seed: draws the robot's start pose.
        report: Called with the address, and with each new step of the plan.

    Raises:
        HomeError: If mjviser is not installed or the speed is not positive.
    """
    if not speed > 0.0:
        raise HomeError(f"the speed must be above 0, not {speed}")
    try:
        import mjviser
        import viser
    except ImportError as error:
        raise HomeError("a live view needs mjviser: pip install 'perdure[viewer]'") from error
    server = viser.ViserServer(port=port, verbose=False)
    report(f"http://localhost:{server.get_port()}")
    try:
        while True:
            server.scene.reset()
            render_episode(episode, _Broadcast(mjviser, server, speed, report), ExecutorOptions(eval_seed=seed))
    finally:
        server.stop()


class _Broadcast:
    """Sends the scene to the page after every control step, at the playback speed."""

    def __init__(self, mjviser: Any, server: Any, speed: float, report: Callable[[str], None]) -> None:
        self._mjviser, self._server, self._speed, self._report = mjviser, server, speed, report
        self._scene: Any = None
        self._due, self._words = 0.0, ""

    def __call__(self, world: VectorSimulator, simulator: Simulator, narrator: Narrator) -> bool:
        if self._scene is None:
            self._scene = self._mjviser.ViserMujocoScene(self._server, simulator.model, num_envs=1)
            self._due = time.monotonic()
        self._scene.update_from_mjdata(simulator.data)
        caption = narrator.caption()
        if caption.words != self._words:
            self._words = caption.words
            self._report(f"{caption.seconds:6.1f} s  {caption.words}")
        self._due += 1.0 / (CONTROL_HZ * self._speed)
        time.sleep(max(0.0, self._due - time.monotonic()))
        return True
