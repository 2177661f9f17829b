"""Descriptions of a torso with two arms of boxes, and cells of both arms."""

from pathlib import Path

from planning.cell.workcell import Workcell
from twin.planning.build_workcell import build_workcell
from twin.reading.scenario_file import load_scenario

ARMS = ("left", "right")

CELL = """version: 1
name: two-arms
cell:
  robots:
    - {{name: left, model: body.urdf, flange: left_tool0{left}}}
    - {{name: right, model: body.urdf, flange: right_tool0{right}}}
assembly:
  kind: goals
  moves:
    - {{robot: left, to_rad_or_m: [0.2, 0.5, -0.5]}}
    - {{robot: right, to_rad_or_m: [-0.2, -0.5, 0.5]}}
"""


def link(name: str, size: str, height: float, *, looks: bool = False) -> str:
    shape = f'<origin xyz="0 0 {height}"/><geometry><box size="{size}"/></geometry>'
    drawn = f"<visual>{shape}</visual>" if looks else ""
    return f'<link name="{name}"><collision>{shape}</collision>{drawn}</link>'


def joint(
    name: str, parent: str, child: str, xyz: str, axis: str = "", *, rpy: str = "0 0 0"
) -> str:
    kind = "fixed" if not axis else "prismatic" if name == "waist" else "revolute"
    moves = f'<axis xyz="{axis}"/><limit lower="-2" upper="2" effort="9" velocity="2"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/>{moves if axis else ""}</joint>'
    )


def torso(
    *,
    shoulder: float = 0.2,
    roll: float = 2.9,
    length: float = 0.25,
    looks: bool = False,
    head: str = "chest",
) -> str:
    """Return a pedestal, a chest on a waist, a head on a neck, and two arms of three joints.

    Args:
        shoulder: how far the arms begin from the middle [m].
        roll: how far they are turned outwards at zero, from upright [rad].
        length: of each of their links [m].
        looks: give all links visual shapes.
        head: link that the head is on.
    """
    parts = [
        link("pedestal", "0.2 0.2 0.4", 0.2, looks=looks),
        link("chest", "0.2 0.3 0.3", 0.15, looks=looks),
        link("head", "0.12 0.12 0.12", 0.06, looks=looks),
        joint("waist", "pedestal", "chest", "0 0 0.45", "0 0 1"),
        joint("neck", head, "head", "0 0 0.33", "0 0 1"),
    ]
    for side, sign in zip(ARMS, (1, -1), strict=True):
        above = "chest"
        for k, axis in enumerate(("0 0 1", "1 0 0", "0 1 0"), 1):
            name = f"{side}{k}"
            at = f"0 0 {length}" if k > 1 else f"0 {sign * shoulder} 0.25"
            turned = f"{-sign * roll} 0 0" if k == 1 else "0 0 0"
            size = f"0.06 0.06 {length - 0.02}"
            parts.append(link(name, size, 0.5 * length, looks=looks))
            parts.append(joint(f"{side}_{k}", above, name, at, axis, rpy=turned))
            above = name
        parts.append(f'<link name="{side}_tool0"/>')
        parts.append(joint(f"{side}_t", above, f"{side}_tool0", f"0 0 {length}"))
    return f'<robot name="body">{"".join(parts)}</robot>'


def written_cell(
    folder: Path,
    description: str | None = None,
    *,
    left: str = ", joints: {waist: 0.1}",
    right: str = ", joints: {waist: 0.1}",
) -> Path:
    """Return the file of a cell of both arms, written beside their description."""
    (folder / "body.urdf").write_text(description or torso())
    file = folder / "cell.yaml"
    file.write_text(CELL.format(left=left, right=right))
    return file


def built_cell(file: Path) -> Workcell:
    return build_workcell(load_scenario(file), file.parent)
