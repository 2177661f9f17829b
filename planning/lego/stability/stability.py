"""Forces between LEGO bricks in the linear program of equilibrium (StableLego, Liu et al. 2024).

Every brick is a rigid body under gravity and other loads. Joints transmit forces: the contacts
of a knob in the cavity above push without limit and pull with limited friction, a knob bears
sideways with a limit, neighbours in a layer push each other. The program asks for forces in
balance on every brick that need as little friction as possible; the largest friction over its
capacity T is the score of the structure.

    minimise s  subject to  A f = -w,  f_knob >= -s T,  |f_sideways| <= S,  f_side >= 0

A structure whose score is 0 stands without any friction, up to 1 it stands, above it collapses.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache

from planning.lego.bricks.assembly import STUD_PITCH, PlacedBrick
from planning.lego.bricks.contacts import (
    Joint,
    SideContact,
    is_narrow,
    knob_points,
    stud_height,
)
from planning.statics.equilibrium import ContactForce, SpreadForce, Vector

UP = (0.0, 0.0, 1.0)
LEVEL = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


@dataclass(frozen=True)
class JointStrength:
    """Forces that a joint between LEGO bricks bears; plates hold as bricks do, an assumption.

    Attributes:
        narrow_pull: friction T of one of the four contacts of a knob in a brick of one stud's
            width [N]. The figure published with StableLego, 100 gram-force.
        wide_pull: friction T of one of the three contacts in a wider brick [N]. Set so that
            stairs of 19 2x4 bricks stand and stairs of 20 collapse, as published there; any
            figure from 0.80 to 0.89 does. (StableLego has 0.98 N here too, but shifts all three
            contacts to one side, which makes mirrored structures unequal.)
        sideways: force S that a knob bears along each of x and y [N]; an assumption, far above
            what gravity asks for.
    """

    narrow_pull: float = 0.98
    wide_pull: float = 0.85
    sideways: float = 20.0

    def pull(self, upper: PlacedBrick) -> float:
        """Return the friction T of a contact in a brick's cavity [N]."""
        return self.narrow_pull if is_narrow(upper) else self.wide_pull


@dataclass(frozen=True)
class Load:
    """A force on a brick, at a point or spread over several.

    A tool that holds a brick keeps it from turning, so the force that it presses with acts where
    the brick resists: anywhere between the points that the tool touches.

    Attributes:
        brick: name of the brick.
        force: (x, y, z) in the plate's frame [N].
        points: where it may act, in the plate's frame with the plate's corner as origin [m].
    """

    brick: str
    force: tuple[float, float, float]
    points: tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Hold:
    """A place where a standing tool touches a brick: it pushes back, it does not pull.

    Attributes:
        brick: name of the brick.
        direction: of the push on the brick, +1 up or -1 down.
        point: where it acts, in the plate's frame with the plate's corner as origin [m].
    """

    brick: str
    direction: int
    point: tuple[float, float, float]


def joint_contacts(
    joint: Joint, upper: PlacedBrick, strength: JointStrength
) -> Iterator[ContactForce]:
    """Yield the contacts of a joint in studs, knob by knob.

    Args:
        joint: the joint.
        upper: its upper brick.
        strength: what joints bear.
    """
    ends, height = (joint.lower, joint.upper), stud_height(joint.level)
    pull, sideways = strength.pull(upper), strength.sideways
    for stud in joint.studs:
        for x, y in knob_points(upper, stud).tolist():
            yield ContactForce(*ends, (x, y, height), UP, pull)
        axis = (stud[0] + 0.5, stud[1] + 0.5, height)
        for direction in LEVEL:
            yield ContactForce(*ends, axis, direction, within=sideways)


def face_contacts(side: SideContact) -> Iterator[ContactForce]:
    """Yield the contacts of two bricks side by side, the corners of their common face, in studs."""
    for along in map(float, side.span):
        x, y = (side.at, along) if side.axis == 0 else (along, side.at)
        for height in map(stud_height, side.levels):
            at = (float(x), float(y), height)
            yield ContactForce(side.first, side.second, at, LEVEL[side.axis])


def spread_force(load: Load) -> SpreadForce:
    """Return a load as the program of equilibrium takes it, in studs."""
    return SpreadForce(load.brick, load.force, tuple(map(_in_studs, load.points)))


@cache
def tool_push(hold: Hold) -> ContactForce:
    """Return the push of a standing tool as the program of equilibrium takes it, in studs."""
    up = (0.0, 0.0, float(hold.direction))
    return ContactForce(None, hold.brick, _in_studs(hold.point), up)


def _in_studs(point: Vector) -> Vector:
    x, y, z = point
    return x / STUD_PITCH, y / STUD_PITCH, z / STUD_PITCH
