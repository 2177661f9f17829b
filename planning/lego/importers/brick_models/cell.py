"""Workcell for a brick model: two arms that face each other across a plate, and feeding stations."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from planning.cell.shape import box_shape
from planning.cell.workcell import Clearances, Fixture, PlacedRobot, Workcell
from planning.errors import ScenarioError
from planning.handling.skill_targets import skill_postures
from planning.handling.skill_trial import ResolvedSkill
from planning.lego.bricks.assembly import (
    BRICK_LEVELS,
    LAYER_HEIGHT,
    STUD_PITCH,
    BrickType,
    Cell,
    GridSpan,
    LegoAssembly,
    LegoStep,
    OnGrid,
    Plate,
    StockBrick,
)
from planning.lego.bricks.brick_grips import legal_presses
from planning.lego.bricks.brick_types import BRICKS, brick_of_size
from planning.lego.bricks.brick_world import (
    BrickWorld,
    brick_colour,
    grasp_number,
    plate_fixture,
    stock_objects,
)
from planning.lego.bricks.grid import plate_corner, top_pose
from planning.lego.importers.brick_models.model import BrickModel, ModelBrick
from planning.lego.skills.brick_contacts import lever_reaches_below
from planning.lego.skills.brick_skills import BrickSkills
from planning.lego.skills.targets import DEFAULT_TWIST, BrickGrip, pick_targets
from planning.robots.registry import robot_model
from planning.steps.skill import SkillPath
from planning.transforms import Transform, from_rpy, translation

APART = 2
"""Distance between two stations [studs]."""

AWAY = 3
"""Distance between a station and the structure [studs]."""

STUDS = 48
"""Size of the plate along x and y [studs]."""

_WIDER = (56, 64)
"""Studs along x of the plates for models that would stand in the way of picks at their stations."""

_GRID = np.array([STUD_PITCH, STUD_PITCH, LAYER_HEIGHT / BRICK_LEVELS])
_GAP, _THINNEST = 0.001, 0.0002
"""Difference of an obstacle's size to that of its part, for bricks to come down beside it, and its least size [m]."""

_MODEL = "gp4"
_BASE_Z = 0.9246
_PLATE = (0.44, 0.0, 1.1145)
_TABLE = {
    "name": "table",
    "size_m": [0.6, 1.2, 0.02],
    "pose": {"xyz_m": [0.44, 0, 1.1045]},
}
_ROBOTS = (("left", 0.0, 0.0), ("right", 0.88, 180.0))
"""Name, x of the base [m], and yaw [deg]."""

_MOST_WIDE = STUDS - 2 * (APART + 2 + AWAY)


@dataclass(frozen=True)
class Station(OnGrid):
    """A feeding station.

    Attributes:
        brick: the type it feeds.
        cell: where its bricks come up.
        stand: type of the fixed brick below it, None where it is on the plate.
    """

    brick: BrickType
    cell: Cell
    stand: str | None


def find_stations(
    robot: PlacedRobot,
    plate: Plate,
    structure: GridSpan,
    kinds: Sequence[BrickType],
    *,
    far: bool,
    stays_free: Callable[[Station], bool] = lambda _: True,
) -> list[Station]:
    """Return a station for each type on a robot's side of the plate.

    Columns fill from the edge of the plate, each from its middle to its ends, the largest types
    first. A plate's station stands on a brick: beside it the tool needs the room below. Nothing comes near the structure.

    Args:
        robot, plate, structure, kinds: for which they are.
        far: on the side of the plate's greatest x, turned by half a turn against the other side.
        stays_free: tells whether what is built leaves room to pick there.

    Raises:
        ScenarioError: there is no room within reach for one of them.
    """
    out: list[Station] = []
    for kind in sorted(kinds, key=lambda k: (-k.height, -k.studs[0] * k.studs[1])):
        for station in _places(plate, structure, kind, far=far):
            room = station.span.widened(APART)
            if any(room.shares_studs(other.span) for other in out):
                continue
            if _reaches(robot, plate, station) and stays_free(station):
                out.append(station)
                break
        else:
            side, (wide, deep) = "right" if far else "left", structure.size
            raise ScenarioError(
                f"no room for a feeding station of {kind.name} within reach of the {side} robot: "
                f"the structure of {wide} x {deep} studs and {len(out)} stations take it;"
                " give a cell of your own (--cell)"
            )
    return out


def _places(
    plate: Plate, structure: GridSpan, kind: BrickType, *, far: bool
) -> Iterator[Station]:
    """Yield the candidate positions of a station in the order in which they are tried."""
    wide, deep = plate.studs
    nx, ny = kind.studs
    middle = (deep - ny) // 2
    room = (wide - structure.x1 if far else structure.x0) - AWAY - nx
    rows = sorted(range(APART, deep - ny - APART + 1), key=lambda y: abs(y - middle))
    raised = lever_reaches_below(kind)
    stand = brick_of_size(kind.studs, BRICK_LEVELS).name if raised else None
    z = 2 if raised else 1
    for x in range(APART, room + 1):
        for y in rows:
            at = (wide - x - nx, deep - y - ny) if far else (x, y)
            yield Station(kind, Cell(*at, z), stand)


