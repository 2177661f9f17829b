"""The function ``twin.audit``: check of an executed run by code that the planner does not use."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from scheduling.graph.plan_files import save_plan
from twin.audits.audit import AuditReport
from twin.audits.run_auditor import audit_execution
from twin.audits.worlds.engines import engine_named
from twin.host.arguments import checks_arguments
from twin.host.progress import Report, report_nothing
from twin.recorders.run_tables import write_motion
from twin.trial.loaded_scenario import PathOrName
from twin.trial.run_result import RunResult, read_run

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class Audit:
    """Result of an audit.

    Attributes:
        report: distances and violations.
    """

    report: AuditReport

    def __repr__(self) -> str:
        """Return a one-line description."""
        found = len(self.report.violations)
        return f"<audit: {f'{found} violations' if found else 'clean'}>"

    @property
    def clean(self) -> bool:
        """True if nothing was found."""
        return not self.report.violations

    @property
    def min_distance_m(self) -> float:
        """Least distance of any two robots with what they carry; infinite with fewer than two [m]."""
        return self.report.min_distance_m

    @property
    def violations(self) -> pa.Table:
        """Table of violations: kind, first, second, t_start_s, t_end_s, depth_m, detail."""
        import pyarrow as pa

        rows = self.report.violations
        return pa.table(
            {
                "kind": pa.array([row.kind for row in rows], pa.string()),
                "first": pa.array([row.first for row in rows], pa.string()),
                "second": pa.array([row.second for row in rows], pa.string()),
                "t_start_s": pa.array([row.t_start for row in rows], pa.float64()),
                "t_end_s": pa.array([row.t_end for row in rows], pa.float64()),
                "depth_m": pa.array([row.depth_m for row in rows], pa.float64()),
                "detail": pa.array([row.detail for row in rows], pa.string()),
            }
        )

    def _repr_html_(self) -> str:
        from twin.host.cards import card

        report = self.report
        rows = [
            ("configurations", str(report.configurations)),
            ("least distance of two robots", f"{1000 * report.min_distance_m:.1f} mm"),
            ("measured with", report.engine),
        ]
        rows += [
            (v.kind, f"{v.first} - {v.second}, from {v.t_start:.3f} s {v.detail}")
            for v in report.violations
        ]
        count = len(report.violations)
        verdict = f"{count} violation{'s' * (count != 1)}" if count else "clean"
        return card(f"Audit: {verdict}", rows)


def _is_whole(run: RunResult) -> bool:
    """Return whether a run completed with all objects at their goals."""
    operation = run.summary.get("operation") or {}
    return run.outcome == "completed" and bool(operation.get("whole", True))


@checks_arguments
def audit(
    run: RunResult | PathOrName,
    *,
    engine: str | None = None,
    progress: Report = report_nothing,
) -> Audit:
    """Check an executed run with code that the planner does not use.

    Args:
        run: a run, or its folder.
        engine: pybullet or coal; by default PyBullet where it is installed, else coal.
        progress: receives the progress of the audit.

    Raises:
        RequestError: the engine is not installed.
        OutputError: the folder is that of no run, or a file in it is damaged.
    """
    chosen = engine_named(engine)
    judged = run if isinstance(run, RunResult) else read_run(run)

    def audited(folder: Path) -> Audit:
        return Audit(
            audit_execution(
                judged.sections,
                folder,
                ordered="open-loop" not in judged.policy,
                finished=_is_whole(judged),
                engine=chosen,
                progress=progress,
            )
        )

    if judged.folder is not None:
        return audited(judged.folder)
    with TemporaryDirectory() as name:
        folder = Path(name)
        save_plan(judged.tpg, folder)
        assert judged.record is not None
        write_motion(folder, judged.tpg, judged.record)
        return audited(folder)
