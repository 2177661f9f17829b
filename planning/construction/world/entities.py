"""Numbers of whatever may be in the way of something else."""

from __future__ import annotations

from planning.cell.workcell import Workcell


def entity_numbers(cell: Workcell) -> dict[str, int]:
    """Return the number of every entity: arm and tool of each robot, fixtures, objects."""
    names = [f"{r.name}/{group}" for r in cell.robots for group in ("arm", "tool")]
    names += [f.name for f in cell.fixtures] + [o.name for o in cell.objects]
    return {name: k for k, name in enumerate(names)}