def _reaches(robot: PlacedRobot, plate: Plate, station: Station) -> bool:
    """Tell whether a robot reaches a station with every grip."""
    top, frames = top_pose(plate, station), robot.model.frames
    for press in legal_presses(station.brick):
        grip = BrickGrip(frames, station.brick, top, press)
        paths = skill_postures(robot, pick_targets(grip))
        if not any(isinstance(found, SkillPath) for found in paths):
            return False
    return True


@dataclass(frozen=True)
class Finished:
    """Picks of a cell's robots at stations next to the finished model, with what stands among its bricks."""

    robots: tuple[PlacedRobot, ...]
    plate: Plate
    structure: Sequence[LegoStep]
    obstacles: Sequence[Fixture] = ()

    def stays_free(self, robot: str, station: Station) -> bool:
        """Tell whether a robot can pick at a station with every grip next to the finished model."""
        stock = (StockBrick("station", station.brick, station.cell, station=True),)
        steps = tuple(self.structure)
        assembly = LegoAssembly(self.plate, stock, steps, dict(DEFAULT_TWIST))
        fixtures = plate_fixture(self.plate), *self.obstacles
        cell = Workcell(self.robots, fixtures, stock_objects(assembly), Clearances())
        skills = BrickSkills(BrickWorld(cell, assembly))
        for press in legal_presses(station.brick):
            found = skills.pick(robot, "station", grasp_number(press))
            if not isinstance(found, ResolvedSkill) or skills.latest(found) is not None:
                return False
        return True


def model_cell(model: BrickModel) -> dict[str, Any]:
    """Return the scenario content that builds a model in the middle of a cell chosen for it.

    Raises:
        ScenarioError: it is too large, or there is no room for the feeding stations.
    """
    wide, deep, _ = model.size
    if not _fits(model):
        words = f"{_MOST_WIDE} x {STUDS} fit between the feeding stations of the plate"
        raise ScenarioError(f"the model covers {wide} x {deep} studs; {words}")
    arm, robots = robot_model(_MODEL), list[PlacedRobot]()
    for name, x, yaw in _ROBOTS:
        pose = from_rpy([x, 0.0, _BASE_Z], (0.0, 0.0, np.radians(yaw)))
        robots.append(PlacedRobot(name, arm, pose, arm.home))
    plain = _content(model, tuple(robots), STUDS, free=False)
    for studs in (STUDS, *_WIDER):
        with suppress(ScenarioError):
            return _content(model, tuple(robots), studs, free=True)
    # Where no plate is wide enough, the stations stand as close to the model as possible.
    return plain


def _content(
    model: BrickModel, robots: tuple[PlacedRobot, ...], studs: int, *, free: bool
) -> dict[str, Any]:
    """Return the content of a scenario with a plate of a given width.

    Raises:
        ScenarioError: there is no room for the feeding stations; or, where picks are to stay free
            beside the finished model, they would not.
    """
    wide, deep, _ = model.size
    corner = (studs - wide) // 2, (STUDS - deep) // 2
    plate = Plate(translation(*_PLATE), (studs, STUDS))
    span = GridSpan(corner[0], corner[0] + wide, corner[1], corner[1] + deep, 0, 1)
    placed = [LegoStep(i.brick, _moved(i.cell, corner)) for i in model.bricks]
    boxes = obstacle_fixtures(model, corner, plate)
    standing = []
    for item in boxes:
        shape = box_shape(item["name"], np.array(item["size_m"]))
        at = translation(*item["pose"]["xyz_m"])
        standing.append(Fixture(item["name"], shape, at))
    finished = Finished(robots, plate, placed, standing)
    stock, listed = list[dict[str, Any]](), []
    for robot, (name, x, yaw) in zip(robots, _ROBOTS, strict=True):
        base = {"xyz_m": [x, 0.0, _BASE_Z], "rpy_deg": [0, 0, yaw]}
        listed.append({"name": name, "model": _MODEL, "base": base})
        stays_free = partial(finished.stays_free, name) if free else lambda _: True
        place = partial(find_stations, robot, plate, span, list(model.kinds))
        for station in place(far=x > 0.0, stays_free=stays_free):
            stock += _stock(name, station)
    return {
        "cell": {"robots": listed, "fixtures": [_TABLE, *boxes]},
        "assembly": {
            "kind": "lego",
            "plate": {"pose": {"xyz_m": list(_PLATE)}, "studs": [studs, STUDS]},
            "structure": structure_content(model, corner),
            **own_types(model),
            "stock": stock,
        },
    }


def model_orientations(model: BrickModel) -> list[BrickModel]:
    """Return a model as read, and turned by a quarter turn with a note of why, where they fit.

    Where neither fits between the stations, it is the model as it is.
    """
    why = "reach of the arms" if _fits(model) else "room between the feeding stations"
    note = f"the model is turned by a quarter turn, for {why}"
    turned = replace(model.quarter_turned(), notes=(*model.notes, note))
    return [item for item in (model, turned) if _fits(item)] or [model]


