"""Task files in the published form: shipped scenarios written and read back, and random ones that are valid."""

import json
import tempfile
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.fuzz.task_files import write_files, write_robots
from planning.cell.workcell import Workcell
from planning.lego.bricks.assembly import LegoAssembly, LegoStep, Press
from planning.lego.bricks.brick_grips import press_cell
from planning.lego.bricks.brick_world import press_from_number
from planning.lego.importers.apex_mr.importer import import_apex_mr
from planning.lego.skills.candidates import find_candidates
from planning.tasks.assignment import StepChoice
from planning.tasks.highs_solver import assign_steps
from tests.assembly_section import assembly_section
from tests.planning.lego.importers.published_form import published_cell as cell
from tests.planning.lego.importers.published_form import (
    published_cell as cell_as_published,
)
from tests.planning.lego.importers.published_form import write_published
from tests.twin.program import invoke
from twin.document.yaml_text import scenario_text
from twin.kinds.lego.kind import build_lego, find_sequence, sequencing_rules
from twin.kinds.lego.section import LegoSection
from twin.planning.build_workcell import build_workcell
from twin.reading.scenario_file import load_scenario

SCENARIOS = Path(__file__).parents[4] / "scenarios" / "lego"
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
        presses=(press_from_number(choice.grasp),),
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
    done = invoke(
        "import", "apex-mr", tmp_path, "--task", name, "-o", file, *more, code=0
    )
    assert "every step can be done" in done.stdout
    assert "note: " not in done.stderr
    scenario = load_scenario(file)
    section = scenario.assembly
    assert isinstance(section, LegoSection)
    found = build_lego(section)
    for read, wanted in zip(found.steps, assembly.steps, strict=True):
        assert read.brick.studs == wanted.brick.studs
        assert (read.cell, read.up) == (wanted.cell, wanted.up)
        assert read.presses == wanted.presses[:1]
        assert read.supports == wanted.supports[:1]
        assert read.attack == wanted.attack
        assert (read.stock is None) == terse
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
    invoke(*task, "-o", file, code=0)
    robots = load_scenario(file).cell.robots
    assert {robot.tool for robot in robots} == {tool}
    invoke("run", file, "--out", tmp_path / "run", code=0)
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
        done = invoke(*task, option, value, code=2)
        assert valid in done.stderr


GIVES_WAY, BEARS = Press(2, 0), Press(1, 0)
"""Grips of step 8 of the cliff."""


@pytest.mark.parametrize(
    ("side", "cell", "options", "taken", "off"),
    [
        pytest.param(BEARS, BEARS, (), BEARS, False, marks=pytest.mark.nightly),
        pytest.param(BEARS, GIVES_WAY, (), BEARS, False, marks=pytest.mark.nightly),
        (GIVES_WAY, BEARS, (), BEARS, False),
        pytest.param(
            GIVES_WAY,
            BEARS,
            ("--press-from", "side"),
            GIVES_WAY,
            True,
            marks=pytest.mark.nightly,
        ),
        pytest.param(
            BEARS,
            GIVES_WAY,
            ("--press-from", "cell"),
            GIVES_WAY,
            True,
            marks=pytest.mark.nightly,
        ),
        (GIVES_WAY, GIVES_WAY, (), GIVES_WAY, True),
    ],
)
def test_the_reading_of_grips_that_bears_every_press_is_taken(
    tmp_path: Path,
    side: Press,
    cell: Press,
    options: tuple[str, ...],
    taken: Press,
    off: bool,
) -> None:
    """Where none does, the output, the file and the summaries of its runs say so."""
    workcell, assembly = shipped("cliff")
    write_published(tmp_path, "cliff", workcell, assembly)
    task = tmp_path / "assembly_tasks" / "cliff.json"
    steps = json.loads(task.read_text())
    contact = press_cell(assembly.steps[7], cell, up=False)
    steps["8"] |= {"press_side": side.side, "press_offset": side.offset}
    own = cell_as_published(
        contact.x, contact.y, contact.z, int(contact.turned), "press_"
    )
    steps["8"] |= own
    task.write_text(json.dumps(steps))
    file = tmp_path / "cliff.yaml"
    tool = ("--tool", "dual-arm")
    task_of = ("import", "apex-mr", tmp_path, "--task", "cliff", *tool, "-o", file)
    done = invoke(*task_of, *options, code=0)
    scenario = load_scenario(file)
    lego = build_lego(assembly_section(scenario, LegoSection))
    assert lego.steps[7].presses == (taken,)
    said = "it bears 0.0 N"
    comments = "".join(k for k in file.read_text().splitlines() if k.startswith("#"))
    assert (said in comments) == off
    assert (said in done.stderr) == (off or taken != side)
    keys = [own["key"] for own in scenario.checks_off]
    assert keys == (["assembly.rules.check_steps"] if off else [])


@pytest.mark.parametrize(
    ("longer_mm", "words"),
    [
        pytest.param(-9.0, "shorter", marks=pytest.mark.nightly),
        (-4.5, "shorter"),
        pytest.param(-1.0, None, marks=pytest.mark.nightly),
        (1.0, None),
        (5.0, "longer"),
        pytest.param(11.0, "longer", marks=pytest.mark.nightly),
    ],
)
def test_frames_of_another_tool_are_refused(
    tmp_path: Path, longer_mm: float, words: str | None
) -> None:
    write_published(tmp_path, "cliff", *shipped("cliff"))
    for table in (tmp_path / "robot_properties").glob("*tool*DH.txt"):
        rows = np.loadtxt(table)
        rows[-1, 1] -= 1e-3 * longer_mm
        np.savetxt(table, rows)
    file = tmp_path / "cliff.yaml"
    task = ("import", "apex-mr", tmp_path, "--task", "cliff", "--tool", "dual-arm")
    done = invoke(*task, "-o", file, code=0 if words is None else 2)
    assert file.exists() == (words is None)
    if words is not None:
        assert f"those of a {words} tool" in done.stderr
        assert str(tmp_path) in done.stderr.replace("\n", "")


