"""Registry of the exchangeable components of the program: kinds of assembly, commands, export formats and others.

The core loads these components through the registry and does not import them directly. Each group lists the entries of
this program by name, as ``module:attribute``. Installed packages add entries through entry points of the group
``assembly_twin.<group>``; scripts add them with ``add``. An entry is imported when it is loaded. An entry of this
program is left out if its module is not installed.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from typing import Any

from planning.errors import RequestError

AUDIT = "audit"
"""The auditor whose findings the summary of a run has."""


class UnknownEntryError(RequestError):
    """No entry of a group has the requested name.

    Attributes:
        group: name of the group.
        entry: the requested name.
    """

    def __init__(self, group: str, entry: str, choices: tuple[str, ...]) -> None:
        self.group, self.entry = group, entry
        super().__init__(f"unknown {group} entry {entry!r}", choices=choices)


class Group:
    """Named entries of one type, such as the export formats.

    Attributes:
        name: name of the group.
        own: target of each entry of this program, ``module:attribute``.
    """

    def __init__(self, name: str, own: Mapping[str, str]) -> None:
        self.name = name
        self.own = dict(own)
        self._added: dict[str, Any] = {}

    def __contains__(self, entry: object) -> bool:
        return entry in self.names()

    def names(self) -> tuple[str, ...]:
        """Return the names of all entries: those of this program first, in the order of the list."""
        return tuple(dict.fromkeys((*self._present, *self._installed, *self._added)))

    def load(self, entry: str) -> Any:
        """Return the object of an entry, imported on first use.

        Raises:
            UnknownEntryError: the group has no such entry.
        """
        if entry in self._added:
            return self._added[entry]
        if entry in self._present:
            module, _, attribute = self.own[entry].partition(":")
            return getattr(import_module(module), attribute)
        if entry in self._installed:
            return self._installed[entry].load()
        raise UnknownEntryError(self.name, entry, self.names())

    def require(self, entry: str, needed_for: str) -> Any:
        """Return the object of an entry that something cannot do without.

        Args:
            entry: its name.
            needed_for: what needs it, such as ``"an audit"``.

        Raises:
            RequestError: it is not installed.
        """
        if entry in self:
            return self.load(entry)
        target = self.own.get(entry, entry).partition(":")[0]
        raise RequestError(f"{needed_for} needs {target}, which is not installed")

    def load_all(self) -> dict[str, Any]:
        """Return the object of every entry by its name."""
        return {entry: self.load(entry) for entry in self.names()}

    def add(self, entry: str, found: Any) -> None:
        """Add an entry for this process.

        Raises:
            RequestError: the group has an entry of that name.
        """
        if entry in self:
            raise RequestError(f"the {self.name} entry {entry!r} exists already")
        self._added[entry] = found

    @cached_property
    def _present(self) -> tuple[str, ...]:
        return tuple(
            entry
            for entry, target in self.own.items()
            if _is_installed(target.partition(":")[0])
        )

    @cached_property
    def _installed(self) -> Mapping[str, EntryPoint]:
        found = entry_points(group=f"assembly_twin.{self.name}")
        return {point.name: point for point in found if point.name not in self.own}


def _is_installed(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # a package above it is not there
        return False


KINDS = Group(
    "kinds",
    {
        "lego": "twin.kinds.lego.kind:LegoKind",
        "assembly": "twin.kinds.parts.kind:PartKind",
        "goals": "twin.kinds.goals.kind:GoalsKind",
        "construction": "twin.kinds.construction.kind:ConstructionKind",
    },
)
"""Kinds of assembly, by the ``kind`` of the assembly section of a scenario."""

CHECKS = Group(
    "checks",
    {
        "lego": "twin.kinds.lego.checks:LegoChecks",
        "assembly": "twin.kinds.parts.checks.checks:PartChecks",
        "goals": "twin.kinds.goals.checks:GoalsChecks",
        "construction": "twin.kinds.construction.checks:ConstructionChecks",
    },
)
"""Checks of a scenario that depend on its kind of assembly, by the name of the kind."""

EXPECTATIONS = Group(
    "expectations",
    {
        "lego": "twin.kinds.lego.expected:expectations_of",
        "assembly": "twin.kinds.parts.expected:expectations_of",
        "construction": "twin.kinds.construction.expected:expectations_of",
    },
)
"""Expectations on a run that its audit checks, by kind of assembly: called with the kind and the cell section."""

SECTIONS = Group("sections", {"explore": "twin.explorations.section:ExploreSection"})
"""Optional top-level sections of a scenario, by their key; they do not affect runs."""

COMMANDS = Group(
    "commands",
    {
        "init": "twin.beginnings.commands:init",
        "scenarios": "twin.commands.scenarios:scenarios",
        "plan": "twin.commands.plan:plan",
        "run": "twin.commands.run:run",
        "operate": "twin.operations.commands:operate",
        "drive": "twin.live.commands:drive",
        "validate": "twin.commands.scenarios:validate",
        "check": "twin.checks.commands:check",
        "sequence": "twin.kinds.lego.sequence:sequence",
        "compare": "twin.studies.compare_command:compare",
        "study": "twin.studies.commands:study",
        "explore": "twin.explorations.commands:explore",
        "view": "twin.view.commands:view",
        "replay": "twin.rerun.commands:replay",
        "fit": "twin.fit.commands:fit",
        "resume": "twin.commands.run:resume",
        "follow": "twin.follow.commands:follow",
        "export": "twin.exports.commands:export",
        "verify": "twin.verification.commands:verify",
        "judge": "twin.judge.commands:judge",
        "robots": "twin.checks.commands:robots",
        "schema": "twin.commands.scenarios:schema",
        "doctor": "twin.doctor.commands:doctor",
        "cluster": "twin.cluster.commands:cluster",
        "import": "twin.commands.imports:app",
    },
)
"""Commands of the program in the order of its help: functions for typer, or programs of several commands."""

IMPORTS = Group(
    "imports",
    {
        "apex-mr": "twin.kinds.lego.imports:import_apex_mr_task",
        "bricks": "twin.kinds.lego.imports:import_brick_list",
        "ldraw": "twin.kinds.lego.imports:import_ldraw",
        "step": "twin.cad.commands:import_step",
    },
)
"""Formats that a scenario can be created from: functions for typer, the commands of ``twin import``."""

EXPORTS = Group(
    "exports",
    {
        "csv": "twin.exports.tables:csv_files",
        "parquet": "twin.exports.tables:parquet_files",
        "perfetto": "twin.exports.perfetto:perfetto_files",
        "joint-trajectory": "twin.exports.joint_trajectory:joint_trajectory_files",
        "joint-csv": "twin.exports.joint_csv:joint_csv_files",
        "mcap": "twin.exports.ros.mcap_file:mcap_files",
        "graphml": "twin.exports.graphs:graphml_files",
        "task-graph": "twin.exports.graphs:task_graph_files",
        "open-plan": "twin.exports.open_plan:open_plan_files",
        "ldraw": "twin.kinds.lego.ldraw:ldraw_files",
    },
)
"""Formats that a run can be written in: functions of a run that return the content of each file by its name."""

HOOKS = Group(
    "hooks",
    {
        "check": "twin.checks.api:check",
        "activities": "twin.activities.activities:activities_table",
        "audit engine": "twin.audits.engine_report:report_engine",
        "cut of a run": "twin.operations.run_cut:cut_run",
        "line": "twin.throughput.throughput:line_summary",
        "plan warnings": "twin.warnings.plan_warnings:plan_warnings",
        "live scene": "twin.view.live_scene:live_scene",
        "driven cell": "twin.page.driven:DrivenCell",
        "plan of a study": "twin.studies.best_plan:best_plan",
        "design of an exploration": "twin.explorations.design_scenario:design_of",
        "design": "twin.explorations.designs:begin_named_design",
        "corners": "scheduling.corners.corners:round_corners",
        "synchronous plan": "scheduling.synchronous.synchronous_plan:plan_synchronous",
        "assignment search": "planning.assignment_search.search:search_assignments",
        "makespan bound": "planning.makespan_bound.makespan_bound:makespan_bound_s",
        "other arms": "twin.shared_bodies.arms:without_other_arms",
        "shared bodies": "twin.shared_bodies.fixtures:mount_on_shared_bodies",
        "described robot": "planning.vendor_files.vendor_files:described_robot",
        "description file": "planning.vendor_files.xacro_file:description_file",
    },
)
"""Functions of optional parts that the core calls where they are installed."""

RECOVERIES = Group(
    "recoveries",
    {"construction": "twin.kinds.construction.recovery:ConstructionRecovery"},
)
"""Recovery planners by kind of assembly; other kinds share one for steps."""

FIGURES = Group(
    "figures",
    {
        "cell": "twin.checks.picture:scenario_figure",
        "run": "twin.drawing.gantt:gantt_figure",
        "products": "twin.throughput.product_gantt:run_products_figure",
    },
)
"""Pictures for notebooks and runs; ``cell`` is called with a scenario and the folder of its relative paths, ``run``
with the graph, the record and the events of a run, its ``title`` and the name of its ``plan``, ``products`` with
graph, record and what the hook ``line`` asks; it may return None."""

EXECUTORS = Group(
    "executors",
    {
        "simulated": "twin.trial.executor:SimulatedExecutor",
        "operated": "twin.operations.executor:OperatedExecutor",
        "live": "twin.live.executor:LiveExecutor",
    },
)
"""Executors of the plan of a run, by its header; see ``twin.trial.executor``."""

AUDITORS = Group("auditors", {AUDIT: "twin.audits.run_auditor:RunAuditor"})
"""Auditors of runs; see ``twin.trial.auditor``."""

RECORDERS = Group("recorders", {"rerun": "twin.rerun.recorder:record_run"})
"""Recordings of runs that have ended, called with folder, graph, record, events and the scenario's name."""

