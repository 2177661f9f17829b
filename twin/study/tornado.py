"""Which inputs the makespan hangs on: one at a time, a little less and a little more of each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from planning.transforms import Array
from twin.durations.composed import Scaled
from twin.statistics import paired_difference
from twin.study.experiment import Block
from twin.study.replication_rows import COMPLETED
from twin.study.workload import Engines, Workload

SHARE = 0.2
"""Every input is made this much smaller and larger."""

REPLICATIONS = 200
"""Of each input and direction, with the same draws as the first ones of the study."""


@dataclass(frozen=True)
class Influence:
    """What an input does to the mean makespan.

    Attributes:
        name: of the input, in words.
        less_s: change of the mean makespan when the input is smaller [s].
        more_s: the same when it is larger [s].
    """

    name: str
    less_s: float
    more_s: float

    @property
    def span_s(self) -> float:
        """Length of the bar in the chart [s]."""
        return abs(self.more_s - self.less_s)


def influences(
    load: Workload,
    *,
    share: float = SHARE,
    replications: int = REPLICATIONS,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Influence]:
    """Return what the inputs do to the mean makespan, the strongest first.

    Inputs are the durations of each skill, the durations of each robot's other motions, and the
    rates and probabilities of disturbances that are there.

    Args:
        load: the work of one cell.
        share: how much smaller and larger.
        replications: of every input and direction, all with the same draws.
        progress: called with inputs done and in all.
    """
    block = Block(0, 0, replications if not load.reasons else min(replications, 30))
    base = _makespans(load, block)
    inputs = _inputs(load)
    found = []
    for k, (name, changed) in enumerate(inputs):
        less, more = (
            _difference(_makespans(changed(factor), block), base)
            for factor in (1 - share, 1 + share)
        )
        found.append(Influence(name, less, more))
        progress(k + 1, len(inputs))
    return sorted(found, key=lambda one: -one.span_s)


def _inputs(load: Workload) -> Sequence[tuple[str, Callable[[float], Workload]]]:
    kinds = {load.tpg.tasks[int(m)].kind for c in load.tpg.chains for m in set(c.task)}
    found: list[tuple[str, Callable[[float], Workload]]] = []
    for skill in load.durations.models:
        if skill in kinds:
            found.append((f"duration of {skill}", _scaled_skill(load, skill)))
    for chain in load.tpg.chains:
        name = f"motions of {chain.robot}"
        found.append((name, _slowed_robot(load, chain.robot)))
    wrong = load.disturbances
    if wrong.stall_rate is not None and wrong.stall_rate.rate_per_h > 0:
        found.append(("rate of stalls", _stalled(load)))
    return found


def _scaled_skill(load: Workload, skill: str) -> Callable[[float], Workload]:
    def changed(factor: float) -> Workload:
        own = load.durations
        models = {
            name: Scaled(model, factor) if name == skill else model
            for name, model in own.models.items()
        }
        overrides = tuple(
            replace(item, model=Scaled(item.model, factor))
            if item.skill == skill
            else item
            for item in own.overrides
        )
        return replace(load, durations=replace(own, models=models, overrides=overrides))

    return changed


def _slowed_robot(load: Workload, robot: str) -> Callable[[float], Workload]:
    def changed(factor: float) -> Workload:
        chains = tuple(
            replace(
                chain,
                duration=np.where(chain.skill, 1.0, factor) * chain.duration,
            )
            if chain.robot == robot
            else chain
            for chain in load.tpg.chains
        )
        return replace(load, tpg=replace(load.tpg, chains=chains))

    return changed


def _stalled(load: Workload) -> Callable[[float], Workload]:
    def changed(factor: float) -> Workload:
        rate = load.disturbances.stall_rate
        assert rate is not None
        more = replace(rate, rate_per_h=rate.rate_per_h * factor)
        return replace(load, disturbances=replace(load.disturbances, stall_rate=more))

    return changed


def _makespans(load: Workload, block: Block) -> Array:
    rows = Engines(load).compute(block).rows
    done = rows.outcome == COMPLETED
    return np.where(done, rows.makespan_ns * 1e-9, np.nan)


def _difference(values: Array, base: Array) -> float:
    both = np.isfinite(values) & np.isfinite(base)
    if not np.any(both):
        return 0.0
    return paired_difference(values[both], base[both]).estimate
