"""Small teams for tests: boxes that slide on a plane, and that fly with a suction cup below."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from planning.geometry.body import ConvexBody
from planning.geometry.cover import box_body
from planning.robots.model import KinematicChain, LinkPart, RobotModel
from planning.transforms import Array, rotation, translation
from planning.workcell import (
    CellObject,
    Clearances,
    Fixture,
    PlacedRobot,
    Workcell,
)

SPEED = 0.5


def shifted(
    name: str, size: tuple[float, float, float], shift: tuple[float, float, float]
) -> ConvexBody:
    body = box_body(name, size)
    by = np.array(shift)
    capsules = type(body.capsules)(
        body.capsules.start + by, body.capsules.end + by, body.capsules.radius
    )
    return ConvexBody(name, body.vertices + by, capsules)


def _model(
    name: str,
    axes: list[tuple[float, float, float]],
    prismatic: list[bool],
    parts: tuple[LinkPart, ...],
    flange: Array,
    reach: float,
) -> RobotModel:
    n = len(axes)
    lower = np.where(prismatic, -reach, -np.pi)
    return RobotModel(
        name,
        Path(f"{name}.urdf"),
        (),
        tuple(f"j{j}" for j in range(n)),
        lower,
        -lower,
        np.where(prismatic, SPEED, 1.0),
        KinematicChain(
            np.stack([np.eye(4)] * n), np.array(axes, dtype=float), np.array(prismatic)
        ),
        flange,
        {},
        parts,
        frozenset(
            (i, j) for j in range(len(parts)) for i in range(j)
        ),
        np.zeros(n),
    )


def slider(size: tuple[float, float, float] = (0.3, 0.3, 0.3)) -> RobotModel:
    """A box on the plane z = 0: x and y."""
    part = LinkPart(1, "arm", shifted("box", size, (0.0, 0.0, size[2] / 2)))
    return _model(
        f"slider{size}",
        [(1, 0, 0), (0, 1, 0)],
        [True, True],
        (part,),
        translation(0.0, 0.0, size[2]),
        3.0,
    )


def rover() -> RobotModel:
    """A long box on the plane that turns: x, y and yaw, and an arm of two joints on top."""
    parts = (
        LinkPart(2, "arm", shifted("chassis", (0.6, 0.3, 0.3), (0.0, 0.0, 0.16))),
        LinkPart(3, "arm", shifted("upper", (0.1, 0.1, 0.5), (0.0, 0.0, 0.55))),
        LinkPart(4, "tool", shifted("lower", (0.5, 0.08, 0.08), (0.25, 0.0, 0.0))),
    )
    n = 5
    placement = np.stack([np.eye(4)] * n)
    placement[4] = translation(0.0, 0.0, 0.75)
    model = _model(
        "rover",
        [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 1), (0, 1, 0)],
        [True, True, False, False, False],
        parts,
        translation(0.5, 0.0, 0.0),
        3.0,
    )
    return RobotModel(
        **{
            **model.__dict__,
            "chain": KinematicChain(placement, model.chain.axis, model.chain.prismatic),
        }
    )


def flyer() -> RobotModel:
    """A flying box with a suction cup below: x, y, z; the flange is the cup's mouth."""
    parts = (
        LinkPart(2, "arm", shifted("hull", (0.3, 0.3, 0.15), (0.0, 0.0, 0.275))),
        LinkPart(2, "tool", shifted("cup", (0.06, 0.06, 0.2), (0.0, 0.0, 0.1))),
    )
    return _model(
        "flyer",
        [(1, 0, 0), (0, 1, 0), (0, 0, 1)],
        [True, True, True],
        parts,
        translation(0.0, 0.0, 0.0),
        4.0,
    )


def placed(name: str, model: RobotModel, home: tuple[float, ...]) -> PlacedRobot:
    return PlacedRobot(name, model, np.eye(4), np.array(home, dtype=float))


def box(
    name: str, size: tuple[float, float, float], at: tuple[float, float, float]
) -> CellObject:
    return CellObject(
        name, "box", np.array(size), translation(*at), box_body(name, size), mass=0.1
    )


def fixture(
    name: str,
    size: tuple[float, float, float],
    at: tuple[float, float, float],
    turn: float = 0.0,
) -> Fixture:
    return Fixture(
        name, np.array(size), translation(*at) @ rotation("z", turn), box_body(name, size)
    )


def team(
    robots: list[PlacedRobot],
    *,
    fixtures: tuple[Fixture, ...] = (),
    objects: tuple[CellObject, ...] = (),
) -> Workcell:
    return Workcell(tuple(robots), fixtures, objects, Clearances(0.001, 0.0))
