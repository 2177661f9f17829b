"""Slips of units and rates, robots that can do nothing, and files beside the scenario: absurd cells and sane ones."""

import warnings
from pathlib import Path

import pytest
import trimesh

from planning.meshes.convex_pieces import cut_convex
from planning.meshes.mesh_file import MeshTriangles
from tests.twin.checks.test_usual import LINE, instead
from tests.twin.scenarios.test_hairs_breadth import CELL
from tests.twin.written import Change, checked, written

ROOT = Path(__file__).parents[3]
WEST = "{name: west, model: ur5e, tool: jaws, base: {xyz_m: [-0.55, 0, 0]}, home_deg: [0, -100, 110, -100, -90, 0]"
OWN = "{name: west, model: own.urdf, tool: jaws, base: {xyz_m: [-0.55, 0, 0]}"
PICK = "pick: {kind: fixed, value_s: 2}"
FILE = "pick: {kind: empirical, csv: times.csv, column: took}"

PAIRS: dict[str, tuple[str, tuple[str, str, str], tuple[Change, ...]]] = {
    "joints in radians": ("in radians", instead("[0, -100, 110, -100, -90, 0], limits: {payload_kg: 5}}\n    - {name: east", "[0, -1.75, 1.92, -1.75, -1.571, 0], limits: {payload_kg: 5}}\n    - {name: east", "[0, -98.4, 111.5, -99.25, -90, 1.1], limits: {payload_kg: 5}}\n    - {name: east"), ()),
    "a base in radians": ("in radians", instead("rpy_deg: [0, 0, 180]}, home", "rpy_deg: [0, 0, -3.142]}, home", "rpy_deg: [0, 0, 176.9]}, home"), ()),
    "a goal in radians": ("in radians", instead("goal: {xyz_m: [0, -0.1, 0.04]}", "goal: {xyz_m: [0, -0.1, 0.04], rpy_deg: [0, 0, 0.7854]}", "goal: {xyz_m: [0, -0.1, 0.04], rpy_deg: [0, 0, 0.8]}"), ()),
    "products due faster than a conveyor brings parts": ("source blocks takes 140 s", instead("every_s: 30,", "every_s: 140,", "every_s: 110,"), LINE),
    "a normal distribution that is cut in half": ("its mean is", instead(PICK, "pick: {kind: normal, mean_s: 3, sd_s: 40}", "pick: {kind: normal, mean_s: 3, sd_s: 1}"), ()),
}  # fmt: skip
"""By what is absurd: what is told of it, what stands in the bench, the absurd and the sane, and what else is changed."""


def told(folder: Path, text: str, *changes: Change) -> list[str]:
    return [item.message for item in checked(written(folder, text, *changes)).findings]


@pytest.mark.parametrize("what", PAIRS)
def test_slips_are_told_and_their_neighbours_are_not(what: str, tmp_path: Path) -> None:
    says, (old, absurd, sane), besides = PAIRS[what]
    found = told(tmp_path, CELL, *besides, (old, absurd))
    assert any(says in message for message in found), found
    assert told(tmp_path, CELL, *besides, (old, sane)) == []


@pytest.mark.parametrize(
    ("values", "says"),
    [("2.1,2.4,1.9", ""), ("2100,2400,1900", "what is usual"), ("0,0,0.004", "usual")],
)
def test_measured_times_are_read_beside_the_scenario(
    values: str, says: str, tmp_path: Path
) -> None:
    (tmp_path / "times.csv").write_text("took\n" + values.replace(",", "\n") + "\n")
    found = told(tmp_path, CELL, (PICK, FILE))
    assert any(says in message for message in found) if says else found == []


def test_a_finding_at_a_robot_is_shown_at_its_line(tmp_path: Path) -> None:
    file = written(tmp_path, CELL, ("limits: {payload_kg: 5}", "limits: {payload_kg: 5, jerk: 1e6}"))  # fmt: skip
    report = checked(file)
    lines = [k for k, row in enumerate(CELL.splitlines(), 1) if "limits" in row]
    assert sorted({report.problem(f).mark.line for f in report.findings}) == lines


