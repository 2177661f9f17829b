"""Static obstacles around nodes that are to be replaced, and collision-free paths among them."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple
from zlib import crc32

import numpy as np
import numpy.typing as npt

from planning.caches import BoundedCache
from planning.cell.workcell import Attachment, Workcell, WorldState
from planning.geometry.scene_checker import SceneChecker
from planning.motion.motion_cache import Pairs, SceneIndex
from planning.motion.sequential import MARGIN
from planning.motion.speed import SpeedModel
from planning.motion.transit import shortcut_polyline
from planning.transforms import Array, Indices
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.conflicts.object_spans import Rest

_SMOOTHING = 40
"""Random shortcuts tried to smooth a span, or a part of one."""

_KEPT_WAYS = 20_000
"""Capacity in paths."""

_KEPT_SCENES = 64
"""Scenes that are kept. There are more of them the more objects there are, and each knows all of
these: without a bound their memory would grow with the square of the objects."""


class SmoothedPathCache:
    """Cache of smoothed paths and of collision-free paths, for plans of one cell with the same speeds.

    Args:
        seed: of the smoothing. A path is smoothed identically in the same scene.

    Attributes:
        scenes: that robots moved in.
        smoothed: paths by scene and by their original.
        free: whether paths are free, by scene and waypoints.
    """

    def __init__(self, seed: int) -> None:
        self.scenes, self.seed = SceneIndex(), seed
        self.smoothed: BoundedCache[Array] = BoundedCache(_KEPT_WAYS)
        self.free: BoundedCache[bool] = BoundedCache(_KEPT_WAYS)


@dataclass(frozen=True)
class StaticScene:
    """One moving robot among obstacles that never move.

    Attributes:
        cell: without the robots that have nodes of their own.
        robot: its name.
        state: what is where.
        allowed: allowed contacts.
        known: what was found in the same scenes before; None to find all again.
    """

    cell: Workcell
    robot: str
    state: WorldState
    allowed: Pairs
    known: SmoothedPathCache | None = None

    @cached_property
    def checker(self) -> SceneChecker:
        """Collision checker of the robot."""
        return SceneChecker(
            self.cell, self.robot, self.state, self.allowed, margin=MARGIN
        )

    def smoothed(
        self, path: Array, speed: SpeedModel, rng: np.random.Generator
    ) -> Array:
        """Return a path shortened by a few tries, checked against static obstacles only.

        Args:
            path: polyline, shape (w, n).
            speed: what decides which path is faster.
            rng: of the tries; where paths are known each has its own.
        """
        if self.known is None:
            return shortcut_polyline(self.checker, path, speed, rng, _SMOOTHING)
        text = path.tobytes()
        own = np.random.default_rng([self.known.seed, crc32(text)])
        return self.known.smoothed.get(
            (self._scene, text),
            lambda: shortcut_polyline(self.checker, path, speed, own, _SMOOTHING),
        )

    def free(self, path: Array) -> bool:
        """Tell whether a polyline, shape (w, n), is free."""

        def find() -> bool:
            return all(self.checker.motion_free(a, b) for a, b in pairwise(path))

        if self.known is None:
            return find()
        return self.known.free.get((self._scene, path.tobytes()), find)

    @cached_property
    def _scene(self) -> Hashable:
        assert self.known is not None
        scene = self.known.scenes.scene(self.cell, self.state, [self.allowed])
        return self.robot, scene


class StaticSceneCache:
    """Cache of the static obstacles around nodes to be replaced.

    Args:
        known: what was found in the same scenes before, None to find it again.
    """

    def __init__(self, known: SmoothedPathCache | None = None) -> None:
        self._known = known
        self._scenes: BoundedCache[StaticScene] = BoundedCache(_KEPT_SCENES)
        self._rests: _Rests | None = None

    def scene_during(
        self, graph: DerivedTpg, index: int, first: int, last: int
    ) -> StaticScene:
        """Return the static obstacles during some nodes.

        Args:
            graph: as it is.
            index: chain of the nodes.
            first, last: the nodes.
        """
        chain = graph.tpg.chains[index]
        present = self._present(graph, index, first, last)
        tasks = frozenset(chain.task[first : last + 1].tolist())
        # Within a span, the load of the robot does not change.
        key = (index, tasks, present.tobytes())

        def build() -> StaticScene:
            rests = graph.history.rests
            there = tuple(rests[k] for k in np.flatnonzero(present).tolist())
            return _build_scene(graph, index, first, tasks, there, self._known)

        return self._scenes.get(key, build)

    def _present(
        self, graph: DerivedTpg, index: int, first: int, last: int
    ) -> npt.NDArray[np.bool_]:
        """Return the rests that may overlap in time with some nodes."""
        if self._rests is None:
            self._rests = _Rests.of(graph)
        at_rest, after, before = self._rests
        order = graph.order
        late = order.clock[order.first[after[:, 0]] + after[:, 1], index] >= last
        waits_for = order.of(index)[first - 1]
        gone = waits_for[before[:, 0]] >= before[:, 1]
        gone |= (before == (index, first - 1)).all(axis=1)
        late &= after[:, 1] >= 0
        gone &= before[:, 1] >= 0
        return np.asarray(at_rest & ~late & ~gone)


class _Rests(NamedTuple):
    """Node intervals in which objects are at rest, one row per rest.

    Attributes:
        lying: True for those that are in no robot's hand, shape (rests,).
        after, before: chain and node that leaves an object there and that takes it away, node
            -1 for none, shape (rests, 2).
    """

    lying: npt.NDArray[np.bool_]
    after: Indices
    before: Indices

    @staticmethod
    def of(graph: DerivedTpg) -> _Rests:
        """Return the rests of a graph."""
        rests = graph.history.rests
        after = [rest.after or (0, -1) for rest in rests]
        before = [rest.before or (0, -1) for rest in rests]
        return _Rests(
            np.array([rest.holder is None for rest in rests], dtype=np.bool_),
            np.array(after, dtype=np.int64).reshape(-1, 2),
            np.array(before, dtype=np.int64).reshape(-1, 2),
        )


def _build_scene(
    graph: DerivedTpg,
    index: int,
    first: int,
    tasks: frozenset[int],
    present: tuple[Rest, ...],
    known: SmoothedPathCache | None,
) -> StaticScene:
    """Return all static obstacles, without robots that have nodes."""
    tpg = graph.tpg
    robot = tpg.chains[index].robot
    busy = tpg.chain_index
    handled = {handling.object for handling in tpg.handlings}
    attachments = {
        item.name: Attachment(None, item.start)
        for item in tpg.cell.objects
        if item.name not in handled
    }
    for rest in present:
        attachments[rest.object] = Attachment(None, rest.pose)
    for span in graph.spans[index]:
        if span.carried and span.start <= (first, 0) < span.end:
            attachments[span.object] = Attachment(robot, span.pose)
    robots = tuple(r for r in tpg.cell.robots if r.name == robot or r.name not in busy)
    cell = Workcell(robots, tpg.cell.fixtures, tpg.cell.objects, tpg.cell.clearances)
    state = WorldState({r.name: r.home for r in robots}, attachments)
    allowed = frozenset(
        frozenset((c.first, c.second)) for c in tpg.allowed if tasks <= c.tasks
    )
    return StaticScene(cell, robot, state, allowed, known)
