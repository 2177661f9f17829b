"""Rounding of transit corners, so that robots need not stop there.

A corner is rounded where this is free of collisions and saves time. The swept volume of the curve is checked
first against static obstacles, then against all other nodes, which determines their order. The corners and the
amount of rounding are chosen for the shortest time within the limits of the robot. The makespan never increases.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from planning.progress import Progress, no_progress
from planning.transforms import Array
from scheduling.conflicts.derived_tpg import DerivedTpg, occupant_of_nodes
from scheduling.corners.bends import BentNodes, NodesLeft, TransitRun, find_runs
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.invariant import check_invariant
from scheduling.motion_times import (
    assign_node_times,
    nominal_durations,
    stretch_numbers,
)
from scheduling.pace import paces
from scheduling.shortcuts.candidates import find_spans
from scheduling.shortcuts.graph_pieces import GraphPieces
from scheduling.shortcuts.replacement_check import ReplacementConflicts
from scheduling.shortcuts.rewiring import Swap, rewire
from scheduling.shortcuts.stand_check import are_standing_robots_clear
from scheduling.shortcuts.static_scene import StaticSceneCache
from scheduling.stretch_times import stretch_drive

_SHORTER = 0.6
"""Factor by which a blocked window is shortened for the next try."""

_SHORTEST = 0.03
"""Corners whose windows would be a smaller share of the longest ones are not rounded."""

_TRIES = 30
"""How often the windows of a run may be made shorter."""

_LATER = 1e-9
"""Makespans that differ by less are the same [s]."""

_GAIN = 1e-4
"""Least time that the omission of a rest must save [s]."""

_MOST_WAYS = 16
"""Greatest number of consecutive legs without a rest."""


def round_corners(
    tpg: TemporalPlanGraph, *, progress: Progress = no_progress
) -> TemporalPlanGraph:
    """Return a graph in which robots with acceleration limits pass corners of transits at speed.

    It is the same graph where no corner was rounded. Nodes are not timed yet, see
    ``assign_node_times``.

    Args:
        tpg: a graph that keeps its invariant, without rounded corners.
        progress: called with the runs done and in all.

    Raises:
        PlanInvariantError: the result breaks the invariant, a fault of this program.
    """
    timed = assign_node_times(tpg)
    chains = [
        replace(chain, duration=other.duration)
        for chain, other in zip(tpg.chains, timed.chains, strict=True)
    ]
    rounder = _Rounder(replace(tpg, chains=tuple(chains)))
    for done, run in enumerate(rounder.runs):
        progress(done, len(rounder.runs))
        rounder.round_run(run)
    progress(len(rounder.runs), len(rounder.runs))
    found = rounder.graph.tpg
    if all(chain.corners is None for chain in found.chains):
        return tpg
    check_invariant(DerivedTpg(found))
    return found


class _Rounder:
    """Current graph, and its runs whose corners may be rounded.

    Args:
        tpg: the graph; durations are those within limits.

    Attributes:
        graph: as it is now.
        runs: all runs, chain by chain.
    """

    def __init__(self, tpg: TemporalPlanGraph) -> None:
        self.graph = DerivedTpg(tpg)
        self._scenery = StaticSceneCache()
        spans = find_spans(self.graph)
        self._pieces = GraphPieces(tpg, spans)
        self.runs: list[TransitRun] = []
        for k, (chain, pace) in enumerate(zip(tpg.chains, paces(tpg), strict=True)):
            mine = [span for span in spans if span.chain == k]
            if pace is not None and mine:
                self.runs += find_runs(chain, mine, stretch_numbers(tpg, k), pace)

    def round_run(self, run: TransitRun) -> None:
        """Round the corners of a run where it saves time; the makespan does not grow."""
        before, choice, most = self.graph, _Choice(run), run.longest.copy()
        for _ in range(_TRIES):
            most[most < _SHORTEST * run.longest] = 0.0
            rests = choice.rests(most)
            swaps = self._round(run, rests, most)
            if swaps is None:
                continue
            if not swaps:
                return
            latest = before.rollout.makespan + _LATER
            if self._time(run, rests) and self.graph.rollout.makespan <= latest:
                return
            self._undo(before, swaps)
            most *= _SHORTER

    def _round(
        self, run: TransitRun, rests: list[int], most: Array
    ) -> list[Swap] | None:
        """Round all corners of a run but some; return the replaced nodes.

        Args:
            run: the run.
            rests: ends of legs at which the robot rests, from first to last.
            most: longest windows at the ends of legs; blocked ones are shortened.

        Returns:
            None where a bend is blocked: then nothing is replaced.
        """
        before, swaps, left = self.graph, list[Swap](), NodesLeft(run)
        for first, last in pairwise(rests):
            if last - first < 2:
                continue
            windows = run.windows(first, last, most)
            path, curve = run.rounded(first, last, windows)
            assert curve is not None
            for low, high in run.bends(path, curve):
                chain = self.graph.tpg.chains[run.chain]
                found = left.bent(chain, path, low, high)
                blocked = (low, high) if found is None else self._insert_bend(found)
                if found is None or blocked is not None:
                    _shorten(run, most, windows, first, blocked or (low, high))
                    self._undo(before, swaps)
                    return None
                swaps.append(found.swap)
        return swaps

    def _insert_bend(self, found: BentNodes) -> tuple[float, float] | None:
        """Insert the nodes of a bend, or return the blocked part of the path."""
        graph, nodes, swap = self.graph, found.nodes, found.swap
        scene = self._scenery.scene_during(graph, swap.chain, swap.first, swap.last)
        chords = np.vstack([nodes.start[None], nodes.waypoints])
        for k, (a, b) in enumerate(pairwise(chords)):
            if not scene.checker.motion_free(a, b):
                node = int(np.searchsorted(nodes.first, k, side="right")) - 1
                return float(found.times[node]), float(found.times[node + 1])
        occupant = occupant_of_nodes(
            graph, swap.chain, swap.first, swap.last + 1, nodes
        )
        conflicts_of_new = ReplacementConflicts(graph, self._pieces, swap, occupant)
        candidate = rewire(graph, swap, nodes, conflicts_of_new.edges(graph) or ())
        if not are_standing_robots_clear(candidate, self._pieces, swap, occupant):
            return float(found.times[0]), float(found.times[-1])
        self.graph = candidate
        self._pieces.replace_nodes(swap)
        return None

    def _undo(self, before: DerivedTpg, swaps: list[Swap]) -> None:
        self.graph = before
        for swap in swaps:
            self._pieces.replace_nodes(swap)

    def _time(self, run: TransitRun, rests: list[int]) -> bool:
        """Set the times of a run by its limits; tell whether it takes less time."""
        graph = self.graph
        chain = graph.tpg.chains[run.chain]
        duration = chain.duration.copy()
        for first, last in pairwise(rests):
            begin, stop = run.begins[first], run.begins[last]
            drive = stretch_drive(run.pace, chain, begin, stop)
            duration[begin:stop] = nominal_durations(drive)
        chains = list(graph.tpg.chains)
        chains[run.chain] = replace(chain, duration=duration)
        timed = replace(graph.tpg, chains=tuple(chains))
        own = slice(run.begins[0], run.begins[-1])
        quicker = bool(duration[own].sum() < chain.duration[own].sum())
        self.graph = graph.derive(timed, "ranks", "history", "spans", "order", "flat")
        return quicker


class _Choice:
    """Choice of the corners of a run at which a robot rests, for the least time.

    Args:
        run: the run.
    """

    def __init__(self, run: TransitRun) -> None:
        self._run = run
        self._known: dict[tuple[int, int, bytes], float] = {}

    def rests(self, most: Array) -> list[int]:
        """Return the ends of legs at which the robot rests, the first and the last included.

        Args:
            most: longest windows at the ends of legs, 0 where nothing can be rounded [s].
        """
        count = len(self._run.at) - 1
        least, came = np.zeros(count + 1), np.zeros(count + 1, dtype=np.int64)
        for stop in range(1, count + 1):
            least[stop] = np.inf
            for begin in range(stop - 1, max(stop - 1 - _MOST_WAYS, -1), -1):
                if begin + 1 < stop and most[begin + 1] <= 0.0:
                    break
                gain = 0.0 if begin + 1 == stop else _GAIN
                seconds = least[begin] + self._seconds(begin, stop, most)
                if seconds < least[stop] - gain:
                    least[stop], came[stop] = seconds, begin
        rests = [count]
        while rests[-1] > 0:
            rests.append(int(came[rests[-1]]))
        return rests[::-1]

    def _seconds(self, first: int, last: int, most: Array) -> float:
        """Return the time of some legs without a rest, see ``TransitRun.seconds``."""
        run, windows = self._run, np.empty(0)
        if last - first > 1:
            windows = run.windows(first, last, most)
        key = first, last, windows.tobytes()
        if key not in self._known:
            self._known[key] = run.seconds(first, last, windows)
        return self._known[key]


def _shorten(
    run: TransitRun, most: Array, windows: Array, first: int, part: tuple[float, float]
) -> None:
    """Shorten the longest windows at the corners that bend a part of a run.

    Args:
        run: the run.
        most: longest windows at the ends of its legs; changed in place.
        windows: at the corners after end ``first``, as they were tried.
        first: that end.
        part: the part, from and to [s].
    """
    own = np.arange(first + 1, first + 1 + len(windows))
    near = run.at[own] + 0.5 * windows > part[0]
    near &= run.at[own] - 0.5 * windows < part[1]
    if not np.any(near):
        near[:] = True
    most[own[near]] = _SHORTER * windows[near]
