"""Shipped scenarios executed with another graph, as the tables of the run tell it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.motion_times import within_limits
from scheduling.shortcuts.corners import round_corners
from twin.audit.motion.executed import Recording, read_recording
from twin.engine.engine import Simulator
from twin.recorders.observers import write_motion
from twin.scenario.sections.scenario import Scenario
from twin.trial.simulation import scenario_execution
from twin.uncertainty.disturbances import Disturbances, Stalls

NO_STALLS = Stalls()
MANY_STALLS = Stalls(count_per_robot=5, duration_s=(0.1, 2.0))


def recorded(
    folder: Path, scenario: Scenario, tpg: TemporalPlanGraph, stalls: Stalls
) -> Recording:
    """Execute a graph as a scenario says, but for disturbances; read what is written of it."""
    model = replace(
        scenario_execution(scenario), disturbances=Disturbances(stalls=stalls)
    )
    run = Simulator(tpg, model).run(seed=3)
    assert run.outcome == "completed"
    write_motion(folder, tpg, run)
    return read_recording(folder, tpg.cell)


def with_rounded_corners(tpg: TemporalPlanGraph) -> TemporalPlanGraph:
    """Return a graph whose robots pass corners of transits at speed, some at least."""
    found = within_limits(round_corners(tpg))
    assert any(chain.corners is not None for chain in found.chains)
    return found
