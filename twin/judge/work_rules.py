"""Rules of a task for whoever plans it: how fast robots are, how long skills take, who waits for whom."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import groupby
from pathlib import Path

import numpy as np

from planning.cell.workcell import Workcell
from twin.audit.violation import Violation
from twin.durations.model import DurationModel
from twin.judge.foreign_execution import MotionSpan
from twin.judge.open_plan import OpenMotion, OpenPlan
from twin.scenario.sections.scenario import Scenario
from twin.trial.simulation import skill_durations

_ROUNDING = 1e-6
"""Share of a limit by which it may be exceeded."""

_SKILL_OF = {"take": "pick", "put": "place-down", "give": "handover"}
"""What work is called that has no name, by what changes hands in it."""


class WorkRules:
    """How fast and for how long robots work by a scenario.

    Args:
        scenario: says so.
        folder: where relative paths in it start.
        cell: of it.
    """

    def __init__(self, scenario: Scenario, folder: Path, cell: Workcell) -> None:
        self._durations = skill_durations(scenario, folder)
        self._kinds = {item.name: item.kind for item in cell.objects}
        self._sum = None
        if scenario.speed_model == "l1":
            self._sum = scenario.planning.l1_rad_s

    def stretch(self, name: str, motion: OpenMotion, u: float) -> float | None:
        """Return how many times as long as planned work takes at a quantile; None for a plain move."""
        model = self._model(name, motion)
        if model is None or model.mean <= 0.0:
            return None
        return float(model.ppf(np.array([u]))[0] / model.mean)

    def violations(
        self, plan: OpenPlan, spans: Mapping[str, MotionSpan]
    ) -> Iterator[Violation]:
        """Yield motions that are too fast, work that is too short, and who does not wait.

        Args:
            plan: what is executed.
            spans: when, by motion.
        """
        ends = {
            motion.id: spans[motion.id].end(motion) for _, _, motion in plan.placed()
        }
        for _, name, motion in plan.placed():
            begin = spans[motion.id].begin
            for other in motion.after:
                if begin < ends[other] - _ROUNDING:
                    words = f"{motion.id} begins before {other} is over, {ends[other] - begin:.6g} s later"
                    yield Violation(
                        begin, ends[other], name, other, 0.0, words, "edge-order"
                    )
            if name in plan.robots and self._sum is not None and not motion.skill:
                yield from self._too_fast(name, motion, spans[motion.id], self._sum)
        for name, some in plan.motions.items():
            for _, group in groupby(some, lambda motion: motion.task or motion.id):
                yield from self._too_short(name, list(group), spans)

    def _model(self, name: str, motion: OpenMotion) -> DurationModel | None:
        """Return how long work takes, None where nothing says so."""
        kind = self._kinds.get(motion.object or "")
        for skill in (motion.skill, *(_SKILL_OF.get(e.verb) for e in motion.events)):
            found = skill and self._durations.model_of(skill, name, kind)
            if found:
                return found
        return None

    def _too_fast(
        self, name: str, motion: OpenMotion, span: MotionSpan, limit: float
    ) -> Iterator[Violation]:
        if motion.v is not None or len(motion.t_s) < 2:
            return
        seconds = np.diff(motion.t_s) * span.factor
        way = np.abs(np.diff(np.array(motion.q), axis=0)).sum(axis=1)
        over = way - limit * (seconds * (1.0 + _ROUNDING) + 1e-8)
        worst = int(np.argmax(over))
        if over[worst] > 0.0:
            t = (
                span.at(motion, motion.t_s[worst]),
                span.at(motion, motion.t_s[worst + 1]),
            )
            speed = way[worst] / max(seconds[worst], 1e-9)
            words = f"{speed:.6g} rad/s for all joint speeds added up, their limit is {limit:g} rad/s, in {motion.id}"
            yield Violation(*t, name, "all joints", 0.0, words, "joint-speed")

    def _too_short(
        self, name: str, group: list[OpenMotion], spans: Mapping[str, MotionSpan]
    ) -> Iterator[Violation]:
        model = next(filter(None, (self._model(name, m) for m in group)), None)
        if model is None:
            return
        took = sum((m.t_s[-1] - m.t_s[0]) * spans[m.id].factor for m in group)
        if took < model.mean * (1.0 - _ROUNDING) - 1e-6:
            begin, end = spans[group[0].id].begin, spans[group[-1].id].end(group[-1])
            skill = group[0].skill or "work"
            words = f"{group[0].id}: {skill} takes {took:.6g} s, and the task says {model.mean:.6g} s"
            yield Violation(begin, end, name, skill, 0.0, words, "duration")
