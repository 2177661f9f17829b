"""What is written is read back as it was, or it is refused when it is written: no own plan is ever damaged."""

import dataclasses
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.bounds import FARTHEST_COMPOSED, LATEST_S, LONGEST_S
from planning.errors import OutputError
from scheduling.build_tpg import build_tpg
from scheduling.graph.plan_files import load_plan, plan_sha256, save_plan
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.scheduling.mini_world import random_plan

PLAN = build_tpg(random_plan(3, 7))
MODELS = {robot.model.name: robot.model for robot in PLAN.cell.robots}

magnitudes = st.floats(-3, 13).map(lambda power: 10.0**power) | st.sampled_from(
    [0.0, LONGEST_S, LATEST_S, np.nextafter(LATEST_S, np.inf), np.nan, np.inf, -1.0]
)


def _with_durations(tpg: TemporalPlanGraph, most_s: float) -> TemporalPlanGraph:
    """Return a plan whose nodes take up to so long, one after the other."""
    chains = []
    for chain in tpg.chains:
        duration = np.full(len(chain), most_s)
        start = np.concatenate([[0.0], np.cumsum(duration)[:-1]])
        chains.append(
            dataclasses.replace(chain, duration=duration, planned_start=start)
        )
    return dataclasses.replace(tpg, chains=tuple(chains))


def _with_places(tpg: TemporalPlanGraph, far_m: float) -> TemporalPlanGraph:
    """Return a plan whose objects begin so far away."""
    items = []
    for item in tpg.cell.objects:
        pose = item.start.copy()
        pose[0, 3] = far_m
        items.append(dataclasses.replace(item, start=pose))
    return dataclasses.replace(
        tpg, cell=dataclasses.replace(tpg.cell, objects=tuple(items))
    )


def _with_masses(tpg: TemporalPlanGraph, mass_kg: float) -> TemporalPlanGraph:
    items = [dataclasses.replace(i, mass=mass_kg) for i in tpg.cell.objects]
    cell = dataclasses.replace(tpg.cell, objects=tuple(items))
    return dataclasses.replace(tpg, cell=cell)


def _with_home(tpg: TemporalPlanGraph, value: float) -> TemporalPlanGraph:
    robots = [
        dataclasses.replace(r, home=np.full_like(r.home, value))
        for r in tpg.cell.robots
    ]
    cell = dataclasses.replace(tpg.cell, robots=tuple(robots))
    return dataclasses.replace(tpg, cell=cell)


CHANGES = (_with_durations, _with_places, _with_masses, _with_home)


@given(change=st.sampled_from(CHANGES), size=magnitudes)
@settings(max_examples=60)
def test_a_plan_is_read_back_or_is_not_written(change: Any, size: float) -> None:
    tpg = change(PLAN, size)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        refused = ""
        try:
            save_plan(tpg, folder)
        except OutputError as error:
            refused = str(error)
        if refused:
            assert refused.startswith("this plan cannot be kept: ")
            assert not (folder / "plan.json").exists()
        else:
            assert plan_sha256(load_plan(folder, MODELS)) == plan_sha256(tpg)


@pytest.mark.parametrize(
    ("change", "most"),
    [
        (_with_durations, LONGEST_S),
        (_with_places, FARTHEST_COMPOSED),
        (_with_masses, 1e14),
    ],
)
def test_what_scenarios_may_say_is_kept(
    change: Any, most: float, tmp_path: Path
) -> None:
    save_plan(change(PLAN, most), tmp_path)
    load_plan(tmp_path, MODELS)
