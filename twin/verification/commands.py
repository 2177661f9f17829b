"""``twin verify``: prove that a saved plan is safe, whatever is late or slightly out of place."""

from __future__ import annotations

import math
import re
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from planning.errors import RequestError
from twin.commands.options import AsJson, AuditEngine, Quiet
from twin.host.guard import ExitCode, guarded, print_json

if TYPE_CHECKING:
    from planning.cell.workcell import PoseError
    from scheduling.verification.survived_errors import SurvivedErrors
    from scheduling.verification.verify import VerificationReport
    from twin.verification.standing_states import AdversaryReport

_UNITS = {
    "mm": ("m", 1e-3),
    "cm": ("m", 1e-2),
    "m": ("m", 1.0),
    "deg": ("rad", math.pi / 180),
    "mrad": ("rad", 1e-3),
    "rad": ("rad", 1.0),
}
"""Units of pose errors, each with the attribute and its factor."""


@guarded
def verify(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="PLAN", help="Folder with plan.json and plan.npz, a run's."
        ),
    ],
    base_error: Annotated[
        str | None,
        typer.Option(
            metavar="M,RAD",
            help="Also prove that there is no forbidden contact while the base of "
            "every robot is off by up to this, as 1mm,0.1deg: a displacement "
            "in any direction, a rotation about any axis. The report has the "
            "largest tolerated error, and what limits it.",
        ),
    ] = None,
    deviation: Annotated[
        str | None,
        typer.Option(
            metavar="M,RAD",
            help="The same while in every skill the flange of the robot, with the "
            "tool and the held object, is off its reference path by up to "
            "this, as under force control.",
        ),
    ] = None,
    adversary: Annotated[
        bool,
        typer.Option(
            help="Also stop each robot wherever another waits for it, and audit "
            "the standstills."
        ),
    ] = True,
    audit_engine: AuditEngine = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
) -> int:
    """Prove that a saved plan is safe for any delays.

    The proof is slow and shares no code with the planner. The worst delays, robots that stop for ever, are
    then simulated and audited.
    """
    from planning.cell.workcell import NO_ERROR
    from scheduling.verification.verify import verify_plan
    from twin.audits.worlds.engines import engine_named
    from twin.host.progress import StageDisplay
    from twin.trial.plan_result import plan_of_run
    from twin.verification.standing_states import audit_standing_states

    engine = engine_named(audit_engine) if audit_engine else None
    off, away = (
        read_pose_error(text, name) if text else NO_ERROR
        for text, name in ((base_error, "--base-error"), (deviation, "--deviation"))
    )
    tpg = plan_of_run(folder)
    with StageDisplay(enabled=not (quiet or as_json)) as display:
        report = verify_plan(
            tpg,
            base_error=off,
            deviation=away,
            progress=partial(display, "verification"),
        )
        standing = audit_standing_states(tpg, display, engine) if adversary else None
    ok = report.ok and not (standing and standing.violations)
    if as_json:
        print_json(_content(ok, report, standing))
    elif not quiet:
        for problem in report.problems:
            typer.echo(problem.message)
        violations = standing.violations if standing else ()
        for state, violation in violations:
            what = f"{violation.first} and {violation.second} overlap by "
            what += f"{1000 * violation.depth_m:.2f} mm"
            if violation.kind != "contact":
                what = f"{violation.kind} of {violation.first}: {violation.second} "
                what += violation.detail
            typer.echo(
                f"if {state.robot} stops {'after' if state.at_end else 'before'} the motion of "
                f"node {state.node}: {what}"
            )
        failed = []
        for what, words, survived in (
            ("base errors", "errors of bases", report.survived),
            ("deviations of skills", "deviations of skills", report.deviated),
        ):
            if survived is not None:
                _echo_survived(what, survived)
                failed += [] if survived.ok else [words]
        verdict = "safe for any delays" if ok else "not safe"
        if failed and not (report.problems or violations):
            verdict = f"safe for any delays, but not for these {' and '.join(failed)}"
        stops = (
            f", {standing.states} standing states audited with {standing.engine}"
            if standing
            else ""
        )
        typer.echo(
            f"{folder}: {verdict} ({len(report.problems)} problems; {report.pairs_checked} "
            f"pairs that may happen at once, robots {_millimetres(report)}{stops})"
        )
    return ExitCode.COMPLETED if ok else ExitCode.FAILED


def _millimetres(report: VerificationReport) -> str:
    if math.isfinite(least := report.min_distance_robots_m):
        return f"measured {1000 * least:.2f} mm apart at the closest"
    return "far apart"


def _content(
    ok: bool, report: VerificationReport, standing: AdversaryReport | None
) -> dict[str, object]:
    from twin.host.atomic_files import finite_or_none

    content: dict[str, object] = {
        "ok": ok,
        "pairs_checked": report.pairs_checked,
        "min_distance_robots_m": finite_or_none(report.min_distance_robots_m),
        "min_distance_objects_m": finite_or_none(report.min_distance_objects_m),
        "problems": [{"kind": p.kind, "message": p.message} for p in report.problems],
        "adversary": None,
    }
    if report.survived is not None:
        content["base_error"] = _survived(report.survived)
    if report.deviated is not None:
        content["deviation"] = _survived(report.deviated)
    if standing is not None:
        content["adversary"] = {
            "states": standing.states,
            "engine": standing.engine,
            "min_distance_m": finite_or_none(standing.min_distance_m),
            "violations": [
                {**asdict(state), **asdict(violation)}
                for state, violation in standing.violations
            ],
        }
    return content


def _echo_survived(what: str, survived: SurvivedErrors) -> None:
    """Print the tolerated errors of some kind, and what limits them."""
    sides = {"between robots": survived.robots, "with what rests": survived.rest}
    for where, side in sides.items():
        much = "at least " if side.limiting is None else ""
        typer.echo(
            f"{where}: {what} up to {much}{_format_pose_error(survived.largest(side))} survived"
            + (f"; limited by {side.limiting}" if side.limiting else "")
        )


def _format_pose_error(error: PoseError) -> str:
    return f"{1000 * error.m:.3g} mm and {math.degrees(error.rad):.3g} deg"


def _survived(survived: SurvivedErrors) -> dict[str, object]:
    out: dict[str, object] = {"ok": survived.ok, **asdict(survived.error)}
    for name, side in (("robots", survived.robots), ("rest", survived.rest)):
        limiting = side.limiting
        out[name] = {
            "share": side.share,
            "largest": asdict(survived.largest(side)),
            "limiting": None
            if limiting is None
            else {**asdict(limiting), "margin_m": limiting.margin_m},
        }
    return out


def read_pose_error(text: str, option: str) -> PoseError:
    """Parse a pose error such as ``1mm,0.1deg``: a length, an angle, or both.

    Raises:
        RequestError: it names none.
    """
    from planning.cell.workcell import PoseError

    found: dict[str, float] = {}
    for item in text.split(","):
        match = re.fullmatch(r"\s*([0-9.]+(?:e-?[0-9]+)?)\s*([a-z]+)\s*", item)
        kind, unit = _UNITS.get(match[2] if match else "", ("", 0.0))
        try:
            value = float(match[1]) * unit if match else 0.0
        except ValueError:
            value = 0.0
        if not kind or kind in found or value <= 0.0:
            raise RequestError(
                f"{option}: {item.strip()!r} in {text!r} is no length or angle above 0, or"
                " not the first; as 1mm,0.1deg",
                choices=tuple(_UNITS),
            )
        found[kind] = value
    return PoseError(**found)