SIZES = {"2": (2, 4), "5": (1, 4), "7": (1, 4), "9": (1, 2), "10": (1, 1), "20": (2, 6)}


@st.composite
def libraries(draw: st.DrawFn) -> dict[str, Any]:
    """Draw brick types in any order, with either mass key, with or without an inventory."""
    out = {}
    for key in draw(st.permutations(sorted(SIZES))):
        height, width = SIZES[key]
        mass = draw(st.sampled_from(["weight", "mass"]))
        out[key] = {"height": height, "width": width, mass: 0.001 * height * width}
        if draw(st.booleans()):
            out[key]["inventory"] = 9
    return out


@st.composite
def steps(draw: st.DrawFn, number: int) -> tuple[dict[str, Any], bool]:
    """Draw one step of a tower, with any part of what it may say; and whether it is fed."""
    kind = draw(st.sampled_from(sorted(SIZES)))
    height, width = SIZES[kind]
    out: dict[str, Any] = {**cell(44, 20, number, 0), "brick_id": int(kind)}
    if draw(st.booleans()):
        side = draw(st.integers(1, 4))
        along = width if side in (1, 4) else height
        out["press_side"] = side
        out["press_offset"] = draw(st.integers(0, max(0, along - 2)))
    if draw(st.booleans()):
        out |= {"manipulate_type": 0, **cell(44, 20, number + 1, 0, "press_")}
    if draw(st.booleans()):
        out["attack_dir"] = draw(st.sampled_from([1, -1]))
    if draw(st.booleans()):
        out |= cell(-1, -1, 0, -1, "support_")
    elif number > 2 and draw(st.booleans()):
        out |= cell(47, 20, number - 2, draw(st.integers(0, 3)), "support_")
    if draw(st.booleans()):
        out["remark"] = "of no use"
    return out, draw(st.booleans())


@st.composite
def tasks(draw: st.DrawFn) -> dict[str, Any]:
    """Draw the content of all files of a task."""
    count = draw(st.integers(1, 6))
    work: dict[str, Any] = {}
    stock: dict[str, Any] = {}
    prescribe = draw(st.booleans())
    for number in range(1, count + 1):
        step, fed = draw(steps(number))
        kind = step["brick_id"]
        name = "station1" if fed else str(number)
        # Every stock brick has a place of its own: a column for each type.
        column = 8 * sorted(SIZES).index(str(kind))
        row = 40 if fed else 6 * (number - 1)
        place = cell(column, row, 1, draw(st.integers(0, 1)))
        stock.setdefault(f"b{kind}_{name}", place)
        if prescribe:
            step["brick_seq"] = f"station1.{number}" if fed else number
        work[str(number)] = step
    if draw(st.booleans()):
        stock["b2_99"] = {**cell(44, 2, 1, 0), "fixed": True}
    plate = {"x": 0.4, "y": 0.0, "z": 0.19, "yaw": draw(st.floats(-0.1, 0.1))}
    plates = {"assemble_plate": plate}
    if draw(st.booleans()):
        plates["storage_plate"] = {**plate, "y": draw(st.sampled_from([0.0, 0.5]))}
    return {
        "lego_library.json": draw(libraries()),
        "plate_calibration.json": plates,
        "env_setup/env_setup_tall.json": stock,
        "assembly_tasks/tall.json": dict(draw(st.permutations(list(work.items())))),
    }


@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(files=tasks(), prescribed=st.booleans())
def test_any_task_in_the_published_shape_is_a_valid_scenario(
    files: dict[str, Any], prescribed: bool
) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_files(folder, files)
        write_robots(folder)
        notes: list[str] = []
        content = import_apex_mr(
            folder, "tall", prescribed_stock=prescribed, note=notes.append
        )
        path = folder / "tall.yaml"
        path.write_text(scenario_text(content, "Imported."))
        assembly = load_scenario(path).assembly
    assert isinstance(assembly, LegoSection)
    work = files["assembly_tasks/tall.json"]
    stock = files["env_setup/env_setup_tall.json"]
    assert len(assembly.steps) == len(work)
    assert [s.name for s in assembly.stock] == list(stock)
    for number, step in enumerate(assembly.steps, start=1):
        given_step = work[str(number)]
        assert step.at == (44, 20, number)
        assert assembly.bricks[step.brick].studs == SIZES[str(given_step["brick_id"])]
        assert step.press is not None or "press_side" not in given_step
        if not {"press_side", "press_x"} & given_step.keys():
            assert step.press is None
        assert (step.support is None) == (given_step.get("support_x", -1) == -1)
        assert step.attack == given_step.get("attack_dir", 1)
        if prescribed and "brick_seq" in given_step:
            source = str(given_step["brick_seq"]).split(".")[0]
            assert step.stock == f"b{given_step['brick_id']}_{source}"
        else:
            assert step.stock is None
    for item in assembly.stock:
        assert item.station == ("station" in item.name)
        assert item.fixed == bool(stock[item.name].get("fixed"))
    moved = files["plate_calibration.json"].get("storage_plate", {}).get("y") == 0.5
    assert (assembly.storage_plate is not None) == moved
    # Drawn grips and their contact cells may contradict each other, which is noted too.
    others = [line for line in notes if "press_x" not in line]
    assert bool(others) == any("remark" in step for step in work.values())