def _fits(model: BrickModel) -> bool:
    wide, deep, _ = model.size
    return wide <= _MOST_WIDE and deep <= STUDS


def structure_content(model: BrickModel, corner: tuple[int, int]) -> dict[str, Any]:
    """Return a model as the structure of a scenario, its least corner at a stud of the plate."""
    bricks = []
    for item in model.bricks:
        at = _moved(item.cell, corner).entry
        bricks.append({"brick": item.brick.name, **at, **_colour(item)})
    return {"bricks": bricks}


def _moved(cell: Cell, corner: tuple[int, int]) -> Cell:
    return replace(cell, x=cell.x + corner[0], y=cell.y + corner[1])


def own_types(model: BrickModel) -> dict[str, Any]:
    """Return the section of the brick types that only the scenario has, and their stands; nothing where there are none."""
    kinds = set(model.kinds)
    kinds |= {
        brick_of_size(kind.studs, BRICK_LEVELS)
        for kind in kinds
        if lever_reaches_below(kind)
    }
    own = {
        kind.name: {
            "studs": list(kind.studs),
            "mass_kg": kind.mass,
            "height": kind.height,
            **({"bare": sorted(map(list, kind.bare))} if kind.bare else {}),
        }
        for kind in sorted(kinds, key=lambda kind: kind.name)
        if kind.name not in BRICKS
    }
    return {"bricks": own} if own else {}


def obstacle_fixtures(
    model: BrickModel, corner: tuple[int, int], plate: Plate
) -> list[dict[str, Any]]:
    """Return the obstacles of a model as fixtures of a scenario, its least corner at a stud of the plate."""
    fixtures = []
    for number, item in enumerate(model.obstacles, start=1):
        low, high = np.array(item.low), np.array(item.high)
        size = np.maximum((high - low) * _GRID - _GAP, _THINNEST)
        middle = ((low + high) / 2 + [*corner, 0]) * _GRID
        pose = plate_corner(plate) @ translation(*middle)
        stem = re.sub(r"[^A-Za-z0-9]", "_", item.name.removesuffix(".dat"))[:40]
        edges = [round(v, 6) for v in size.tolist()]
        own = {"size_m": edges, "pose": _pose_content(pose)}
        fixtures.append({"name": f"obstacle_{number}_{stem}", **own})
    return fixtures


def _pose_content(pose: Transform) -> dict[str, Any]:
    """Return a pose as a scenario file writes it, without angles where it is not turned."""
    xyz = [round(v, 6) + 0.0 for v in pose[:3, 3].tolist()]
    turn = Rotation.from_matrix(pose[:3, :3]).as_euler("xyz", degrees=True)
    rpy = [round(v, 6) + 0.0 for v in turn.tolist()]
    return {"xyz_m": xyz, **({"rpy_deg": rpy} if any(rpy) else {})}


def _colour(item: ModelBrick) -> dict[str, Any]:
    """Return the colour of a brick where it is not the default of its type."""
    if item.colour is None or item.colour == brick_colour(item.brick):
        return {}
    return {"colour": list(item.colour)}


def free_corner(
    model: BrickModel, studs: tuple[int, int], taken: Mapping[tuple[int, int], str]
) -> tuple[int, int]:
    """Return the corner of a model placed free on a plate, as near to its middle as possible.

    Raises:
        ScenarioError: it fits nowhere; names the obstacle in the middle.
    """
    wide, deep, _ = model.size
    middle = (studs[0] - wide) // 2, (studs[1] - deep) // 2
    corners = [
        (x, y) for x in range(studs[0] - wide + 1) for y in range(studs[1] - deep + 1)
    ]
    size = f"the model covers {wide} x {deep} studs"
    if not corners:
        raise ScenarioError(f"{size}, the plate has {studs[0]} x {studs[1]}")
    covered = model.studs
    corners.sort(key=lambda c: (abs(c[0] - middle[0]) + abs(c[1] - middle[1]), c))
    for x, y in corners:
        if not any((x + i, y + j) in taken for i, j in covered):
            return x, y
    here = [(middle[0] + i, middle[1] + j) for i, j in covered]
    names = ", ".join(sorted({taken[at] for at in here if at in taken})[:6])
    words = "there is no such room on the plate beside the stock; in the middle stand"
    raise ScenarioError(f"{size}: {words} {names}")


def _stock(robot: str, station: Station) -> list[dict[str, Any]]:
    """Return a station as entries of the stock, the brick that it stands on first."""
    kind, at = station.brick.name, station.cell
    name = f"{robot}_{kind}"
    own = {"name": name, "brick": kind, **at.entry, "station": True}
    if station.stand is None:
        return [own]
    below = {"brick": station.stand, **replace(at, z=at.z - 1).entry}
    return [{"name": f"{name}_stand", **below, "fixed": True}, own]
