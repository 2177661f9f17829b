"""What is done with one scenario: check, plan, simulate or run, audit, and look at it again."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from planning.errors import OutputError, RequestError, ScenarioError
from twin.check.check import CheckReport, check_scenario, require_checked
from twin.host.arguments import checks_arguments
from twin.host.guard import replacing
from twin.host.progress import Report, report_nothing
from twin.operate.plan_from_run import RunMoment, plan_from_run
from twin.recorders.observers import MemoryRecorder
from twin.recorders.rerun.viewer import open_viewer, render_stills
from twin.run.events import POLICIES
from twin.run.folder import RECORDING, run_folder
from twin.run.policies import NAMED_POLICIES, policy_named
from twin.scenario.variations import plain_key
from twin.trial.auditor import load_auditor
from twin.trial.loaded_scenario import AnyScenario, LoadedScenario, PathOrName, load
from twin.trial.plan_result import PlanResult, require_plan_of, scenario_of_run
from twin.trial.planning import plan_scenario
from twin.trial.run_result import RunResult
from twin.trial.simulation import execute
from twin.trial.trial import run_plan_to_folder

if TYPE_CHECKING:
    import pyarrow as pa

CHECKING = "check of the cell"
"""Name of the stage for progress displays."""


@dataclass(frozen=True)
class Check:
    """What the check of a scenario found.

    Attributes:
        scenario: what was checked.
        report: the findings with their places in the file.
    """

    scenario: LoadedScenario
    report: CheckReport

    def __repr__(self) -> str:
        """Return what it is in a line."""
        errors, warnings = len(self.report.errors), len(self.report.warnings)
        counts = f"{errors} errors, {warnings} warnings"
        return f"<check of {self.scenario.name!r}: {counts}>"

    @property
    def ok(self) -> bool:
        """True if nothing makes every plan impossible or false; there may be warnings."""
        return not self.report.errors

    @property
    def errors(self) -> tuple[str, ...]:
        """What makes every plan impossible or false, each with its line."""
        return self.report.messages(self.report.errors)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What is doubtful, each with its line."""
        return self.report.messages(self.report.warnings)

    @property
    def fits(self) -> tuple[Mapping[str, Any], ...]:
        """How parts fit where they are put: play, what is beside them, and the chances of robots."""
        return tuple(fit.content() for fit in self.report.fits)

    @property
    def findings(self) -> pa.Table:
        """Errors and warnings: level, line, column, key and message."""
        import pyarrow as pa

        names = ("level", "line", "column", "key", "message")
        rows: list[dict[str, Any]] = self.report.content()["findings"]
        types = (pa.string(), pa.int64(), pa.int64(), pa.string(), pa.string())
        return pa.table(
            {
                name: pa.array([row[name] for row in rows], kind)
                for name, kind in zip(names, types, strict=True)
            }
        )

    def require_ok(self) -> None:
        """Raise InvalidScenarioError with the errors, if there are any."""
        require_checked(self.report)

    def draw(self, folder: Path) -> Path:
        """Draw the cell into a folder, and return the picture ``cell.png``."""
        from twin.check.picture import draw_cell

        return draw_cell(self.report.subject, folder)

    def _repr_html_(self) -> str:
        from twin.drawing.markup import card

        verdict = "nothing found" if not self.report.findings else ""
        rows = [("error", words) for words in self.errors]
        rows += [("warning", words) for words in self.warnings]
        rows += [("fit", fit.words) for fit in self.report.fits]
        return card(f"Check of {self.scenario.name}: {verdict}", rows)


@checks_arguments
def check(scenario: AnyScenario, *, progress: Report = report_nothing) -> Check:
    """Look at a cell before planning: overlaps, reach, HOME, grippers, tool frames and speeds.

    Errors make every plan impossible or false, and end the command with code 2; warnings do not.

    Args:
        scenario: a scenario, or the path of its file.
        progress: told how far each stage has come.

    Raises:
        InvalidScenarioError: the file is not valid.
        RobotModelError: a robot description cannot be used.
    """
    loaded = load(scenario)
    progress(CHECKING, 0, 1)
    report = check_scenario(loaded.sections, loaded.document, loaded.folder)
    progress(CHECKING, 1, 1)
    return Check(loaded, report)


Begun = Callable[[Check, Path], None]
"""Told of the check and of the folder of a run, before it is planned."""


