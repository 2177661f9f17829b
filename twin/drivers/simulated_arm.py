"""Driver of a simulated arm, which follows its planned motion in real time without hardware."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from planning.motion.near_path import nearest_points_on_path
from planning.transforms import Array
from twin.drivers.driver import ClearedNode, DriverState, Mode, Sample, ToolOrder


class SimulatedArm:
    """A driver that executes nodes with their planned durations.

    Args:
        clock: returns the time [s].
        pace: factor on the planned speed.
        fails: returns whether a skill fails, given its first node.
        stands: joint positions of the arm after a restart, shape (n,); by default those of the plan.
        reach: greatest distance from the path after a restart [rad or m].
    """

    def __init__(
        self,
        clock: Callable[[], float] = time.monotonic,
        *,
        pace: float = 1.0,
        fails: Callable[[ClearedNode], bool] = lambda _: False,
        stands: Array | None = None,
        reach: float = 0.01,
    ) -> None:
        self._clock, self._pace, self._fails = clock, pace, fails
        self._stands, self._reach = stands, reach
        self._start = np.zeros(0) if stands is None else stands
        self._nodes: list[ClearedNode] = []
        self._first = self._done = 0
        self._failed, self._gone, self._at = -1, 0.0, clock()
        self._held, self._words = False, ""
        self._samples: list[Sample] = []
        self._order, self._acted_s = ToolOrder("", "", 0.0), -math.inf

    def begin(self, start: Array, done: int) -> None:
        """Start at the planned configuration; see Driver."""
        self._first = self._done = done
        self._start = start

    def take(self, nodes: list[ClearedNode]) -> None:
        """Append cleared nodes; see Driver."""
        self._advance()
        if self._failed >= 0:
            # The arm is at the start of the failed skill, not at its end.
            k = self._failed - self._first
            stands = self._before(k)[None]
            tried = replace(self._nodes[k], waypoints=stands, seconds=np.zeros(1))
            self._nodes[k:] = [tried]
            self._done, self._gone = self._failed + 1, 0.0
            self._failed, self._words = -1, ""
        self._nodes += nodes
        if self._stands is not None:
            self._locate_on_path()

    def _locate_on_path(self) -> None:
        """Start at the nearest point of the path, unless it is too far away."""
        assert self._stands is not None
        found = []
        for k, node in enumerate(self._nodes):
            corners = np.vstack([self._before(k), node.waypoints])
            near = nearest_points_on_path(corners, self._stands[None])
            gone = node.passed_s(int(near.leg[0]), float(near.share[0]))
            found.append((float(near.off[0]), k, gone))
        off, k, gone = min(found, default=(0.0, 0, 0.0))
        if off > self._reach:
            self._words = f"stands {off:.3f} rad away from what is left of its path"
        self._done, self._gone, self._stands = self._first + k, gone, None

    def state(self) -> DriverState:
        """Return the state of the arm."""
        self._advance()
        going = self._current is not None and self._failed < 0
        mode: Mode = "moving" if going else "standing"
        mode = "held" if self._held else mode
        if self._words and self._failed < 0:
            mode = "fault"
        begun = self._done + (going and self._gone > 0.0)
        q, dq = self._motion()
        self._sample(self._at)
        samples, self._samples = tuple(self._samples), []
        return DriverState(
            begun,
            self._done,
            mode,
            q,
            dq if mode == "moving" else np.zeros_like(q),
            0.0,
            self._failed,
            self._words,
            samples,
            self._order.name if self._at >= self._acted_s else "",
        )

    def act(self, order: ToolOrder) -> None:
        """Close or open the tool; see Driver."""
        self._order = order
        self._acted_s = self._clock() + order.seconds / self._pace

    def hold(self, held: bool) -> None:
        """Stop the arm, or let it continue."""
        self._advance()
        self._held = held

    def leave(self) -> None:
        """Do nothing: the arm continues to the end of its cleared nodes."""

    def _sample(self, at_s: float, *, begins: bool = False) -> None:
        begun = self._done + (begins or self._gone > 0.0)
        self._samples.append(Sample(at_s, self._motion()[0], begun, self._done))

    @property
    def _current(self) -> ClearedNode | None:
        k = self._done - self._first
        return self._nodes[k] if k < len(self._nodes) else None

    def _before(self, k: int) -> Array:
        return self._nodes[k - 1].waypoints[-1] if k else self._start

    def _advance(self) -> None:
        """Advance to the present time."""
        now = self._clock()
        left, self._at = (now - self._at) * self._pace, now
        if self._held or self._words or self._stands is not None:
            return
        while left > 0.0 and (node := self._current) is not None:
            if self._gone <= 0.0:
                self._sample(now - left / self._pace, begins=True)
            for passed in node.seconds[:-1]:
                if self._gone < passed < self._gone + left:
                    left -= passed - self._gone
                    self._gone = float(passed)
                    self._sample(now - left / self._pace)
            whole = float(node.seconds[-1])
            if self._gone + left < whole:
                self._gone += left
                return
            left -= whole - self._gone
            if self._begins_skill(node) and self._fails(node):
                self._failed, self._words = node.node, f"{node.label} failed"
                self._gone = 0.0
                return
            self._done, self._gone = self._done + 1, 0.0
            self._sample(now - left / self._pace)

    def _begins_skill(self, node: ClearedNode) -> bool:
        k = node.node - self._first
        first = k == 0 or self._nodes[k - 1].task != node.task
        return first and node.kind != "transit"

    def _motion(self) -> tuple[Array, Array]:
        """Return configuration and joint speeds."""
        k, node = self._done - self._first, self._current
        before = self._before(k) if self._stands is None else self._stands
        if node is None or self._gone <= 0.0 or self._stands is not None:
            return before, np.zeros_like(before)
        times = np.array([0.0, *node.seconds])
        corners = np.vstack([before, node.waypoints])
        leg = int(np.clip(np.searchsorted(times, self._gone), 1, len(node.seconds)))
        pace = (corners[leg] - corners[leg - 1]) / (times[leg] - times[leg - 1])
        q = corners[leg - 1] + pace * (self._gone - times[leg - 1])
        return q, pace * self._pace