PLANNERS = Group("planners", {"rrt-connect": "planning.motion.transit:RrtConnect"})
"""Transit planners, by ``planning.planner`` of a scenario: called with lower and upper joint limits of a robot, shape
(n,), and its speed model; return a ``planning.motion.transit.TransitPlanner``."""

DURATIONS = Group(
    "durations",
    {
        "fixed": "twin.durations.bounded:Fixed",
        "uniform": "twin.durations.bounded:Uniform",
        "triangular": "twin.durations.bounded:Triangular",
        "pert": "twin.durations.bounded:Pert",
        "normal": "twin.durations.normal:TruncatedNormal",
        "lognormal": "twin.durations.lognormal:Lognormal",
        "exponential": "twin.durations.lifetimes:Exponential",
        "gamma": "twin.durations.lifetimes:Gamma",
        "weibull": "twin.durations.lifetimes:Weibull",
        "empirical": "twin.durations.measured:Empirical",
        "packaged": "twin.durations.measured:Packaged",
        "shifted": "twin.durations.composed:Shifted",
        "retries": "twin.durations.composed:Retries",
    },
)
"""Distributions of durations, by the ``kind`` of a duration in a scenario: subclasses of
``twin.durations.model.DurationModel``, whose attributes are the keys of the section."""

POLICIES = Group(
    "policies",
    {
        "asynchronous": "twin.engine.dispatch_policies:no_edges",
        "sequential": "scheduling.graph.task_edges:turn_edges",
        "synchronous": "scheduling.graph.barriers:barrier_edges",
        "open-loop": "twin.engine.dispatch_policies:no_edges",
    },
)
"""Dispatch policies, by ``execution.policy`` of a scenario: called with a temporal plan graph; return the further edges
of a ``twin.engine.dispatch_policies.DispatchPolicy``."""

DRIVERS = Group("drivers", {"franka": "twin.drivers.franka:franka_driver"})
"""Drivers of robots within this process, by ``kind`` or by ``name`` of the kind ``registered`` in a drivers file: called
with that section and a placed robot; return a ``twin.drivers.driver.Driver``."""
