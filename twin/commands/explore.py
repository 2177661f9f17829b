"""``twin explore``: which cell should it be."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.commands.command import View, command
from twin.commands.study import columns, given_cluster
from twin.host.guard import COMPLETED, print_json

if TYPE_CHECKING:
    from twin.api.explorations import Explored


def explore_scenario(
    scenario: Path | None = None,
    *,
    scheduler: str | None = None,
    certificates: Path | None = None,
    insecure: bool = False,
    **options: Any,
) -> Explored:
    """Search among designs of a cell for the best, and say what it is worth.

    What may be different, and what is looked for, is in the section explore of the scenario. Each design
    is checked, then reached for, planned, planned in full and replicated; what is refused says why.

    Args:
        scenario: a scenario, or the path of its file.
        scheduler: address of a Dask scheduler whose workers evaluate designs: tls://host:port. Files that
            the scenario names must be in the same folder on their machines.
        certificates: folder with the certificates of the scheduler.
        insecure: use a tcp:// scheduler on another machine, unprotected.
        options: those of twin.explore.
    """
    from twin.api.explorations import explore

    cluster = given_cluster(scheduler, certificates, insecure)
    return explore(scenario, cluster=cluster, **options)


def _show(found: Explored, view: View) -> int:
    if view.as_json:
        print_json(found.summary)
    elif not view.quiet:
        from twin.explore.page_words import print_explored

        print_explored(found.found, found.folder)
    return COMPLETED


explore = command(
    f"{__name__}:explore_scenario",
    _show,
    passes_to="twin.api.explorations:explore",
    columns=columns,
    designs={"min": 1},
    single_changes={"min": 1, "metavar": "N"},
    replications={"names": ("--replications", "-n"), "min": 2},
    resume={"metavar": "DIR"},
    workers={"min": 1},
)
