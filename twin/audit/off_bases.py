"""What touches in a run whose robots stand elsewhere than the plan has them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from planning.transforms import Transform
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audit.audit import Auditor, AuditReport
from twin.audit.motion.executed import Recording
from twin.audit.worlds.engines import Engine


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
    with Auditor(off, engine) as auditor:
        return auditor.audit_contacts(recording)