AnyPlan = AnyScenario | PlanResult
"""A plan, or the scenario that is to be planned, or the path of its file."""


@checks_arguments
def plan(
    scenario: AnyScenario | None = None,
    *,
    world: RunMoment | str | None = None,
    out_of_service: Sequence[str] = (),
    progress: Report = report_nothing,
) -> PlanResult:
    """Check and plan a scenario, or what is left of it from the middle of a run.

    Args:
        scenario: a scenario, or the path of its file; by default that of the run.
        world: where the plan begins, as ``runs/cliff@42``: the folder of a run, and seconds since its
            start; by default with all robots at HOME and all objects at their starts. Each robot goes on
            to the first border at which it is at rest and within no skill; the plan begins there.
        out_of_service: robots that do nothing from then on, and stand where they are.
        progress: told how far each stage has come.

    Raises:
        InvalidScenarioError: the file is not valid, or the check of the cell finds an error.
        RequestError: something cannot go on from there, or nothing is left to do.
        TwinError: the assembly cannot be built as it is, or no plan was found.
    """
    moment = RunMoment.named(world) if isinstance(world, str) else world
    if scenario is None:
        if moment is None:
            raise RequestError("say what to plan: a scenario, or a time of a run")
        scenario = scenario_of_run(moment.run.files)
    if moment is None and out_of_service:
        raise RequestError(
            "robots are out of service from a time of a run on: name one, such as runs/cliff@0; for plans"
            " from the start leave them out of the scenario"
        )
    checked = check(scenario, progress=progress)
    checked.require_ok()
    if moment is None:
        return _plan_checked(checked, progress)
    made = plan_from_run(checked.scenario, moment, out_of_service, progress)
    return replace(made, warnings=checked.warnings, fits=checked.fits)


def _plan_checked(checked: Check, progress: Report) -> PlanResult:
    """Plan a scenario whose check found no errors."""
    loaded = checked.scenario
    made = plan_scenario(loaded.sections, loaded.folder, progress)
    return replace(made, scenario=loaded, warnings=checked.warnings, fits=checked.fits)


def scenario_of(source: AnyPlan) -> LoadedScenario:
    """Return the scenario of a plan, of a file, or one that was loaded before."""
    return source.scenario if isinstance(source, PlanResult) else load(source)


def _planned(source: AnyPlan, progress: Report) -> PlanResult:
    """Return a plan as it is, and make one of anything else."""
    return source if isinstance(source, PlanResult) else plan(source, progress=progress)


@checks_arguments
def simulate(
    plan: AnyPlan,
    values: Mapping[str, Any] | None = None,
    *,
    seed: int | None = None,
    policy: str | None = None,
    progress: Report = report_nothing,
) -> RunResult:
    """Execute a plan once in the twin, and write nothing.

    Args:
        plan: the plan; a scenario, or the path of its file, is planned first.
        values: other values at keys of the execution section, such as
            ``{"stalls.rate_per_h": 60}``; see ``LoadedScenario.varied``.
        seed: of the draws, in place of the scenario's.
        policy: how nodes are released, in place of the scenario's: asynchronous, sequential,
            synchronous or open-loop.
        progress: told how far each stage of planning has come.

    Raises:
        ScenarioError: a value does not fit.
        RequestError: a value would need another plan.
        DeadlockError: no robot could go on.
        TwinError: there is no plan; see ``twin.plan``.
    """
    ready = _with_values(_planned(plan, progress), values or {}, seed, policy)
    case, memory = ready.scenario, MemoryRecorder()
    record = execute(case.sections, ready.tpg, case.folder, recorders=(memory,))
    return RunResult(plan=ready, history=memory.events, record=record)


