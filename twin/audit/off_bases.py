"""What touches in a run whose robots stand elsewhere than the plan has them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from planning.transforms import Transform
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audit.audit import AuditReport
from twin.audit.case import AuditCase
from twin.audit.contacts import Contacts, allowed_contacts
from twin.audit.motion.executed import Recording
from twin.audit.motion.sampling import stretches
from twin.audit.worlds.engines import Engine, engine_and_version, open_world
from twin.audit.worlds.world import overlapping_at_home


def audit_off_bases(
    tpg: TemporalPlanGraph,
    recording: Recording,
    bases: Mapping[str, Transform],
    engine: Engine,
) -> AuditReport:
    """Measure every distance of an execution with bases that are off.

    Robots and what they carry are where their joints have them from there; what rests lies where the
    plan has it. Contacts that the plan means to make take the difference up: they are no violation,
    however deep. Nothing but contacts is looked at.

    Args:
        tpg: says what stands in the cell, and who may touch whom.
        recording: what was executed.
        bases: by robot, shape (4, 4) each.
        engine: to measure with.
    """
    cell = tpg.cell
    robots = tuple(replace(r, base=bases.get(r.name, r.base)) for r in cell.robots)
    off = replace(tpg, cell=replace(cell, robots=robots))
    world = open_world(off.cell, engine)
    try:
        case = AuditCase(world, off, recording)
        exempt = overlapping_at_home(world)
        contacts = Contacts(
            case, allowed_contacts(off), exempt, math.inf, taken_up=True
        )
        for stretch in stretches(world, case):
            contacts.look(stretch)
    finally:
        world.close()
    found = sorted(contacts.violations(), key=lambda v: (v.t_start, v.first, v.second))
    return AuditReport(
        contacts.configurations,
        contacts.least,
        contacts.bound,
        tuple(found),
        engine_and_version(engine),
    )
