"""``twin operate``: execute in the twin, and plan anew whatever fails."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.commands.command import View, command
from twin.commands.run import announce, show_run, values_of

if TYPE_CHECKING:
    from twin.api.runs import Check
    from twin.trial.run_result import RunResult


def operate_scenario(
    scenario: Path,
    *,
    seed: int | None = None,
    shortcuts: int | None = None,
    robots: int | None = None,
    settings: Sequence[str] = (),
    ask: bool = False,
    view: View,
    **options: Any,
) -> RunResult:
    """Operate a cell in the twin: what fails is planned anew while the others go on.

    A skill that fails for good is done again with what is left, by another robot or with another object of
    its kind; what nobody can do any more is given up with all that rests on it, and the rest goes on.

    Args:
        scenario: file, or the name of one that comes with the program.
        seed: in place of the scenario's.
        shortcuts: most shortcuts tried on the first plan, in place of the scenario's.
        robots: of the team, in place of the scenario's; without a team, the first M.
        settings: value of any key, such as execution.recovery.planning_s=2; may be given several
            times. Values are words or JSON.
        ask: ask at the keyboard before anything is given up, or on the page where there is one; time in a
            simulation stands meanwhile, and the run cannot be resumed.
        view: how to show.
        options: those of twin.operate.
    """
    from twin.api import operations, runs
    from twin.host.progress import report_nothing
    from twin.trial.loaded_scenario import load

    given = {
        "robots": robots,
        "seed": seed,
        "planning.shortcut_candidates": shortcuts,
    }
    values = {key: value for key, value in given.items() if value is not None}
    values |= values_of(settings)

    def begun(check: Check, folder: Path) -> None:
        if not view.silent:
            announce(check, folder)

    def opened(address: str) -> None:
        if not view.silent:
            print(f"page: {address}", file=sys.stderr)  # noqa: T201

    page = options.get("page") is not None
    if ask and not page:
        # A display of progress would write over the question.
        options |= {"says": _answer, "progress": report_nothing}
    chosen = load(scenario).varied(runs.released(values))
    if ask and page and chosen.sections.execution.recovery.ask is None:
        chosen = chosen.varied({"recovery.ask": {}})
    return operations.operate(chosen, begun=begun, opened=opened, **options)


def _answer(question: str) -> bool:
    """Return what somebody answers at the keyboard; who breaks off there breaks off the run."""
    import typer

    try:
        return typer.confirm(question, err=True)
    except typer.Abort:
        raise KeyboardInterrupt from None


operate = command(
    f"{__name__}:operate_scenario",
    show_run,
    passes_to="twin.api.operations:operate",
    robots={"min": 1, "metavar": "M"},
    failures={"min": 0, "max": 1, "metavar": "P"},
    page={"min": 0, "max": 65_535, "metavar": "PORT"},
    settings={"names": ("--set",), "metavar": "KEY=VALUE"},
)
