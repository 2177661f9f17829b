"""``twin verify``: prove a saved plan safe for any delays."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin.commands.guard import COMPLETED, FAILED, guarded

if TYPE_CHECKING:
    from scheduling.verification import VerificationReport

Folder = Annotated[
    Path,
    typer.Argument(help="Folder with plan.json and plan.npz, a run's.", metavar="PLAN"),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing.")]


@guarded
def verify(folder: Folder, as_json: AsJson = False, quiet: Quiet = False) -> int:
    """Prove that a saved plan is safe for any delays.

    The proof shares no code with the planner: it is slow and looks at everything anew.
    """
    from scheduling.plan_files import load_plan
    from scheduling.verification import verify_plan
    from twin.progress import StageDisplay

    tpg = load_plan(folder)
    with StageDisplay(enabled=not (quiet or as_json)) as display:
        report = verify_plan(
            tpg, progress=lambda done, total: display("verification", done, total)
        )
    if as_json:
        typer.echo(json.dumps(_content(report), indent=2))
    elif not quiet:
        for problem in report.problems:
            typer.echo(problem.message)
        verdict = "safe for any delays" if report.ok else "not safe"
        typer.echo(
            f"{folder}: {verdict} ({len(report.problems)} problems; {report.pairs_checked} "
            f"pairs that may happen at once, robots {_millimetres(report)} apart)"
        )
    return COMPLETED if report.ok else FAILED


def _millimetres(report: VerificationReport) -> str:
    least = report.min_distance_robots_m
    return f"at least {1000 * least:.2f} mm" if math.isfinite(least) else "always far"


def _content(report: VerificationReport) -> dict[str, object]:
    robots, objects = report.min_distance_robots_m, report.min_distance_objects_m
    return {
        "ok": report.ok,
        "pairs_checked": report.pairs_checked,
        "min_distance_robots_m": robots if math.isfinite(robots) else None,
        "min_distance_objects_m": objects if math.isfinite(objects) else None,
        "problems": [{"kind": p.kind, "message": p.message} for p in report.problems],
    }
