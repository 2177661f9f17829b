"""Random task folders in the published shape import, and are valid scenarios."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.fuzz.task_files import write_files, write_robots
from planning.importers.apex_mr.importer import import_apex_mr
from tests.planning.importers.published_form import published_cell as cell
from twin.scenario.document.yaml_text import scenario_text
from twin.scenario.manifest import load_scenario
from twin.scenario.sections.lego import LegoSection

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
