"""Inputs of a plan that can be made smaller and larger."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from twin.study.replications.workload import Workload


@dataclass(frozen=True)
class Input:
    """An input of a plan that varies, or that might be different.

    Attributes:
        name: in words.
        times: returns the work with this input multiplied by a factor.
    """

    name: str
    times: Callable[[Workload, float], Workload]


def inputs_of(load: Workload) -> Sequence[Input]:
    """Return the inputs of a plan.

    They are the durations of each skill in it, the durations of each robot's other motions, and
    the rate of stalls where there is one.
    """
    kinds = {load.tpg.tasks[int(m)].kind for c in load.tpg.chains for m in set(c.task)}
    found = [
        Input(f"duration of {skill}", partial(_with_skill, skill=skill))
        for skill in load.execution.durations.models
        if skill in kinds
    ]
    found += [
        Input(f"motions of {chain.robot}", partial(_with_motions, robot=chain.robot))
        for chain in load.tpg.chains
    ]
    if load.execution.disturbances.stalls.rate_per_h > 0:
        found.append(Input("rate of stalls", _with_stalls))
    return found


def _with_skill(load: Workload, factor: float, *, skill: str) -> Workload:
    own = load.execution.durations
    models = {
        name: model.scaled(factor) if name == skill else model
        for name, model in own.models.items()
    }
    overrides = tuple(
        item.model_copy(update={"duration": item.duration.scaled(factor)})
        if item.skill == skill
        else item
        for item in own.overrides
    )
    durations = replace(own, models=models, overrides=overrides)
    return replace(load, execution=replace(load.execution, durations=durations))


def _with_motions(load: Workload, factor: float, *, robot: str) -> Workload:
    chains = tuple(
        replace(chain, duration=np.where(chain.skill, 1.0, factor) * chain.duration)
        if chain.robot == robot
        else chain
        for chain in load.tpg.chains
    )
    return replace(load, tpg=replace(load.tpg, chains=chains))


def _with_stalls(load: Workload, factor: float) -> Workload:
    own = load.execution.disturbances
    stalls = own.stalls.model_copy(
        update={"rate_per_h": own.stalls.rate_per_h * factor}
    )
    disturbances = own.model_copy(update={"stalls": stalls})
    return replace(load, execution=replace(load.execution, disturbances=disturbances))
