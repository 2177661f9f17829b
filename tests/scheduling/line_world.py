"""A small line for tests: one planar arm puts boxes down, another works at them, they leave."""

from dataclasses import replace

import numpy as np

from planning.cell.machine import machine_robot
from planning.cell.shape import box_shape
from planning.cell.workcell import CellObject, Clearances, PlacedRobot, Workcell
from planning.motion.motion_plan import MotionPlan
from planning.tasks.task import AllowedContact, Handling, TaskKind
from planning.transforms import Array, rotation, translation
from scheduling.copies import Pattern
from tests.scheduling.mini_world import PlanWriter, planar_arm

HOME = np.array([1.2, 2.3])
LIFT = np.array([-0.769, -1.259])
PICK, PLACE = np.array([-1.2, -0.5]), np.array([0.3, 0.2])
GRIP = translation(0.04, 0.0, 0.0)
SIZE = (0.06, 0.06, 0.04)


def line_plan(
    *,
    every_s: float = 0.0,
    leave_s: float = 0.0,
    products: int = 6,
    buffer: int | None = None,
    both: bool = True,
) -> tuple[MotionPlan, Pattern]:
    """Return the plan of one product, and how it is repeated.

    Args:
        every_s: a box arrives so often; 0 for a feeder.
        leave_s: time to take a product away.
        products: how many.
        buffer: parts that may wait on the conveyor.
        both: whether the second arm works, too.
    """
    arms = (
        PlacedRobot("a", planar_arm(2), translation(-0.5, 0.0, 0.0), HOME),
        PlacedRobot(
            "b", planar_arm(2), translation(0.5, 0.0, 0.0) @ rotation("z", np.pi), HOME
        ),
    )
    machines = tuple(map(machine_robot, ("belt", "stop", "outfeed")))
    cell = Workcell(arms, (), (), Clearances(0.001, 0.0), machines)
    writer = PlanWriter(cell, np.random.default_rng(0))
    writer.configurations |= {item.name: np.zeros(1) for item in machines}
    writer.configurations["a"] = PICK
    start = writer.flange("a") @ GRIP
    writer.configurations["a"] = HOME
    boxes = tuple(
        CellObject(f"box.{k}", "box", box_shape("box", SIZE), start, later=k > 1)
        for k in (1, 2)
    )
    writer.cell = replace(cell, objects=boxes)

    writer.add("a", "transit", writer.line(HOME, LIFT))
    held = Handling("box.1", 1, "a", GRIP)
    pick = writer.add("a", "pick", np.stack([LIFT, PICK, LIFT]), (held,), "box.1")
    arrive = present = -1
    if every_s:
        arrive = writer.add("belt", TaskKind.ARRIVE, _still(np.zeros(1)))
        _lasts(writer, every_s)
    up = Handling("box.2", 1, None, start)
    present = writer.add("stop", TaskKind.PRESENT, _still(np.zeros(1)), (up,))
    carry = writer.add("a", "transit", writer.line(LIFT, PLACE), obj="box.1")
    pose = writer.flange("a") @ GRIP
    down = Handling("box.1", 1, None, pose)
    place = writer.add("a", "place-down", _still(PLACE), (down,), "box.1")
    home = writer.add("a", "transit", writer.line(PLACE, HOME))
    last, touching = place, [pick, carry, place, home]
    contacts = [AllowedContact("a/tool", "box.1", frozenset(touching))]
    if both:
        there = writer.add("b", "transit", writer.line(HOME, PLACE))
        last = writer.add("b", "pick", _still(PLACE))
        back = writer.add("b", "transit", writer.line(PLACE, HOME))
        contacts.append(
            AllowedContact("b/tool", "box.1", frozenset([there, last, back]))
        )
        writer.dependencies.append((place, last))
    gone = Handling("box.1", 1, Handling.GONE, pose)
    leave = writer.add("outfeed", TaskKind.LEAVE, _still(np.zeros(1)), (gone,))
    _lasts(writer, leave_s)
    writer.dependencies += [(last, leave), (pick, present)]
    if every_s:
        writer.dependencies.append((arrive, present))
    lags = [(present, pick, 1), (leave, place, 1)]
    if buffer is not None:
        lags.append((present, arrive, buffer))
    writer.allowed += contacts
    product = np.ones(len(writer.tasks), dtype=np.int64)
    product[[k for k in (arrive, present) if k >= 0]] = 2
    names = {item.name: ("box", int(item.name[4:])) for item in boxes}
    pattern = Pattern(products, 1, product, np.array(lags, dtype=np.int64), names)
    return writer.plan(), pattern


def _still(q: Array) -> Array:
    return np.stack([q, q])


def _lasts(writer: PlanWriter, seconds: float) -> None:
    """Let the task that was written last take some time."""
    motion = writer.motions[-1]
    time = motion.time[0] + np.array([0.0, seconds])
    writer.motions[-1] = replace(motion, time=time)
    writer.time = float(time[-1])
