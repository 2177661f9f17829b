"""Playback of a run in a scene: time, speed, and frames at a steady rate."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager

from twin.view.cell_scene import CellScene
from twin.view.look_panel import LookPanel
from twin.view.run_playback import RunPlayback

_FRAME_S = 1 / 30
"""Least time between two frames [s]."""

_WAITS_S = 3.0
"""How long the waits of another time are shown, unless the page asks for them again [s]."""

SPEEDS = (0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 50.0)
"""Speeds that can be chosen, as multiples of real time."""


class Player:
    """Shows a run in a scene at a time that advances while it plays, in a thread of its own until ``stop``.

    Args:
        run: the run.
        scene: where it is shown.
        look: what is shown beside the bodies.
        frame: context in which the poses of a frame are sent together.

    Attributes:
        now_s: time that is shown [s].
        playing: whether time advances.
        speed: multiple of real time.
    """

    def __init__(
        self,
        run: RunPlayback,
        scene: CellScene,
        look: LookPanel,
        frame: Callable[[], AbstractContextManager[None]],
    ) -> None:
        self.run, self._scene, self._look, self._frame = run, scene, look, frame
        self.now_s, self.playing, self.speed = 0.0, False, 1.0
        self._shown: object = None
        self._waits_s: float | None = None
        self._waits_until_s = 0.0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._play, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._over.set()
        self._thread.join(timeout=5.0)

    def seek(self, t_s: float) -> None:
        """Show a time, within the run [s]."""
        self.now_s = min(max(t_s, 0.0), self.run.end_s)

    def play(self, *, playing: bool) -> None:
        """Play on, from the beginning where the run is over; or pause."""
        if playing and self.now_s >= self.run.end_s:
            self.seek(0.0)
        self.playing = playing

    def step(self, *, backwards: bool) -> None:
        """Pause at the next event of the run, or at the one before."""
        self.playing = False
        self.seek(self.run.neighbour_s(self.now_s, backwards=backwards))

    def show_waits(self, t_s: float | None) -> None:
        """Show for a moment who waits for what at another time than the one that is shown [s]; None for that one."""
        self._waits_s, self._waits_until_s = t_s, time.monotonic() + _WAITS_S

    def show(self) -> None:
        """Send the poses of the time that is shown, unless they were."""
        t_s, chosen = self.now_s, self._look.chosen
        waits_s = self._waits_s
        if waits_s is None or time.monotonic() > self._waits_until_s:
            waits_s = t_s
        if self._shown == (t_s, waits_s, chosen):
            return
        configurations = self.run.configurations(t_s)
        poses = self.run.objects(t_s, configurations)
        with self._frame():
            for robot, q in configurations.items():
                self._scene.move_robot(robot, q)
            self._scene.move_objects(poses)
            self._look.show(t_s, configurations, poses, waits_s)
        self._shown = t_s, waits_s, chosen

    def _play(self) -> None:
        before = time.monotonic()
        while not self._over.wait(_FRAME_S):
            now = time.monotonic()
            if self.playing:
                self.seek(self.now_s + self.speed * (now - before))
                self.playing = self.now_s < self.run.end_s
            before = now
            self.show()
