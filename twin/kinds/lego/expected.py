"""Expected results of a LEGO assembly for the audit: brick goals, steps with a supporting robot, temporary bricks."""

from __future__ import annotations

from planning.lego.bricks.grid import box_pose
from planning.lego.sequencing.remedies import raise_on_plinth
from twin.audits.expectations import Expectations, Place
from twin.kinds.lego.kind import LegoKind, build_lego, build_structure
from twin.scenario.sections.cell import CellSection


def expectations_of(kind: LegoKind, _cell: CellSection) -> Expectations:
    """Return the goals of all bricks, each for any brick of its type, and the steps with a supporting robot."""
    section = kind.section
    rules, assembly = section.rules, build_lego(section)
    places = [
        Place(
            f"step {k}: {step.brick.name} at {step.cell.words}",
            box_pose(assembly.plate, step),
            step.brick.name,
            held=step.support is not None,
            temporary=step.temporary,
        )
        for k, step in enumerate(assembly.steps, start=1)
    ]
    raised, plinth = raise_on_plinth(build_structure(section) or (), rules.plinth)
    for item in (*raised, *plinth):
        pose, words = (
            box_pose(assembly.plate, item),
            f"{item.name} at {item.cell.words}",
        )
        helps = item in plinth
        places.append(Place(words, pose, item.brick.name, temporary=helps))
    # Where the file gives steps, it says of each brick where it goes, of those that help too.
    more = bool(rules.scaffold) and section.structure is not None
    return Expectations(tuple(places), hold="studs", helpers=more)
