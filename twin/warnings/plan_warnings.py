"""Warnings about a plan before its execution: stalls, time windows, joint efforts and speeds that are not feasible."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.windows import least_gaps, window_gaps
from scheduling.slowed_motions import describe_overloaded_joints
from twin.durations.nanoseconds import NANOSECONDS
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel
from twin.engine.model_holds import with_model_holds
from twin.runs.execution_record import DeadlockError, ExecutionRecord
from twin.runs.windows import broken_words
from twin.scenario.sections.scenario import Scenario
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.simulation import scenario_execution
from twin.uncertainty.skill_durations import SkillDurations
from twin.warnings.unreached_speeds import unreached_speeds


def plan_warnings(case: LoadedScenario, tpg: TemporalPlanGraph) -> tuple[str, ...]:
    """Return warnings about a plan under the disturbances of its scenario."""
    sections = case.sections
    disturbances = sections.execution.disturbances(case.robots, case.folder)
    return (
        *stall_warnings(sections, tpg),
        *nominal_window_warnings(sections, tpg, case.folder),
        *describe_overloaded_joints(tpg),
        *unreached_speeds(tpg, disturbances, sections.seed),
    )


def stall_warnings(scenario: Scenario, tpg: TemporalPlanGraph) -> tuple[str, ...]:
    """Return warnings about requested stalls that cannot all happen.

    A robot or machine stalls at most once a node, so that more stalls than nodes are not executed.
    """
    found = []
    for chain in tpg.chains:
        own, who = scenario.execution.stalls, "robot"
        if tpg.cell.is_machine(chain.robot):
            own, who = scenario.execution.of_machine(chain.robot).stalls, "machine"
        if own.count_per_robot > len(chain):
            found.append(
                f"stalls.count_per_robot is {own.count_per_robot}, but {who} {chain.robot!r} has"
                f" {len(chain)} nodes and stalls once at each of them"
            )
    return tuple(found)


def nominal_window_warnings(
    scenario: Scenario, tpg: TemporalPlanGraph, base: Path
) -> tuple[str, ...]:
    """Return warnings about time windows that a plan exceeds at nominal times."""
    if not any(window.most is not None for window in tpg.windows):
        return ()
    model = scenario_execution(scenario, base)
    held = with_model_holds(tpg, model)
    nominal = ExecutionModel(SkillDurations({}), model.policy, model.messages)
    try:
        run = Simulator(held, nominal).run(seed=scenario.seed)
    except DeadlockError:
        return ()
    return tuple(_window_warnings(tpg, run, held=held is not tpg))


def _window_warnings(
    tpg: TemporalPlanGraph, nominal: ExecutionRecord, *, held: bool
) -> Iterator[str]:
    """Yield a warning for each window that a plan exceeds at nominal times.

    Args:
        tpg: the plan.
        nominal: the plan executed with nominal times.
        held: whether window-opening tasks were held back.
    """
    start, end = np.concatenate(nominal.start_ns), np.concatenate(nominal.end_ns)
    gaps = window_gaps(tpg, start, end)
    least = least_gaps(tpg, (end - start)[:, None])[:, 0]
    for window, gap, at_least in zip(tpg.windows, gaps, least, strict=True):
        if not (broken := broken_words(window, int(gap))):
            continue
        assert window.most is not None
        over = int(at_least) / NANOSECONDS - window.most
        if over > 0.0:
            can = f"; what lies between takes {over:.3f} s too long, whenever it is opened"
        elif held:
            can = ", although what opens it is held back"
        else:
            can = "; hold back what opens it: execution.windows: {hold: 0.95}"
        yield f"at nominal times, {broken}{can}"
