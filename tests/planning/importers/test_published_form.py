"""Scenarios of each kind that come with the program, written as published task files and read back."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from planning.cell.workcell import Workcell
from planning.lego.bricks.assembly import LegoAssembly, LegoStep
from planning.lego.bricks.brick_world import press_of
from planning.lego.skills.candidates import find_candidates
from planning.tasks.assignment import StepChoice
from planning.tasks.highs_solver import assign_steps
from tests.planning.importers.published_form import write_published
from tests.twin.program import invoke
from twin.planning.build_workcell import build_workcell
from twin.planning.lego import build_lego, find_sequence, sequencing_rules
from twin.scenario.manifest import load_scenario
from twin.scenario.sections.lego import LegoSection

SCENARIOS = Path(__file__).parents[3] / "scenarios" / "lego"
QUICK = ("cliff",)
LARGE = ("faucet", "chair", "fish")
"""With stations that never run out; with scaffolding, supports and many places from below."""


@cache
def shipped(name: str) -> tuple[Workcell, LegoAssembly]:
    """Cell and assembly of a scenario, each step with the grip, support and brick of its plan."""
    path = SCENARIOS / f"{name}.yaml"
    scenario = load_scenario(path)
    section = scenario.assembly
    assert isinstance(section, LegoSection)
    assembly = build_lego(section)
    if section.structure is not None:
        assembly = find_sequence(
            section, sequencing_rules(section, robots=2), robots=2
        )[0]
    cell = build_workcell(scenario, path.parent)
    plan = assign_steps(find_candidates(cell, assembly).problem)
    steps = tuple(
        _settled(step, plan[k]) for k, step in enumerate(assembly.steps, start=1)
    )
    return cell, replace(assembly, steps=steps)


def _settled(step: LegoStep, choice: StepChoice) -> LegoStep:
    by = choice.support
    return replace(
        step,
        presses=(press_of(choice.grasp),),
        supports=() if by is None else (step.supports[by.pose],),
        stock=choice.object,
    )


@pytest.mark.parametrize(
    ("name", "terse"),
    [
        *((name, False) for name in QUICK),
        ("cliff", True),
        *(pytest.param(n, False, marks=pytest.mark.nightly) for n in LARGE),
    ],
)
def test_published_files_are_read_as_they_were_meant(
    tmp_path: Path, name: str, terse: bool
) -> None:
    """Oracle: the assembly that was written, its steps, stock, plates and arms."""
    cell, assembly = shipped(name)
    names = write_published(tmp_path, name, cell, assembly, terse=terse)
    file = tmp_path / f"{name}.yaml"
    more = () if terse else ("--prescribed-stock",)
    done = invoke("import", "apex-mr", tmp_path, "--task", name, "-o", file, *more)
    assert done.exit_code == 0, done.stderr
    assert "every step can be done" in done.stdout
    assert "note: " not in done.stderr
    scenario = load_scenario(file)
    section = scenario.assembly
    assert isinstance(section, LegoSection)
    found = build_lego(section)
    for given, wanted in zip(found.steps, assembly.steps, strict=True):
        assert given.brick.studs == wanted.brick.studs
        assert (given.cell, given.up) == (wanted.cell, wanted.up)
        assert given.presses == wanted.presses[:1]
        assert given.supports == wanted.supports[:1]
        assert given.attack == wanted.attack
        assert (given.stock is None) == terse
    stock = {item.name: item for item in found.stock}
    for item in assembly.stock:
        there = stock[names[item.name]]
        assert (there.cell, there.fixed, there.station) == (
            item.cell,
            item.fixed,
            item.station,
        )
    built = build_workcell(scenario, tmp_path)
    for one, two in zip(built.robots, cell.robots, strict=True):
        np.testing.assert_allclose(one.base, two.base, atol=1e-9)
        for frame, pose in two.model.frames.items():
            np.testing.assert_allclose(one.model.frames[frame], pose, atol=1e-9)
    np.testing.assert_allclose(found.plate.pose, assembly.plate.pose, atol=1e-9)


@pytest.mark.parametrize(
    "tool",
    [
        pytest.param("dual-arm", marks=pytest.mark.nightly),
        pytest.param("slim", marks=pytest.mark.nightly),
    ],
)
def test_a_published_task_is_built_with_either_tool(tmp_path: Path, tool: str) -> None:
    write_published(tmp_path, "cliff", *shipped("cliff"))
    file = tmp_path / "cliff.yaml"
    task = ("import", "apex-mr", tmp_path, "--task", "cliff", "--tool", tool)
    done = invoke(*task, "-o", file)
    assert done.exit_code == 0, done.stderr
    robots = load_scenario(file).cell.robots
    assert {robot.tool for robot in robots} == {tool}
    done = invoke("run", file, "--out", tmp_path / "run")
    assert done.exit_code == 0, done.stderr
    audit = json.loads((tmp_path / "run" / "summary.json").read_text())["audit"]
    assert audit["violations"] == []
    assert audit["contact_tolerance_m"] == 0.0002
    assert audit["deepest_graze_m"] <= 0.0002


def test_what_is_asked_of_the_importer_must_be_there(tmp_path: Path) -> None:
    cell, assembly = shipped("cliff")
    write_published(tmp_path, "cliff", cell, assembly)
    task = ("import", "apex-mr", tmp_path, "--task", "cliff", "-o", tmp_path / "c.yaml")
    for option, value, valid in (
        ("--tool", "thin", "dual-arm, slim"),
        ("--press-from", "y", "side, cell"),
    ):
        done = invoke(*task, option, value)
        assert done.exit_code == 2
        assert valid in done.stderr
