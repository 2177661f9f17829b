"""Search loop for the best cell design: choose designs, evaluate them, log results, and update the sampler.

The search ends when its budget is used up.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from planning.errors import OutputError
from twin.explorations.crew import DesignTask, Evaluators, evaluate_in_parallel
from twin.explorations.dimensions import (
    Dimension,
    Values,
    base_values,
    key_of,
    variant_of,
)
from twin.explorations.folder import SAMPLES
from twin.explorations.influence import pareto_front
from twin.explorations.journal import JOURNAL, REPLANNED, SEARCH, Journal, TriedDesign
from twin.explorations.rungs import Evaluation
from twin.explorations.search import Search
from twin.explorations.section import ExploreSection
from twin.host.progress import Report

SEARCHING = "designs"
"""Name of the stage for progress displays."""

_TIMES = frozenset({"makespan_s", "mean_s", "p50_s", "p90_s"})
"""Goals that are bounded by a plan without shortcuts."""

_MOST_AT_ONCE = 1000
"""Largest number of designs in evaluation; more indicate a damaged journal."""

_ENOUGH = 8
"""Designs that are planned in full before any is left behind."""


class Exploration:
    """A running exploration in its folder.

    Args:
        folder: of its files.
        section: dimensions and goals.
        dimensions: varied keys, with the scenario's values.
        seed: of all choices.
        progress: receives designs done and wanted.
    """

    def __init__(
        self,
        folder: Path,
        section: ExploreSection,
        dimensions: Sequence[Dimension],
        seed: int,
        progress: Report,
    ) -> None:
        self.folder, self.section, self.dimensions = folder, section, dimensions
        self.journal = Journal(folder)
        for number, row in enumerate(self.journal.rows, start=1):
            place = f"{folder / JOURNAL}, line {number}"
            if row.design >= len(self.journal.rows) + _MOST_AT_ONCE:
                raise OutputError(f"{place}: too few designs came before this one")
            if row.values.keys() != {one.key for one in dimensions}:
                raise OutputError(f"{place}: values are not of what is varied")
            for one in dimensions:
                if (value := row.values[one.key]) != one.base and not one.holds(value):
                    raise OutputError(f"{place}: {one.key} has no such value")
            if row.done and len(row.evaluation.goals) != len(section.goals):
                raise OutputError(f"{place}: goals are {len(section.goals)} numbers")
        self._progress = progress
        self._search = Search(
            dimensions,
            section.chosen_sampler,
            len(section.goals),
            seed,
            section.designs,
        )
        self._lost = self._search.replay(self.journal.searched)
        self._known: dict[str, TriedDesign] = {}
        self._packed_workloads: dict[tuple[str, int], bytes] = {}
        for row in self.journal.rows:
            self._remember(row)

    def search(self, crew: Evaluators, designs: int, seconds: float | None) -> None:
        """Try designs until the number or the time is reached.

        Args:
            crew: evaluates them.
            designs: in all, those that were tried before among them.
            seconds: after which no other is begun [s].
        """
        end = np.inf if seconds is None else time.monotonic() + seconds
        under_way: dict[int, tuple[Values, int]] = {}
        twins: dict[int, tuple[Values, int]] = {}
        taken = {row.design for row in self.journal.searched}
        begun = max((*taken, *self._lost, -1)) + 1
        again = [n for n in range(min(begun, designs)) if n not in taken]
        following = begun
        self._tell_progress(designs)
        while True:
            while crew.idle and time.monotonic() < end:
                if again:
                    number = again.pop(0)
                elif following < designs:
                    number, following = following, following + 1
                else:
                    break
                values = self._choose(number)
                asked = values, self._search.evaluated
                if any(key_of(v) == key_of(values) for v, _ in under_way.values()):
                    twins[number] = asked
                elif (known := self._known.get(key_of(values))) is not None:
                    self._tell(number, *asked, known.evaluation, known)
                else:
                    under_way[number] = asked
                    variant = variant_of(self.dimensions, values)
                    crew.submit(DesignTask(number, variant, self.longest_turns_s()))
                self._tell_progress(designs)
            if not under_way:
                break
            for task, found in crew.finished():
                self._tell(task.number, *under_way.pop(task.number), found)
                for number in sorted(twins):
                    values, asked_after = twins[number]
                    known = self._known.get(key_of(values))
                    if known is not None:
                        del twins[number]
                        self._tell(number, values, asked_after, known.evaluation, known)
                self._tell_progress(designs)

    def _choose(self, number: int) -> Values:
        if number == 0:
            return base_values(self.dimensions)
        if number in self._lost:
            return self._lost[number]
        return self._search.ask(number)

    def _tell(
        self,
        number: int,
        values: Values,
        asked_after: int,
        found: Evaluation,
        known: TriedDesign | None = None,
    ) -> None:
        """Log the evaluation of a design, then learn from it."""
        if found.outcome == "behind" and known is None:
            found = replace(found, goals=(self._estimated(found.turns_s),))
        same_as = None if known is None else known.design
        row = TriedDesign(number, SEARCH, values, asked_after, found, same_as)
        self.keep(row)
        self._search.tell(row)

    def keep(self, row: TriedDesign) -> None:
        """Log the evaluation of a design; workloads of the best are kept in memory.

        A workload is pickled, so it goes to no file: an exploration that is resumed plans again what it needs.
        """
        if row.done and row.evaluation.packed_workload:
            self._packed_workloads[row.purpose, row.design] = (
                row.evaluation.packed_workload
            )
        row = replace(row, evaluation=replace(row.evaluation, packed_workload=b""))
        self.journal.append(row)
        self._remember(row)
        if row.purpose == SEARCH:
            wanted = {0, *(r.design for r in self.finalists())}
            for purpose, design in list(self._packed_workloads):
                if purpose == SEARCH and design not in wanted:
                    del self._packed_workloads[purpose, design]

    def _remember(self, row: TriedDesign) -> None:
        """Index a design by its values; a further evaluation replaces an earlier one."""
        if row.purpose == REPLANNED:
            return
        there = self._known.setdefault(key_of(row.values), row)
        if there.evaluation.outcome == "behind" and row.evaluation.outcome != "behind":
            self._known[key_of(row.values)] = row

    def known(self, values: Values) -> TriedDesign | None:
        """Return the evaluated design with given values."""
        return self._known.get(key_of(values))

    def replanned(self, values: Values, planner_seed: int) -> TriedDesign | None:
        """Return the evaluation of a design with another planner seed, where tried."""
        wanted = key_of(values), str(planner_seed)
        for row in self.journal.rows:
            if row.purpose == REPLANNED and (key_of(row.values), row.about) == wanted:
                return row
        return None

    def evaluate(
        self,
        crew: Evaluators,
        purpose: str,
        wanted: Sequence[tuple[Values, str]],
        stage: str,
    ) -> None:
        """Evaluate designs outside of the search, and log each.

        Args:
            crew: evaluates them.
            purpose: purpose of the evaluation.
            wanted: values of each, and its subject: for REPLANNED the seed of the planner.
            stage: name for progress displays.
        """
        # Behind all that there are: designs of one purpose may have been finished out of turn.
        there = (r.design for r in self.journal.rows if r.purpose == purpose)
        first = max(there, default=-1) + 1
        tasks = []
        for number, (values, about) in enumerate(wanted, start=first):
            task = DesignTask(number, variant_of(self.dimensions, values))
            if purpose == REPLANNED:
                task = replace(task, planner_seed=int(about))
            tasks.append(task)
        for done, (task, found) in enumerate(evaluate_in_parallel(tasks, crew)):
            self._progress(stage, done, len(tasks))
            values, about = wanted[task.number - first]
            self.keep(TriedDesign(task.number, purpose, values, 0, found, about=about))
        self._progress(stage, 1, 1)

    def packed_workload_of(self, row: TriedDesign) -> bytes:
        """Return the packed workload of a design; empty where this process has not evaluated it."""
        design = row.design if row.same_as is None else row.same_as
        return self._packed_workloads.get((row.purpose, design), b"")

    def keep_packed_workload(self, row: TriedDesign, packed_workload: bytes) -> None:
        """Keep the packed workload of a design in memory."""
        self._packed_workloads[row.purpose, row.design] = packed_workload

    def samples_of(self, row: TriedDesign) -> Path:
        """Return the file with the makespans of a design in further replications."""
        return self.folder / SAMPLES / f"{row.purpose}-{row.design}.npz"

    def best(self, most: int) -> list[TriedDesign]:
        """Return the best designs by the first goal, each once, the best first."""
        done = [r for r in self.journal.searched if r.done and r.same_as is None]
        return sorted(done, key=lambda r: (r.evaluation.goals[0], r.design))[:most]

    def finalists(self) -> Sequence[TriedDesign]:
        """Return the finalists: the best designs; with several goals, the Pareto front."""
        if len(self.section.goals) > 1:
            return pareto_front(self.journal.searched)
        return self.best(self.section.finalists)

    def _by_time(self) -> Iterable[TriedDesign]:
        """Return designs with known plans with and without shortcuts, where time is the only goal."""
        goals = self.section.goals
        if len(goals) > 1 or goals[0].minimise not in _TIMES:
            return []
        rows = self.journal.searched
        return [r for r in rows if r.done and np.isfinite(r.evaluation.turns_s)]

    def longest_turns_s(self) -> float:
        """Return the longest makespan without shortcuts that may still become the best [s].

        Shortcuts may gain more than in any design so far, by as much as the most is above what is usual: of
        few designs the most is little known, and the best one is often where they gain it. Infinite where
        time is not the only goal, and where little is known.
        """
        rows = list(self._by_time())
        if len(rows) < _ENOUGH:
            return float(np.inf)
        times = [(r.evaluation.goals[0], r.evaluation.turns_s) for r in rows]
        left = np.array([full / turns for full, turns in times])
        least = 2.0 * left.min() - np.median(left)
        if least <= 0.0:
            return float(np.inf)
        return float(min(full for full, _ in times) / least)

    def _estimated(self, turns_s: float) -> float:
        """Return an optimistic goal where only a plan without shortcuts is known."""
        gained = [r.evaluation.goals[0] / r.evaluation.turns_s for r in self._by_time()]
        return float(turns_s * np.median(gained))

    def _tell_progress(self, designs: int) -> None:
        self._progress(SEARCHING, len(self.journal.searched), designs)
