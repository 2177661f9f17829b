"""``twin operate``: execute in the twin, and plan anew whatever fails; ``twin drive``: an arm in a process of its own."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from twin.commands.command import View, command
from twin.commands.run import announcer, show_run, values_of
from twin.host.guard import COMPLETED, print_json

if TYPE_CHECKING:
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
    from twin.api import runs
    from twin.host.progress import report_nothing
    from twin.operate import api as operations
    from twin.trial.loaded_scenario import load

    given = {
        "robots": robots,
        "seed": seed,
        "planning.shortcut_candidates": shortcuts,
    }

    def opened(address: str) -> None:
        if not view.silent:
            print(f"page: {address}", file=sys.stderr)  # noqa: T201

    page = options.get("page") is not None
    if ask and not page:
        # A display of progress would write over the question.
        options |= {"says": _answer, "progress": report_nothing}
    chosen = load(scenario).varied(runs.released(values_of(settings, given)))
    if ask and page and chosen.sections.execution.recovery.ask is None:
        chosen = chosen.varied({"recovery.ask": {}})
    return operations.operate(chosen, begun=announcer(view), opened=opened, **options)


def _answer(question: str) -> bool:
    """Return what somebody answers at the keyboard; who breaks off there breaks off the run."""
    try:
        return typer.confirm(question, err=True)
    except typer.Abort:
        raise KeyboardInterrupt from None


operate = command(
    f"{__name__}:operate_scenario",
    show_run,
    passes_to="twin.operate.api:operate",
    page={"min": 0, "max": 65_535, "metavar": "PORT"},
)


def drive_robot(
    address: str,
    robot: str,
    *,
    certificates: Path | None = None,
    pace: float = 1.0,
    patience: float = 60.0,
    as_json: bool = False,
    quiet: bool = False,
) -> int:
    """Drive a simulated arm for a cell that twin operate --drivers executes.

    The cell's drivers file says kind: grpc of the robot. It asks again and again until the cell is there, and
    ends when the cell says that nothing more will come.

    Args:
        address: where the cell listens, such as 127.0.0.1:50551.
        robot: its name in the cell.
        certificates: folder that twin cluster certificates made, where the cell listens with one.
        pace: how many times as fast as planned; that of the cell's drivers file.
        patience: how long it asks for a cell that is not there [s].
    """
    from twin.cluster.certificates import certificates_in
    from twin.drivers.simulated_arm import SimulatedArm
    from twin.live.driver_end import DriverEnd, started_now
    from twin.live.service import drive_remotely

    end = DriverEnd(SimulatedArm(pace=pace), robot, started_now())
    held = None if certificates is None else certificates_in(certificates)
    drive_remotely(
        end, address, held, every_s=min(0.02, 0.1 / pace), patience_s=patience
    )
    done = end.report().state.done
    if as_json:
        print_json({"robot": robot, "done": done})
    elif not quiet:
        typer.echo(f"{robot}: {done} nodes")
    return COMPLETED


drive = command(
    f"{__name__}:drive_robot",
    pace={"min": 1e-6},
    patience={"min": 0},
)
