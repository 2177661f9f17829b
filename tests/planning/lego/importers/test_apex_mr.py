"""Importing published task files: a small folder of our own, with every feature of the format."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.fuzz.task_files import write_files, write_robots
from planning.errors import ScenarioError
from planning.lego.importers.apex_mr.importer import available_tasks, import_apex_mr
from tests.planning.lego.importers.published_form import published_cell as cell

PLATE = {
    **{"x": 0.4, "y": 0.1, "z": 0.2, "roll": 0, "pitch": 0, "yaw": 0.5},
    **{"width": 32, "height": 48},
}
STEP = {**cell(4, 5, 1, 0), "brick_id": 2, "press_side": 1}
FREE = {**cell(4, 5, 1, 0), "brick_id": 2}
DOWN = {
    **STEP,
    **{"press_offset": 1, "manipulate_type": 0, "attack_dir": -1, "brick_seq": 1},
    **cell(4, 6, 3, 3, "support_"),
}
UP = {
    **{**STEP, "brick_id": 9, "ori": 1, "press_offset": 0, "manipulate_type": 1},
    **cell(4, 5, 0, 1, "press_"),
    **cell(-1, -1, 0, -1, "support_"),
    "brick_seq": "station2.17",
}
LIBRARY = "lego_library.json"
PLATES = "plate_calibration.json"
TASK = "assembly_tasks/shed.json"
STOCK = "env_setup/env_setup_shed.json"
FILES = {
    LIBRARY: {
        "2": {"height": 2, "width": 4, "inventory": 9, "weight": 0.002},
        "7": {"height": 1, "width": 2, "weight": 0.001},
        "9": {"height": 1, "width": 2, "mass": 0.0015},
    },
    PLATES: {"assemble_plate": PLATE, "storage_plate": PLATE},
    STOCK: {
        "b2_1": cell(0, 1, 1, 1),
        "b2_2": {**cell(10, 10, 1, 0), "fixed": True},
        "b7_3": {**cell(20, 0, 1, 0), "fixed": False},
        "b9_station2": cell(30, 0, 1, 0),
    },
    TASK: {"2": UP, "1": DOWN, "3": FREE},
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Write one task, ``shed``, in the published shape."""
    write_files(tmp_path, FILES)
    write_robots(tmp_path)
    return tmp_path


def steps_of(folder: Path, **options: Any) -> list[dict[str, Any]]:
    """Return the steps of the task as they are imported."""
    steps: list[dict[str, Any]] = import_apex_mr(folder, "shed", **options)["assembly"][
        "steps"
    ]
    return steps


def test_robots_stand_on_their_bases_with_their_tools(folder: Path) -> None:
    left, right = import_apex_mr(folder, "shed")["cell"]["robots"]
    assert (left["name"], right["name"]) == ("left", "right")
    assert left["model"] == right["model"] == "gp4"
    np.testing.assert_allclose(left["base"]["xyz_m"], [0, 0, 0.9246])
    np.testing.assert_allclose(right["base"]["xyz_m"], [0.88, 0, 0.9246])
    assert abs(right["base"]["rpy_deg"][2]) == pytest.approx(180.0)
    # Tool frames are in the flange frame, 72 mm from the wrist.
    np.testing.assert_allclose(left["frames"]["tool"]["xyz_m"], [0, 0, 0.108])
    np.testing.assert_allclose(left["frames"]["alt"]["xyz_m"], [-0.02, 0, 0.098])
    every = "alt alt_assemble assemble disassemble handover_assemble tool"
    assert sorted(left["frames"]) == every.split()


def test_plate_and_table(folder: Path) -> None:
    scenario = import_apex_mr(folder, "shed")
    plate = scenario["assembly"]["plate"]
    np.testing.assert_allclose(plate["pose"]["xyz_m"], [0.4, 0.1, 1.1246])
    assert plate["pose"]["rpy_deg"] == pytest.approx([0, 0, np.degrees(0.5)])
    assert plate["studs"] == [32, 48]
    (table,) = scenario["cell"]["fixtures"]
    # Its top is the plate's surface, midway between the robots.
    np.testing.assert_allclose(table["pose"]["xyz_m"], [0.44, 0.0, 1.1146])
    assert table["size_m"] == [0.6985, 1.219, 0.02]


def test_bricks_stock_and_steps_are_plain_and_in_their_order(folder: Path) -> None:
    """Bricks have readable names, with either key of masses; scaffolding and stations are kept."""
    scenario = import_apex_mr(folder, "shed")
    assert json.loads(json.dumps(scenario)) == scenario
    assembly = scenario["assembly"]
    assert assembly["bricks"] == {
        "2x4": {"studs": [2, 4], "mass_kg": 0.002},
        "1x2-7": {"studs": [1, 2], "mass_kg": 0.001},
        "1x2-9": {"studs": [1, 2], "mass_kg": 0.0015},
    }
    assert assembly["stock"] == [
        {"name": "b2_1", "brick": "2x4", "at": [0, 1, 1], "turned": True},
        {"name": "b2_2", "brick": "2x4", "at": [10, 10, 1], "fixed": True},
        {"name": "b7_3", "brick": "1x2-7", "at": [20, 0, 1]},
        {"name": "b9_station2", "brick": "1x2-9", "at": [30, 0, 1], "station": True},
    ]
    assert assembly["steps"] == [
        {
            **{"brick": "2x4", "at": [4, 5, 1], "press": {"side": 1, "offset": 1}},
            **{"support": {"at": [4, 6, 3], "orientation": 3}, "attack": -1},
        },
        {
            **{"brick": "1x2-9", "at": [4, 5, 1], "turned": True, "place": "up"},
            "press": {"side": 1, "offset": 0},
            "press_cell": {"at": [4, 5, 0], "turned": True},
        },
        {"brick": "2x4", "at": [4, 5, 1]},
    ]


