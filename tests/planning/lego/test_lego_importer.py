"""Importing published task files: a small folder of our own, with every feature of the format."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planning.errors import ScenarioError
from planning.lego.importer import available_tasks, import_apex_mr
from planning.lego.skill_targets import FRAMES

DH_ROWS = (
    "0 0 0 -1.57079632679",
    "-1.57079632679 0 0.26 3.1415926",
    "0 0 0.015 -1.57079632679",
    "0 -0.29 0 1.57079632679",
    "0 0 0 -1.57079632679",
)
TOOLS = {
    "": (-0.072, 0.0),
    "_tool": (-0.18, 0.0),
    "_tool_assemble": (-0.18, 0.008),
    "_tool_disassemble": (-0.19, 0.0),
    "_tool_handover_assemble": (-0.181, 0.008),
    "_tool_alt": (-0.17, -0.02),
    "_tool_alt_assemble": (-0.17, -0.01),
}
SHOULDER = "1 0 0 0\n0 1 0 0\n0 0 1 {z}\n0 0 0 1\n"
PLATE = {
    "x": 0.4,
    "y": 0.1,
    "z": 0.2,
    "roll": 0,
    "pitch": 0,
    "yaw": 0.5,
    "width": 32,
    "height": 48,
}
STEP = {"x": 4, "y": 5, "z": 1, "ori": 0, "brick_id": 2, "press_side": 1}


def write(path: Path, content: Any) -> None:
    """Write JSON, making the folders above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Write one task, ``shed``, in the published shape."""
    write(
        tmp_path / "lego_library.json",
        {
            "2": {"height": 2, "width": 4, "inventory": 9, "weight": 0.002},
            "7": {"height": 1, "width": 2, "weight": 0.001},
            "9": {"height": 1, "width": 2, "mass": 0.0015},
        },
    )
    write(
        tmp_path / "plate_calibration.json",
        {"assemble_plate": PLATE, "storage_plate": PLATE},
    )
    write(
        tmp_path / "env_setup/env_setup_shed.json",
        {
            "b2_1": {"x": 0, "y": 1, "z": 1, "ori": 1},
            "b2_2": {"x": 10, "y": 10, "z": 1, "ori": 0, "fixed": True},
            "b7_3": {"x": 20, "y": 0, "z": 1, "ori": 0, "fixed": False},
            "b9_station2": {"x": 30, "y": 0, "z": 1, "ori": 0},
        },
    )
    down = {
        **STEP,
        "press_offset": 1,
        "manipulate_type": 0,
        "attack_dir": -1,
        "support_x": 4,
        "support_y": 6,
        "support_z": 3,
        "support_ori": 3,
        "brick_seq": 1,
    }
    up = {
        **STEP,
        "brick_id": 9,
        "ori": 1,
        "press_offset": 0,
        "manipulate_type": 1,
        "press_x": 4,
        "press_y": 5,
        "press_z": 0,
        "press_ori": 1,
        "support_x": -1,
        "support_y": -1,
        "support_z": 0,
        "support_ori": -1,
        "brick_seq": "station2.17",
    }
    free = {k: v for k, v in STEP.items() if k != "press_side"}
    write(tmp_path / "assembly_tasks/shed.json", {"2": up, "1": down, "3": free})
    properties = tmp_path / "robot_properties"
    properties.mkdir()
    for name, (d, a) in TOOLS.items():
        rows = [*DH_ROWS, f"0 {d} {a} 3.1415926"]
        (properties / f"gp4{name}_DH.txt").write_text("\n".join(rows))
    (properties / "world_base.txt").write_text(SHOULDER.format(z=0.9))
    (properties / "gp4_base.txt").write_text(SHOULDER.format(z=0.33))
    (properties / "r1_base.txt").write_text(SHOULDER.format(z=0.33))
    (properties / "r2_base.txt").write_text(
        "-1 0 0 0.9\n0 -1 0 0.02\n0 0 1 0.33\n0 0 0 1\n"
    )
    return tmp_path


def test_robots_stand_on_their_bases_with_their_tools(folder: Path) -> None:
    left, right = import_apex_mr(folder, "shed")["cell"]["robots"]
    assert (left["name"], right["name"]) == ("left", "right")
    assert left["model"] == right["model"] == "gp4"
    np.testing.assert_allclose(left["base"]["xyz_m"], [0, 0, 0.9])
    np.testing.assert_allclose(right["base"]["xyz_m"], [0.9, 0.02, 0.9])
    assert abs(right["base"]["rpy_deg"][2]) == pytest.approx(180.0)
    # Tool frames are in the flange frame, 72 mm from the wrist.
    np.testing.assert_allclose(left["frames"]["tool"]["xyz_m"], [0, 0, 0.108])
    np.testing.assert_allclose(left["frames"]["alt"]["xyz_m"], [-0.02, 0, 0.098])
    assert sorted(left["frames"]) == sorted(FRAMES)


def test_plate_and_table(folder: Path) -> None:
    scenario = import_apex_mr(folder, "shed")
    plate = scenario["assembly"]["plate"]
    np.testing.assert_allclose(plate["pose"]["xyz_m"], [0.4, 0.1, 1.1])
    assert plate["pose"]["rpy_deg"] == pytest.approx([0, 0, np.degrees(0.5)])
    assert plate["studs"] == [32, 48]
    (table,) = scenario["cell"]["fixtures"]
    # Its top is the plate's surface, midway between the robots.
    np.testing.assert_allclose(table["pose"]["xyz_m"], [0.45, 0.0, 1.09])
    assert table["size_m"] == [0.6985, 1.219, 0.02]


def test_bricks_get_readable_names_and_both_mass_keys(folder: Path) -> None:
    assert import_apex_mr(folder, "shed")["assembly"]["bricks"] == {
        "2x4": {"studs": [2, 4], "mass_kg": 0.002},
        "1x2-7": {"studs": [1, 2], "mass_kg": 0.001},
        "1x2-9": {"studs": [1, 2], "mass_kg": 0.0015},
    }


def test_stock_keeps_scaffolding_and_stations(folder: Path) -> None:
    assert import_apex_mr(folder, "shed")["assembly"]["stock"] == [
        {"name": "b2_1", "brick": "2x4", "at": [0, 1, 1], "turned": True},
        {"name": "b2_2", "brick": "2x4", "at": [10, 10, 1], "fixed": True},
        {"name": "b7_3", "brick": "1x2-7", "at": [20, 0, 1]},
        {"name": "b9_station2", "brick": "1x2-9", "at": [30, 0, 1], "station": True},
    ]


def test_steps_come_in_their_order(folder: Path) -> None:
    down, up, free = import_apex_mr(folder, "shed")["assembly"]["steps"]
    assert down == {
        "brick": "2x4",
        "at": [4, 5, 1],
        "press": {"side": 1, "offset": 1},
        "support": {"at": [4, 6, 3], "orientation": 3},
        "attack": -1,
    }
    assert up == {
        "brick": "1x2-9",
        "at": [4, 5, 1],
        "turned": True,
        "place": "up",
        "press": {"side": 1, "offset": 0},
        "press_cell": {"at": [4, 5, 0], "turned": True},
    }
    assert free == {"brick": "2x4", "at": [4, 5, 1]}


def test_prescribed_stock_is_an_option(folder: Path) -> None:
    down, up, free = import_apex_mr(folder, "shed", prescribed_stock=True)["assembly"][
        "steps"
    ]
    assert down["stock"] == "b2_1"
    assert up["stock"] == "b9_station2"
    assert "stock" not in free


def test_the_published_choice_wins_over_the_prescription(folder: Path) -> None:
    write(folder / "steps/shed_seq.json", {"1": {**STEP, "press_offset": 2}})
    (step,) = import_apex_mr(folder, "shed", prescribed_stock=True)["assembly"]["steps"]
    assert step["press"]["offset"] == 2
    assert len(import_apex_mr(folder, "shed")["assembly"]["steps"]) == 3


def test_the_result_is_plain_and_survives_json(folder: Path) -> None:
    scenario = import_apex_mr(folder, "shed")
    assert json.loads(json.dumps(scenario)) == scenario


def test_an_unknown_task_lists_those_there_are(folder: Path) -> None:
    assert available_tasks(folder) == ("shed",)
    with pytest.raises(ScenarioError, match="no published task 'barn'") as caught:
        import_apex_mr(folder, "barn")
    assert caught.value.choices == ("shed",)


def edit(path: Path, keys: tuple[str, ...], value: Any) -> None:
    """Set, or with ``value`` None remove, one value in a JSON file."""
    content = json.loads(path.read_text())
    inner = content
    for key in keys[:-1]:
        inner = inner[key]
    if value is None:
        del inner[keys[-1]]
    else:
        inner[keys[-1]] = value
    path.write_text(json.dumps(content))


TASK = "assembly_tasks/shed.json"
STOCK = "env_setup/env_setup_shed.json"


@pytest.mark.parametrize(
    ("file", "keys", "value", "message"),
    [
        (TASK, ("1", "x"), None, "1.x: is missing"),
        (TASK, ("1", "x"), 1.5, "1.x: 1.5 is not a whole number"),
        (TASK, ("1", "x"), "4", "1.x: '4' is not a number"),
        (TASK, ("1", "ori"), 90, "1.ori: 90 is not valid"),
        (TASK, ("1", "manipulate_type"), 2, "1.manipulate_type: 2 is not valid"),
        (TASK, ("1", "press_side"), 0, "1.press_side: 0 is not valid"),
        (TASK, ("1", "attack_dir"), 0, "1.attack_dir: 0 is not valid"),
        (TASK, ("1", "support_ori"), 4, "1.support_ori: 4 is not valid"),
        (TASK, ("1", "brick_id"), 77, "the library has no brick 77"),
        (TASK, ("2",), None, "steps must be numbered 1 to 2"),
        (STOCK, ("b2_1", "z"), None, "b2_1.z: is missing"),
        (STOCK, ("brick",), {}, "'brick' does not name a brick"),
        (STOCK, ("b5_1",), {"x": 0, "y": 0, "z": 1, "ori": 0}, "no brick 5"),
        ("lego_library.json", ("2", "weight"), None, "2.weight: is missing"),
        ("lego_library.json", ("2",), 5, "2: must be an object"),
        ("plate_calibration.json", ("storage_plate", "x"), 0.7, "two plates"),
    ],
)
def test_mistakes_are_named_by_file_and_key(
    folder: Path, file: str, keys: tuple[str, ...], value: Any, message: str
) -> None:
    edit(folder / file, keys, value)
    with pytest.raises(ScenarioError) as caught:
        import_apex_mr(folder, "shed")
    assert file in caught.value.message
    assert message in str(caught.value)


def test_a_prescribed_brick_must_be_in_the_stock(folder: Path) -> None:
    edit(folder / TASK, ("1", "brick_seq"), 8)
    with pytest.raises(ScenarioError, match=r"1\.brick_seq.*'b2_8'") as caught:
        import_apex_mr(folder, "shed", prescribed_stock=True)
    assert caught.value.choices == ("b2_1", "b2_2")


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("lego_library.json", "{", "not valid JSON"),
        ("lego_library.json", "[]", "must hold an object"),
        ("lego_library.json", None, "cannot be read"),
        ("robot_properties/r2_base.txt", None, "cannot be read"),
        ("robot_properties/r2_base.txt", "1 0 0 0", "must have 4 rows of 4"),
        ("robot_properties/r2_base.txt", "1 0\nx", "r2_base.txt"),
        ("robot_properties/r2_base.txt", "2 0 0 0\n" * 4, "not a rigid transform"),
        ("robot_properties/gp4_DH.txt", "0 0 0 0\n" * 6, "another arm"),
        ("robot_properties/gp4_tool_DH.txt", "0 0 0 0\n" * 6, "more than the tool"),
    ],
)
def test_broken_files_are_named(
    folder: Path, file: str, text: str | None, message: str
) -> None:
    path = folder / file
    if text is None:
        path.unlink()
    else:
        path.write_text(text)
    with pytest.raises(ScenarioError) as caught:
        import_apex_mr(folder, "shed")
    assert Path(file).name in caught.value.message
    assert message in caught.value.message
