"""``twin robots``: list the robot models that a scenario can name."""

from __future__ import annotations

from twin.commands.options import AsJson
from twin.host.guard import guarded, print_json


@guarded
def robots(as_json: AsJson = False) -> None:
    """List the robot models that a scenario can name."""
    from rich.console import Console
    from rich.table import Table

    from planning.robots.registry import ROBOTS

    if as_json:
        rows = [
            {
                "name": entry.name,
                "joints": len(entry.home),
                "source": entry.source,
                "licence": entry.licence,
                "note": entry.note,
            }
            for entry in ROBOTS.values()
        ]
        print_json(rows)
        return
    table = Table("name", "joints", "what it is", "description from", "licence")
    for entry in ROBOTS.values():
        joints = str(len(entry.home))
        table.add_row(entry.name, joints, entry.note, entry.source, entry.licence)
    console = Console()
    console.print(table)
    console.print("Any other robot: give `model:` the path of its URDF.")