def test_prescribed_stock_is_an_option(folder: Path) -> None:
    steps = steps_of(folder, prescribed_stock=True)
    assert [s.get("stock") for s in steps] == ["b2_1", "b9_station2", None]


def test_the_published_choice_wins_over_the_prescription(folder: Path) -> None:
    write_files(folder, {"steps/shed_seq.json": {"1": {**STEP, "press_offset": 2}}})
    (step,) = steps_of(folder, prescribed_stock=True)
    assert step["press"]["offset"] == 2
    assert len(steps_of(folder)) == 3


def test_grips_that_contradict_themselves_are_named_and_either_is_taken(
    folder: Path,
) -> None:
    """A 2x4 at [4, 5, 1]: side 4 and offset 2 are the cell [5, 7, 2], side 3 and 0 [4, 5, 2]."""
    place = cell(5, 7, 2, 0, "press_")
    for given, contact, expected, words in (
        ((4, 2), place, None, None),
        ((1, 0), place, (4, 2), "side 4 and offset 2"),
        ((1, 0), {**place, "press_x": 6}, None, "no place on an edge"),
    ):
        step = {**STEP, "press_side": given[0], "press_offset": given[1]}
        step |= contact
        write_files(folder, {TASK: {"1": step}})
        for source, taken in (("side", given), ("cell", expected or given)):
            notes: list[str] = []
            (found,) = steps_of(folder, press_from=source, note=notes.append)
            assert (found["press"]["side"], found["press"]["offset"]) == taken
            said = [line for line in notes if "press" in line]
            assert len(said) == (words is not None)
            assert all("shed.json: 1" in line and str(words) in line for line in said)


def test_a_contact_cell_alone_is_a_grip(folder: Path) -> None:
    write_files(folder, {TASK: {"1": {**FREE, **cell(4, 8, 2, 1, "press_")}}})
    (found,) = steps_of(folder)
    assert found["press"] == {"side": 2, "offset": 0}


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
        (LIBRARY, ("2", "weight"), None, "2.weight: is missing"),
        (LIBRARY, ("2",), 5, "2: must be an object"),
        (STOCK, ("b9_station2", "fixed"), True, "a feeding station cannot be fixed"),
        (PLATES, ("storage_plate", "x"), "0.7", "is not a number"),
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
        (LIBRARY, "{", "not valid JSON"),
        (LIBRARY, "[]", "must hold an object"),
        (LIBRARY, None, "cannot be read"),
        (TASK, '{"1": {}, "1": {}}', "key '1' is given twice"),
        (TASK, "{}", "steps must be numbered"),
        (STOCK, None, "task 'shed' comes without a stock"),
        ("robot_properties/gp4_tool_alt_DH.txt", None, "'tool_alt' for robot 'r1'"),
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


def test_a_storage_plate_of_its_own_takes_the_stock(folder: Path) -> None:
    assert "storage_plate" not in import_apex_mr(folder, "shed")["assembly"]
    edit(folder / PLATES, ("storage_plate", "x"), 0.7)
    edit(folder / PLATES, ("storage_plate", "z"), 0.15)
    edit(folder / PLATES, ("storage_plate", "width"), 24)
    scenario = import_apex_mr(folder, "shed")
    plate, storage = (scenario["assembly"][k] for k in ("plate", "storage_plate"))
    np.testing.assert_allclose(plate["pose"]["xyz_m"], [0.4, 0.1, 1.1246])
    np.testing.assert_allclose(storage["pose"]["xyz_m"], [0.7, 0.1, 1.0746])
    assert (plate["studs"], storage["studs"]) == ([32, 48], [24, 48])
    # The table carries the lower one.
    assert scenario["cell"]["fixtures"][0]["pose"]["xyz_m"][2] == pytest.approx(1.0646)


def test_what_may_be_missing(folder: Path) -> None:
    """All but where things are, and of which type, has a default."""
    edit(folder / PLATES, ("storage_plate",), None)
    for key in ("roll", "pitch", "width", "height"):
        edit(folder / PLATES, ("assemble_plate", key), None)
    edit(folder / PLATES, ("assemble_plate", "yaw"), None)
    edit(folder / PLATES, ("assemble_plate", "deg"), 30)
    write_files(folder, {TASK: {"1": FREE}})
    assembly = import_apex_mr(folder, "shed")["assembly"]
    assert assembly["plate"]["pose"]["rpy_deg"] == pytest.approx([0, 0, 30])
    assert assembly["plate"]["studs"] == [48, 48]
    assert assembly["steps"] == [{"brick": "2x4", "at": [4, 5, 1]}]
    assert "storage_plate" not in assembly