def arm(
    shape: str = '<cylinder radius="0.05" length="0.14"/>',
    limit: str = 'lower="-2.9" upper="2.9" effort="150" velocity="2"',
    rpy: str = "0 0 0",
    mass: str = "2",
) -> str:
    """Return the description of an arm of six joints."""
    inertia = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
    body = (
        f'<collision><origin xyz="0 0 0.07"/><geometry>{shape}</geometry></collision>'
    )
    rows = ['<robot name="own"><link name="l0"/>']
    chain = zip((0.15, 0.15, 0.35, 0.35, 0.15, 0.12), "zyyzyz", strict=True)
    for k, (length, axis) in enumerate(chain):
        along = {"z": "0 0 1", "y": "0 1 0"}[axis]
        turn = rpy if k == 3 else "0 0 0"
        rows.append(
            f'<link name="l{k + 1}"><inertial><mass value="{mass}"/>{inertia}</inertial>{body if shape else ""}</link>'
            f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/><limit {limit}/>'
            f'<origin xyz="0 0 {length}" rpy="{turn}"/><axis xyz="{along}"/></joint>'
        )
    tip = '<joint name="t" type="fixed"><parent link="l6"/><child link="tool0"/><origin xyz="0 0 0.1"/></joint>'
    return "".join([*rows, '<link name="tool0"/>', tip, "</robot>"])


DESCRIPTIONS = {
    "in degrees?": arm(limit='lower="-170" upper="170" effort="9" velocity="2"'),
    "degrees per second?": arm(limit='lower="-2" upper="2" effort="9" velocity="180"'),
    "rpy 90 rad": arm(rpy="0 0 90"),
    "which no body has": arm(mass="-2"),
    "has a collision shape": arm(shape=""),
    "is the scale of its meshes right?": arm(shape='<box size="0.0001 0.0001 0.0002"/>'),
    "": arm(limit='lower="-6.3" upper="6.3" effort="9" velocity="9"', rpy="0 0 1.571"),
}  # fmt: skip


@pytest.mark.parametrize("says", DESCRIPTIONS)
def test_descriptions_in_wrong_units_are_told(says: str, tmp_path: Path) -> None:
    (tmp_path / "own.urdf").write_text(DESCRIPTIONS[says])
    found = told(tmp_path, CELL, (WEST, f"{OWN}, home_deg: [0, 30, 60, 0, 90, 0]"))
    assert any(says in message for message in found) if says else found == []


FAR = [
    ("lego/stairs", ("[0.88, 0, 0.9246]", "[3.1, 0, 0.9246]"), "right will get no task"),
    ("lego/stairs", ("[0.44, 0, 1.1045]", "[0.44, 0, 1.1345]"), "goes where table stands"),
    ("lego/stairs", ("[0.44, 0, 1.1045]", "[0.44, 0, 1.1044]"), ""),
    ("construction/relay", ("middle", "centre"), ""),
]  # fmt: skip


@pytest.mark.parametrize(("name", "change", "says"), FAR)
def test_robots_and_fixtures_that_are_out_of_place_are_named(
    name: str, change: Change, says: str, tmp_path: Path
) -> None:
    found = told(tmp_path, (ROOT / f"scenarios/{name}.yaml").read_text(), change)
    assert any(says in message for message in found) if says else found == []


def test_faces_that_alternate_raise_no_warning_of_numpy() -> None:
    """Their signed volumes cancel, and a centre of mass is divided by that."""
    for mesh in (
        trimesh.creation.box((0.1, 0.1, 0.1)),
        trimesh.creation.cylinder(0.05, 0.1, sections=12),
    ):
        faces = mesh.faces.copy()
        faces[::2] = faces[::2, ::-1]
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            cut = cut_convex(MeshTriangles(mesh.vertices, faces), 0.02)
        assert cut.volume == pytest.approx(mesh.volume, rel=0.03)
        assert cut.centre == pytest.approx(mesh.center_mass, abs=1e-6)