@checks_arguments
def run(
    plan: AnyPlan,
    *,
    out: PathOrName | None = None,
    recording: bool = True,
    audit: bool = True,
    audit_engine: str | None = None,
    begun: Begun | None = None,
    progress: Report = report_nothing,
) -> RunResult:
    """Check and plan a scenario, execute it in the twin, audit it, and write everything.

    Args:
        plan: a scenario, or the path of its file; a plan is not made again.
        out: folder for the results; by default ``logs/<scenario>-<UTC time>``.
        recording: write ``run.rrd`` for the viewer.
        audit: check what was executed with code of its own.
        audit_engine: what the audit measures with, pybullet or coal; by default PyBullet where it
            is installed, else coal.
        begun: told of the check and of the folder, before anything that takes long.
        progress: told how far each stage has come.

    Returns:
        The run; what the audit found is in its summary.

    Raises:
        InvalidScenarioError: the file is not valid, or the check of the cell finds an error.
        OutputError: the folder cannot be written to.
        TwinError: there is no plan, or the run broke off; see ``twin.plan``.
    """
    # Now, not after the planning.
    if audit and audit_engine is not None:
        load_auditor(audit_engine)
    ready = plan if isinstance(plan, PlanResult) else None
    case = scenario_of(plan)
    checked = check(case, progress=progress)
    checked.require_ok()
    with run_folder(out, case.name) as folder:
        if begun is not None:
            begun(checked, folder)
        made = ready or _plan_checked(checked, progress)
        return run_plan_to_folder(
            replace(made, warnings=checked.warnings, fits=checked.fits),
            folder,
            recording=recording,
            audit=audit and (audit_engine or True),
            progress=progress,
        )


def _with_values(
    plan: PlanResult, values: Mapping[str, Any], seed: int | None, policy: str | None
) -> PlanResult:
    """Return a plan whose scenario is executed with other values."""
    given = {"seed": seed, "policy": policy}
    values = {plain_key(key): value for key, value in values.items()}
    values |= {key: value for key, value in given.items() if value is not None}
    other = plan.scenario.varied(released(values))
    require_plan_of(plan, other)
    return replace(plan, scenario=other)


def released(values: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return values as they are, and refuse a policy that is no way to release nodes.

    Raises:
        ScenarioError: says how to have what is meant.
    """
    policy = values.get("policy")
    if policy is None or policy in POLICIES:
        return values
    try:
        name = policy_named(str(policy))
    except RequestError:
        message = f"policy: there is no {policy!r}"
        raise ScenarioError(message, choices=POLICIES) from None
    plan, release = NAMED_POLICIES[name]
    raise ScenarioError(
        f"policy {name!r} is {release} of the plan {plan}: give --policy {release}; --shortcuts"
        " and the scenario's coordination say which plan it is"
    )


STILLS = "stills"
"""Folder of pictures beside a recording."""


@checks_arguments
def replay(
    run: RunResult | PathOrName,
    *,
    stills: Sequence[float] = (),
    out: PathOrName | None = None,
) -> tuple[Path, ...]:
    """Look at a run again.

    Without stills and ``out`` this opens the viewer and returns once it is closed. Pictures need
    no display, but a Vulkan driver; a software one does.

    Args:
        run: a run, its folder, or an ``.rrd`` file.
        stills: render pictures at these simulated times instead [s].
        out: folder for the pictures, by default ``stills`` beside the recording; without stills,
            the ``.rrd`` file that is written instead of opening the viewer.

    Returns:
        The files that were written.

    Raises:
        OutputError: there is no recording, or a file cannot be written.
        ViewerError: the viewer or a display is missing; says what to do then.
        RequestError: pictures of a run without a folder need one.
    """
    with TemporaryDirectory() as name:
        recording = _recording(run, Path(name) / RECORDING)
        if stills:
            if out is None and recording.parent == Path(name):
                raise RequestError(
                    "a run without a folder: say where pictures go by out"
                )
            folder = recording.parent / STILLS if out is None else Path(out)
            return tuple(render_stills(recording, stills, folder))
        if out is None:
            open_viewer(recording)
            return ()
        with replacing(Path(out)) as temporary:
            temporary.write_bytes(recording.read_bytes())
        return (Path(out),)


def _recording(run: RunResult | PathOrName, place: Path) -> Path:
    """Return the recording of a run; written to a place where there is none."""
    if not isinstance(run, str | PathLike):
        if run.record is not None and run.folder is None:
            from twin.recorders.rerun.recorder import write_recording

            write_recording(place, run.tpg, run.record, run.history, name=run.name)
            return place
        folder = Path() if run.folder is None else run.folder
    else:
        folder = Path(run)
    found = folder if folder.is_file() else folder / RECORDING
    if not found.is_file():
        reason = (
            f"it has no {RECORDING}" if folder.exists() else "no such file or folder"
        )
        raise OutputError(f"{folder}: nothing to replay, {reason}")
    return found
