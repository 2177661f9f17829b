"""Delays of plans: random durations of motions, and the resulting times.

No code is shared with the engines of the twin. Draws are keyed by the names of tasks, so that two planners
get the same delays for the same tasks.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from planning.errors import TwinError
from twin.judge.open_plan import OpenMotion, OpenPlan
from twin.judge.open_plan_execution import MotionSpan, planned_spans

_STILL = 1e-9
"""A motion whose joints are slower than this at its end comes to rest there [rad/s or m/s]."""

Stretch = Callable[[str, OpenMotion, float], float | None]
"""Returns the stretch factor of a skill's motion at a quantile; None for a motion without a skill.

Arguments: robot or machine, the motion, and the quantile.
"""


class CircularWaitsError(TwinError):
    """Motions of a plan wait for each other.

    Attributes:
        motions: ids of the motions that can never begin.
    """

    def __init__(self, message: str, *, motions: Iterable[str]) -> None:
        self.motions = tuple(motions)
        super().__init__(message)


@dataclass(frozen=True)
class DelayModel:
    """Model of delays; durations are never shorter than planned.

    Attributes:
        slower: largest factor of the duration of a motion without a skill, drawn uniformly from 1 on.
        stalls_per_h: number of standstills of a robot per hour of planned motion.
        stall_s: bounds of their duration, drawn uniformly [s].
    """

    slower: float = 1.1
    stalls_per_h: float = 30.0
    stall_s: tuple[float, float] = (2.0, 10.0)


def delayed_spans(
    plan: OpenPlan, stretch: Stretch, seed: int, model: DelayModel | None = None
) -> dict[str, MotionSpan]:
    """Return the times of a plan's motions under delays, by id.

    In a plan with waits, a motion begins as soon as the previous one and those that it waits for are over.
    In a plan without, it begins at its planned time, or when the previous motion of the robot is over if
    that is later, whatever other robots do.

    Args:
        plan: the plan.
        stretch: how much longer skills take.
        seed: of the draws.
        model: of the delays; by default that of the open benchmark.

    Raises:
        CircularWaitsError: motions wait for each other.
    """
    factors, stalls = _draws(plan, stretch, seed, model or DelayModel())
    if plan.waits:
        return _by_waits(plan, factors, stalls)
    out = {}
    for some in plan.motions.values():
        end = 0.0
        for motion in some:
            begin = max(motion.t_s[0], end) + stalls[motion.id]
            out[motion.id] = MotionSpan(begin, factors[motion.id])
            end = out[motion.id].end(motion)
    return out


def nominal_spans(plan: OpenPlan) -> dict[str, MotionSpan]:
    """Return the earliest times of motions with planned durations.

    Raises:
        CircularWaitsError: motions wait for each other.
    """
    planned = planned_spans(plan)
    if not plan.waits:
        return planned
    return _by_waits(plan, dict.fromkeys(planned, 1.0), dict.fromkeys(planned, 0.0))


def _by_waits(
    plan: OpenPlan, factors: Mapping[str, float], stalls: Mapping[str, float]
) -> dict[str, MotionSpan]:
    runs = [list(_runs(some)) for some in plan.motions.values()]
    over: dict[str, float] = {}
    out: dict[str, MotionSpan] = {}
    at, ends = [0] * len(runs), [0.0] * len(runs)
    moved = True
    while moved:
        moved = False
        for k, own in enumerate(runs):
            while at[k] < len(own):
                run = own[at[k]]
                inside = {motion.id for motion in run}
                needs = {o for motion in run for o in motion.after} - inside
                if not needs <= over.keys():
                    break
                begin = max([ends[k], *(over[other] for other in needs)])
                begin += max(stalls[motion.id] for motion in run)
                # Motions without a stop in between are delayed together.
                factor = max(factors[motion.id] for motion in run)
                for motion in run:
                    out[motion.id] = MotionSpan(begin, factor)
                    begin = over[motion.id] = out[motion.id].end(motion)
                ends[k], at[k], moved = begin, at[k] + 1, True
    stuck = [own[n][0] for own, n in zip(runs, at, strict=True) if n < len(own)]
    if stuck:
        waits = "; ".join(
            f"{motion.id} waits for {', '.join(o for o in motion.after if o not in over) or 'what is joined to it'}"
            for motion in stuck
        )
        raise CircularWaitsError(
            f"no motion can begin: {waits}", motions=[motion.id for motion in stuck]
        )
    return out


def _runs(some: Sequence[OpenMotion]) -> Iterator[list[OpenMotion]]:
    """Yield the motions of a robot, grouped where it does not stop in between."""
    run: list[OpenMotion] = []
    for motion in some:
        run.append(motion)
        if motion.v is None or np.max(np.abs(motion.v[-1])) <= _STILL:
            yield run
            run = []
    if run:
        yield run


def _draws(
    plan: OpenPlan, stretch: Stretch, seed: int, model: DelayModel
) -> tuple[dict[str, float], dict[str, float]]:
    """Return the stretch factor of each motion, and the standstill before it [s]."""
    factors: dict[str, float] = {}
    stalls: dict[str, float] = {}
    for name, some in plan.motions.items():
        seen: Counter[str] = Counter()
        work: dict[str, float] = {}
        clock, due = 0.0, _stalls(seed, name, model)
        pending = next(due)
        for motion in some:
            key = motion.task or motion.id
            if key not in work:
                what = f"{motion.skill or 'move'} {motion.object or name}"
                seen[what] += 1
                draw = _uniform(seed, what, seen[what])
                own = stretch(name, motion, draw)
                if own is None:
                    own = 1.0 + (model.slower - 1.0) * draw
                work[key] = max(1.0, own)
            factors[motion.id] = work[key]
            clock += motion.t_s[-1] - motion.t_s[0]
            stalls[motion.id] = 0.0
            while pending[0] <= clock:
                stalls[motion.id] += pending[1]
                pending = next(due)
    return factors, stalls


def _stalls(seed: int, name: str, model: DelayModel) -> Iterator[tuple[float, float]]:
    """Yield the stalls of a robot: time of planned motion before each, and its duration [s]."""
    at, low, high, number = 0.0, *model.stall_s, 0
    while True:
        number += 1
        if model.stalls_per_h <= 0.0:
            yield np.inf, 0.0
            continue
        gap = -np.log1p(-_uniform(seed, f"stall after {name}", number))
        at += float(gap) * 3600.0 / model.stalls_per_h
        yield at, low + (high - low) * _uniform(seed, f"stall of {name}", number)


def _uniform(seed: int, what: str, number: int) -> float:
    """Return a uniform draw in (0, 1) keyed by a name."""
    text = f"{seed}\n{what}\n{number}".encode()
    word = int.from_bytes(hashlib.sha256(text).digest()[:8], "big") >> 11
    return (word + 0.5) / 2.0**53
