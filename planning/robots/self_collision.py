"""Pairs of a robot's links that need no self-collision check."""

from __future__ import annotations

import heapq
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt

from planning.caches import Arrays, load_or_compute
from planning.cell.robot_model import KinematicChain, LinkPart
from planning.geometry import exact
from planning.geometry.exact import Solid, hull_distance_at
from planning.kinematics import chain as kinematic_chain
from planning.kinematics.chain import chain_table
from planning.transforms import Array

_SAMPLES = 60
"""Number of random configurations that are tested before a proof is tried."""

_BUDGET = 500
"""Largest number of boxes of joint values in the proof for one pair of links."""

_SOURCES = (__file__, exact.__file__, kinematic_chain.__file__)


def never_colliding_pairs(
    chain: KinematicChain,
    parts: tuple[LinkPart, ...],
    lower: Array,
    upper: Array,
    home: Array,
) -> frozenset[tuple[int, int]]:
    """Return pairs of part indices (low, high) that self-collision checks skip.

    Left out are

    - parts of one joint and of neighbouring joints: they touch by design;
    - pairs that overlap at HOME: HOME is collision-free, so hulls that overlap there stand for
      shapes that do not;
    - pairs that are proved never to touch: the joints between them are bisected until, in each
      box of joint values, the distance at its centre exceeds what the joints can close within
      the box. A pair that needs more than 500 boxes is left in; that costs time, not safety.

    They are remembered from run to run.

    Args:
        chain: the kinematics.
        parts: all parts of the robot.
        lower, upper: joint limits, shape (n,).
        home: HOME configuration, shape (n,).
    """
    arrays: list[npt.NDArray[Any]] = [
        *(p.body.vertices for p in parts),
        *(lower, upper, home),
    ]
    arrays += [chain.placement, chain.axis, chain.prismatic]
    numbers = repr(([p.joint for p in parts], [a.shape for a in arrays])).encode()
    question = [numbers, *(np.ascontiguousarray(a).tobytes() for a in arrays)]

    def find() -> Arrays:
        pairs = _Pairs(chain, parts, lower, upper, home).apart()
        return {"pairs": np.array(sorted(pairs), dtype=np.int64).reshape(-1, 2)}

    names = frozenset({"pairs"})
    known = load_or_compute("apart", b"".join(question), names, find, _SOURCES)
    return frozenset((int(a), int(b)) for a, b in known["pairs"])


class _Pairs:
    """Pairs of parts of a robot; arguments as of ``never_colliding_pairs``."""

    def __init__(
        self,
        chain: KinematicChain,
        parts: tuple[LinkPart, ...],
        lower: Array,
        upper: Array,
        home: Array,
    ) -> None:
        self._chain, self._parts = chain, parts
        self._lower, self._upper = lower, upper
        self._home = np.array(home, dtype=np.float64)
        joints = chain_table(chain, lower, upper)
        self._hulls = [Solid("", p.body, np.eye(4), joints, p.joint) for p in parts]

    def apart(self) -> set[tuple[int, int]]:
        """Return the pairs to skip."""
        parts, out, left = self._parts, set(), []
        for pair in combinations(range(len(parts)), 2):
            if (
                abs(parts[pair[0]].joint - parts[pair[1]].joint) <= 1
                or self._distance(pair, self._home) <= 0.0
            ):
                out.add(pair)
            else:
                left.append(pair)
        rng = np.random.default_rng(20)
        for _ in range(_SAMPLES):  # most pairs that can touch are dropped here, cheaply
            q = rng.uniform(self._lower, self._upper)
            left = [pair for pair in left if self._distance(pair, q) > 0.0]
        return out.union(pair for pair in left if self._proved_apart(pair))

    def _distance(self, pair: tuple[int, int], q: Array) -> float:
        return hull_distance_at(self._hulls[pair[0]], q, self._hulls[pair[1]], q)

    def _proved_apart(self, pair: tuple[int, int]) -> bool:
        """Bisect the joints between two parts; True when they touch at no joint values."""
        first, last = sorted(self._parts[k].joint for k in pair)
        between = np.arange(first + 1, last + 1)
        far_part = max(pair, key=lambda k: self._parts[k].joint)
        speed = self._speeds(self._parts[far_part])[between]
        q = self._home.copy()
        low, high = self._lower[between].copy(), self._upper[between].copy()
        slides = self._chain.prismatic[between]
        high = np.minimum(high, low + np.where(slides, np.inf, 2.0 * np.pi))

        def margin(box_low: Array, box_high: Array) -> tuple[float, float]:
            q[between] = (box_low + box_high) / 2.0
            distance = self._distance(pair, q)
            return distance - float(speed @ (box_high - box_low)) / 2.0, distance

        order = 0
        boxes = [(margin(low, high)[0], order, low, high)]
        while boxes:
            worst, _, low, high = heapq.heappop(boxes)
            if worst > 0.0:
                return True  # the least certain box is certain, so all are
            split = int(np.argmax(speed * (high - low)))
            middle = (low[split] + high[split]) / 2.0
            for side in range(2):
                half_low, half_high = low.copy(), high.copy()
                (half_high if side == 0 else half_low)[split] = middle
                order += 1
                bound, distance = margin(half_low, half_high)
                if distance <= 0.0 or order > _BUDGET:
                    return False
                heapq.heappush(boxes, (bound, order, half_low, half_high))
        return True

    def _speeds(self, part: LinkPart) -> Array:
        """Return a bound on the displacement of a part by each joint, per rad (or per m).

        The distance of a point from a joint's axis is at most the summed lengths of the links in
        between, sliding joints at their farthest.
        """
        slides = self._chain.prismatic
        speeds = np.zeros(len(slides))
        reach = float(np.linalg.norm(part.body.vertices, axis=1).max())
        for k in range(part.joint, -1, -1):
            slide = max(abs(self._lower[k]), abs(self._upper[k])) if slides[k] else 0.0
            speeds[k] = 1.0 if slides[k] else reach
            reach += float(np.linalg.norm(self._chain.placement[k, :3, 3])) + slide
        return speeds
