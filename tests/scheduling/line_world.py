"""A small line for tests: one planar arm puts boxes down, another works at them, they leave."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planning.cell.machine import machine_robot
from planning.cell.shape import box_shape
from planning.cell.workcell import CellObject, Clearances, PlacedRobot, Workcell
from planning.motion.motion_plan import MotionPlan
from planning.tasks.task import AllowedContact, Handling, TaskKind
from planning.transforms import Array, rotation, translation
from scheduling.build_nodes import build_nodes
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.sequences.copies import Pattern
from scheduling.sequences.sequence import PlanSequence, SequencedPlan
from tests.scheduling.mini_world import PlanWriter, planar_arm

HOME = np.array([1.2, 2.3])
LIFT = np.array([-0.769, -1.259])
PICK, PLACE = np.array([-1.2, -0.5]), np.array([0.3, 0.2])
GRIP = translation(0.04, 0.0, 0.0)
NEXT_SLOT = np.array([-0.4, 0.0])
"""Change of the arm from one slot of a tray to the next."""

SIZE = (0.06, 0.06, 0.04)


def line_plan(
    *,
    every_s: float = 0.0,
    leave_s: float = 0.0,
    products: int = 6,
    buffer: int | None = None,
    both: bool = True,
    slot: int = 0,
    slots: int = 1,
) -> tuple[MotionPlan, Pattern]:
    """Return the plan of one product, and how it is repeated.

    Args:
        every_s: a box arrives so often; 0 for a feeder.
        leave_s: time to take a product away.
        products: how many.
        buffer: parts that may wait on the conveyor.
        both: whether the second arm works, too.
        slot: slot of the box in a tray, from 0; from the last one on, a full tray is presented.
        slots: how many slots the tray has.
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
    starts = []
    for k in range(slots):
        writer.configurations["a"] = PICK + k * NEXT_SLOT
        starts.append(writer.flange("a") @ GRIP)
    writer.configurations["a"] = HOME
    last_slot = slot + 1 == slots
    boxes = tuple(
        CellObject(
            f"box.{k + 1}",
            "box",
            box_shape("box", SIZE),
            starts[k % slots],
            later=k >= slots,
        )
        for k in range(slot, 2 * slots if last_slot else slots)
    )
    writer.cell = replace(cell, objects=boxes)
    own, lift, down = (
        f"box.{slot + 1}",
        LIFT + slot * NEXT_SLOT,
        PICK + slot * NEXT_SLOT,
    )

    writer.add("a", "transit", writer.line(HOME, lift))
    held = Handling(own, 1, "a", GRIP)
    pick = writer.add("a", "pick", np.stack([lift, down, lift]), (held,), own)
    arrive = present = -1
    if every_s:
        arrive = writer.add("belt", TaskKind.ARRIVE, _still(np.zeros(1)))
        _lasts(writer, every_s)
    if last_slot:
        up = tuple(Handling(x.name, 1, None, x.start) for x in boxes if x.later)
        present = writer.add("stop", TaskKind.PRESENT, _still(np.zeros(1)), up)
        writer.dependencies.append((pick, present))
    way = writer.line(lift, PLACE)
    if slots > 1:
        # Around the boxes in the tray.
        turned = np.array([0.6, lift[1]])
        way = np.vstack([writer.line(lift, turned), writer.line(turned, PLACE)[1:]])
    carry = writer.add("a", "transit", way, obj=own)
    pose = writer.flange("a") @ GRIP
    put = Handling(own, 1, None, pose)
    place = writer.add("a", "place-down", _still(PLACE), (put,), own)
    home = writer.add("a", "transit", writer.line(PLACE, HOME))
    last, touching = place, [pick, carry, place, home]
    contacts = [AllowedContact("a/tool", own, frozenset(touching))]
    if both:
        there = writer.add("b", "transit", writer.line(HOME, PLACE))
        last = writer.add("b", "pick", _still(PLACE))
        back = writer.add("b", "transit", writer.line(PLACE, HOME))
        contacts.append(AllowedContact("b/tool", own, frozenset([there, last, back])))
        writer.dependencies.append((place, last))
    gone = Handling(own, 1, Handling.GONE, pose)
    leave = writer.add("outfeed", TaskKind.LEAVE, _still(np.zeros(1)), (gone,))
    _lasts(writer, leave_s)
    writer.dependencies.append((last, leave))
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


def mixed_line(variants: Sequence[bool], slots: int = 1) -> PlanSequence:
    """Return the plans of products of two variants: the second arm works at some of them only.

    Args:
        variants: whether it does, by product.
        slots: of the tray from which boxes come.
    """
    wanted = [(both, m % slots) for m, both in enumerate(variants)]
    states = list(dict.fromkeys(wanted))
    plans = [
        build_nodes(line_plan(leave_s=0.5, both=both, slot=slot, slots=slots)[0])
        for both, slot in states
    ]
    segments, waits = [], []
    for m, state in enumerate(wanted):
        k = states.index(state)
        tasks, names = plans[k].tasks, [x.name for x in plans[k].cell.objects]
        by = m - state[1]
        own = {name: f"box.{int(name[4:]) + by}" for name in names}
        segments.append(SequencedPlan(k, own, np.full(len(tasks), m + 1)))
        if m >= slots:
            full = by - 1
            waits.append((full, _task(plans[segments[full].plan], "present"), m, 1))
        if m:
            gone = _task(plans[segments[m - 1].plan], "leave")
            waits.append((m - 1, gone, m, _task(plans[k], "place-down")))
    rows = np.array(waits, dtype=np.int64).reshape(-1, 4)
    return PlanSequence(tuple(plans), tuple(segments), rows)


def _task(plan: TemporalPlanGraph, kind: str) -> int:
    return next(task.index for task in plan.tasks if task.kind == kind)


def _still(q: Array) -> Array:
    return np.stack([q, q])


def _lasts(writer: PlanWriter, seconds: float) -> None:
    """Let the task that was written last take some time."""
    motion = writer.motions[-1]
    time = motion.time[0] + np.array([0.0, seconds])
    writer.motions[-1] = replace(motion, time=time)
    writer.time = float(time[-1])
