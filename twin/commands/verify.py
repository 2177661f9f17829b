"""``twin verify``: prove a saved plan safe for any delays."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from twin.commands.command import command
from twin.host.guard import COMPLETED, FAILED, print_json

if TYPE_CHECKING:
    from scheduling.verification.verify import VerificationReport
    from twin.trial.simulation import AdversaryReport


def verify_folder(
    folder: Path,
    *,
    adversary: bool = True,
    audit_engine: str | None = None,
    as_json: bool = False,
    quiet: bool = False,
) -> int:
    """Prove that a saved plan is safe for any delays.

    The proof shares no code with the planner: it is slow and looks at everything anew. The
    worst delays are then tried out and audited: robots that stop for ever.

    Args:
        folder: folder with plan.json and plan.npz, a run's.
        adversary: also stop each robot wherever another waits for it, and audit what
            stands.
        audit_engine: what the audit measures with, pybullet or coal; by default PyBullet
            where it is installed, else coal.
        as_json: print JSON only.
        quiet: print errors only.
    """
    from scheduling.verification.verify import verify_plan
    from twin.audit.worlds.engines import engine_named
    from twin.host.progress import StageDisplay, of_stage
    from twin.trial.plan_result import plan_of_run
    from twin.trial.simulation import audit_standing_states

    engine = engine_named(audit_engine) if audit_engine else None
    tpg = plan_of_run(folder)
    with StageDisplay(enabled=not (quiet or as_json)) as display:
        report = verify_plan(tpg, progress=of_stage(display, "verification"))
        standing = audit_standing_states(tpg, display, engine) if adversary else None
    ok = report.ok and not (standing and standing.violations)
    if as_json:
        print_json(_content(ok, report, standing))
    elif not quiet:
        for problem in report.problems:
            typer.echo(problem.message)
        for state, violation in standing.violations if standing else ():
            what = f"{violation.first} and {violation.second} overlap by "
            what += f"{1000 * violation.depth_m:.2f} mm"
            if violation.kind != "contact":
                what = f"{violation.kind} of {violation.first}: {violation.second} "
                what += violation.detail
            typer.echo(
                f"if {state.robot} stops {'after' if state.at_end else 'before'} the motion of "
                f"node {state.node}: {what}"
            )
        verdict = "safe for any delays" if ok else "not safe"
        stops = (
            f", {standing.states} standing states audited with {standing.engine}"
            if standing
            else ""
        )
        typer.echo(
            f"{folder}: {verdict} ({len(report.problems)} problems; {report.pairs_checked} "
            f"pairs that may happen at once, robots {_millimetres(report)}{stops})"
        )
    return COMPLETED if ok else FAILED


def _millimetres(report: VerificationReport) -> str:
    if math.isfinite(least := report.min_distance_robots_m):
        return f"measured {1000 * least:.2f} mm apart at the closest"
    return "far apart"


def _content(
    ok: bool, report: VerificationReport, standing: AdversaryReport | None
) -> dict[str, object]:
    from twin.host.guard import finite

    content: dict[str, object] = {
        "ok": ok,
        "pairs_checked": report.pairs_checked,
        "min_distance_robots_m": finite(report.min_distance_robots_m),
        "min_distance_objects_m": finite(report.min_distance_objects_m),
        "problems": [{"kind": p.kind, "message": p.message} for p in report.problems],
        "adversary": None,
    }
    if standing is not None:
        content["adversary"] = {
            "states": standing.states,
            "engine": standing.engine,
            "min_distance_m": finite(standing.min_distance_m),
            "violations": [
                {**asdict(state), **asdict(violation)}
                for state, violation in standing.violations
            ],
        }
    return content


verify = command(
    f"{__name__}:verify_folder",
    folder={"metavar": "PLAN"},
)
