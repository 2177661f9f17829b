"""``twin explore``: which cell should it be."""

from __future__ import annotations

from typing import TYPE_CHECKING

from twin.commands.command import View, command
from twin.commands.study import columns
from twin.host.guard import COMPLETED, print_json

if TYPE_CHECKING:
    from twin.api.explorations import Explored


def _show(found: Explored, view: View) -> int:
    if view.as_json:
        print_json(found.summary)
    elif not view.quiet:
        from twin.explore.terminal import print_explored

        print_explored(found.found, found.folder)
    return COMPLETED


explore = command(
    "twin.api.explorations:explore",
    _show,
    columns=columns,
    designs={"min": 1},
    single_changes={"min": 1, "metavar": "N"},
    replications={"names": ("--replications", "-n"), "min": 2},
    resume={"metavar": "DIR"},
    workers={"min": 1},
)