def test_minus_one_stands_for_nothing(folder: Path) -> None:
    """Supports, grips and contact cells are published as -1 where there is none."""
    none = dict.fromkeys(("press_side", "press_offset", "press_x", "brick_seq"), -1)
    write_files(
        folder, {TASK: {"1": {**STEP, **none, "support_x": -1, "support_ori": -1}}}
    )
    (step,) = steps_of(folder, prescribed_stock=True)
    assert step == {"brick": "2x4", "at": [4, 5, 1]}


def test_prescriptions_older_than_the_stock_are_left_to_the_planner(
    folder: Path,
) -> None:
    """Some published tasks number bricks that are scaffolding now, or one brick twice."""
    numbers = [2, 1, 1, "station2.4", "station2.5"]
    step = {**STEP, "press_offset": 0}
    work = {
        str(k): {**step, "brick_id": 9 if k > 3 else 2, "brick_seq": n}
        for k, n in enumerate(numbers, start=1)
    }
    write_files(folder, {TASK: work})
    heard: list[str] = []
    steps = steps_of(folder, prescribed_stock=True, note=heard.append)
    fed = ["b9_station2"] * 2
    assert [step.get("stock") for step in steps] == [None, "b2_1", None, *fed]
    assert [line.split(": ", 1)[1] for line in heard] == [
        "1.brick_seq: b2_2 is scaffolding",
        "3.brick_seq: b2_1 is taken already",
    ]


def test_unknown_keys_are_tolerated_and_noted(folder: Path) -> None:
    edit(folder / TASK, ("1", "colour"), "red")
    edit(folder / TASK, ("2", "colour"), "blue")
    edit(folder / TASK, ("_comment",), "a shed")
    edit(folder / STOCK, ("b2_1", "friction"), 0.5)
    edit(folder / STOCK, ("author",), "ada")
    edit(folder / LIBRARY, ("2", "price"), 0.1)
    edit(folder / PLATES, ("assemble_plate", "date"), "today")
    heard: list[str] = []
    scenario = import_apex_mr(folder, "shed", note=heard.append)
    assert len(scenario["assembly"]["steps"]) == 3
    assert len(heard) == 6
    for file, key in (
        (TASK, "'colour' is not used, 2 times"),
        *((TASK, "'_comment' is not used"), (STOCK, "'friction' is not used")),
        *((STOCK, "'author' is not used"), (LIBRARY, "'price' is not used")),
        (PLATES, "'date' is not used"),
    ):
        assert any(line.endswith(f"{file}: {key}") for line in heard)


def test_published_keys_are_all_known(folder: Path) -> None:
    choice = {**STEP, "press_offset": 0, "robot_id": 1, "sup_robot_id": 0}
    write_files(folder, {"steps/shed_seq.json": {"1": choice}})
    heard: list[str] = []
    import_apex_mr(folder, "shed", prescribed_stock=True, note=heard.append)
    import_apex_mr(folder, "shed", note=heard.append)
    assert heard == []


def test_an_arm_may_have_tools_of_its_own(folder: Path) -> None:
    properties = folder / "robot_properties"
    own = (properties / "gp4_tool_DH.txt").read_text().replace("-0.18", "-0.2")
    (properties / "r2_tool_DH.txt").write_text(own)
    left, right = import_apex_mr(folder, "shed")["cell"]["robots"]
    np.testing.assert_allclose(left["frames"]["tool"]["xyz_m"], [0, 0, 0.108])
    np.testing.assert_allclose(right["frames"]["tool"]["xyz_m"], [0, 0, 0.128])
    assert left["frames"]["alt"] == right["frames"]["alt"]


def test_twist_angles_come_from_the_configuration(folder: Path) -> None:
    write_files(
        folder, {"user_config.json": {"Twist_Deg": 16, "Handover_Twist_Deg": 18}}
    )
    assert "twist_deg" not in import_apex_mr(folder, "shed")["assembly"]
    write_files(folder, {"user_config.json": {"Twist_Deg": 12, "Use_yk": 0}})
    twist = dict.fromkeys(("pick", "place-down", "place-up"), 12.0)
    found = import_apex_mr(folder, "shed")["assembly"]["twist_deg"]
    assert found == {**twist, "handover": 18.0}


def test_the_repository_is_as_good_as_its_folder(folder: Path, tmp_path: Path) -> None:
    inner = tmp_path / "repository" / "config" / "lego_tasks"
    inner.parent.mkdir(parents=True)
    shutil.copytree(folder, inner, ignore=shutil.ignore_patterns("repository"))
    repository = tmp_path / "repository"
    assert available_tasks(repository) == ("shed",)
    assert import_apex_mr(repository, "shed") == import_apex_mr(folder, "shed")
