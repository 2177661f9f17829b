"""Function ``twin.study``: many replications of a plan under uncertainty, with statistics.

``twin.compare`` (in compare.py) is a study with one plan and one replication per seed, under every policy.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import product, starmap
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planning.errors import RequestError, ScenarioError
from planning.parquet import read_parquet
from twin.api.runs import AnyPlan, planned_scenario
from twin.audits.worlds.engines import engine_named
from twin.host.arguments import checks_arguments
from twin.host.progress import Report, report_nothing
from twin.operations.api import operated_plan, require_operable
from twin.runs.folder import lock_folder, run_folder
from twin.runs.policies import NAMED_POLICIES, OPEN_LOOP, parse_policy_name
from twin.scenario.variations import Variant, Variation, apply_variation
from twin.studies.folder import (
    EDGES,
    REPLICATIONS,
    REPORT,
    TASKS,
    StudyRequest,
    require_no_study,
    require_same_study,
)
from twin.studies.plans import (
    default_policies,
    given_plans,
    operated_policies,
    possible_policies,
    shortcut_budget,
    with_baselines,
)
from twin.studies.replications.executors import check_cluster, open_executor
from twin.studies.replications.experiment import Experiment
from twin.studies.replications.statistics import Interval, Precision
from twin.studies.report.report import write_report
from twin.studies.study import StudyResult, start_study
from twin.studies.study import resume_study as resumed
from twin.trial.loaded_scenario import AnyScenario, PathOrName, load
from twin.trial.plan_result import PlanResult

if TYPE_CHECKING:
    import pyarrow as pa

    from twin.cluster.address import Cluster

Vary = Mapping[str, Iterable[Any]] | Iterable[Variation]
"""Values by key, such as ``{"skills.pick.scale": [1, 1.5, 2]}``."""


@dataclass(frozen=True)
class Study:
    """A finished study in its folder.

    Attributes:
        result: all that is known of it.
    """

    result: StudyResult

    def __repr__(self) -> str:
        """Return a one-line description."""
        own = self.result.summary
        size = f"{len(own.cells)} policies and variants"
        return f"<study of {own.scenario!r}: {size}, in {self.folder}>"

    @property
    def folder(self) -> Path:
        """Folder of its files."""
        return self.result.folder

    @property
    def report(self) -> Path:
        """The page with all figures and tables, which needs no network."""
        return self.folder / REPORT

    @property
    def summary(self) -> Mapping[str, Any]:
        """All figures, the content of ``summary.json``."""
        return self.result.summary.content()

    @property
    def cells(self) -> pa.Table:
        """Table with one row per policy and variant: mean and quantiles of the makespan, with bounds."""
        import pyarrow as pa

        rows = []
        for cell in self.result.summary.cells:
            row = {"policy": cell.policy, **cell.variant, "n": cell.replications}
            row |= _bounds("makespan_s", cell.makespan_s)
            row |= _bounds("makespan_p50_s", cell.makespan_p50_s)
            row |= _bounds("makespan_p90_s", cell.makespan_p90_s)
            rows.append(row)
        return pa.Table.from_pylist(rows)

    @property
    def ranking(self) -> pa.Table:
        """Table with one row per policy and layout, the fastest first: mean, and difference to the first."""
        import pyarrow as pa

        rows = []
        for row in self.result.summary.ranking:
            found = {"rank": row.rank, "policy": row.policy, **row.variant}
            found |= {"mean_s": row.mean_s, **_bounds("behind_s", row.behind_s)}
            rows.append(found)
        return pa.Table.from_pylist(rows)

    @property
    def refused(self) -> pa.Table:
        """Table with one row per layout without a plan: its values, and the reason."""
        import pyarrow as pa

        rows = [
            {**item.layout, "reason": item.reason}
            for item in self.result.summary.refused
        ]
        return pa.Table.from_pylist(rows)

    @property
    def replications(self) -> pa.Table:
        """Table with one row per replication: policy, varied inputs, outcome, makespan, waits."""
        return self._table(REPLICATIONS)

    @property
    def tasks(self) -> pa.Table:
        """Table with one row per task of each policy and variant: completion, frequency of being critical."""
        return self._table(TASKS)

    @property
    def edges(self) -> pa.Table:
        """Table with one row per type-2 edge: its tasks, cause, frequency of being critical."""
        return self._table(EDGES)

    def _table(self, name: str) -> pa.Table:
        return read_parquet(self.folder / name)

    def _repr_html_(self) -> str:
        from twin.host.cards import card, run_picture
        from twin.studies.report.page_tables import difference_list, makespans_table

        table = makespans_table(self.result.summary)
        table += difference_list(self.result.summary)
        chart = run_picture(self.folder / "makespan.png")
        return table + chart + card("Report", [("page", str(self.report))])


def _bounds(key: str, found: Interval | None) -> dict[str, float | None]:
    """Return an estimate and the bounds of its interval as entries of a row."""
    content = {} if found is None else found.content()
    sides = {f"{key}_{side}": content.get(side) for side in ("low", "high")}
    return {key: content.get("estimate"), **sides}


@checks_arguments
def study(
    plan: AnyPlan,
    vary: Vary = (),
    *,
    replications: int | None = None,
    precision: Precision | None = None,
    policies: Sequence[str] = (),
    deadline_s: float | None = None,
    antithetic: bool = False,
    sobol: int = 0,
    audited: int = 20,
    audit_engine: str | None = None,
    shortcuts: int | None = None,
    operate: bool | None = None,
    failures: float | None = None,
    workers: int | None = 0,
    cluster: Cluster | None = None,
    out: PathOrName | None = None,
    progress: Report = report_nothing,
) -> Study:
    """Replicate a plan under uncertainty: makespans with confidence intervals.

    All policies and variants see the same draws, so their differences are sharp.

    Args:
        plan: a scenario, or the path of its file, of which the plans of the policies are made;
            or a plan that is there.
        vary: values by key; every combination is studied. Keys are those of
            ``LoadedScenario.varied``.
        replications: of every policy and variant; by default until the precision is reached.
        precision: when there are enough replications, and the confidence of all intervals.
        policies: sequential, synchronous, 'synchronous + TPG', 'synchronous + TPG + shortcuts',
            asynchronous, 'asynchronous + shortcuts' or open-loop, of which there may be several; by
            default sequential, and what twin run executes.
        deadline_s: how likely is the run over by then [s]?
        antithetic: draw replications in mirrored pairs.
        sobol: points of the sample for Sobol indices, such as 128; 0 for none.
        audited: replications that are checked for collisions: open-loop ones, and all where bases are off.
        audit_engine: collision engine of the audit, pybullet or coal; by default PyBullet where it
            is installed, else coal.
        shortcuts: most shortcuts tried on each plan, in place of the scenario's.
        operate: replan the rest where a skill fails for good or a robot is out, as twin operate
            does, of the plan that it executes; by default where parts may be rejected (``then: rework`` or
            ``scrap``) or rush orders come in, and the plans of the policies can be replanned. False leaves
            rush orders out.
        failures: with it, probability that an attempt at any skill fails, a fifth of which lose the
            object; for skills without a rate in the scenario.
        workers: processes; 0 for none besides this one, None for one per core. A script that asks
            for some must be importable: its main code must be under ``if __name__ == "__main__":``.
        cluster: whose workers do it instead.
        out: folder for the results; by default ``logs/study-<scenario>-<UTC time>``.
        progress: receives the progress of each stage.

    Raises:
        ScenarioError: the file is not valid, or a varied input does not fit.
        RequestError: the request contradicts itself, the folder holds a study, or an operated plan
            cannot be replanned.
        TwinError: the scenario cannot be planned; see ``twin.plan``.
    """
    engine = engine_named(audit_engine) if audit_engine else None
    if cluster is not None:
        check_cluster(cluster)  # now, not after the planning
    case = planned_scenario(plan)
    names = tuple(map(parse_policy_name, policies))
    varied = starmap(Variation.of, vary.items()) if isinstance(vary, Mapping) else vary
    combined = combine_variations(list(varied))
    place, plans, saved = None if out is None else Path(out), None, ""
    if isinstance(plan, PlanResult) and shortcuts is not None:
        raise RequestError("shortcuts are for planning, not for a plan that is there")
    motions = None
    own_cases = (apply_variation(case.sections, variant) for variant in combined)
    if operate is None and any(
        own.execution.rejecting or own.kind.rush_s() for own in own_cases
    ):
        with suppress(RequestError):
            require_operable(plan, case, names, combined)
            operate = True
    if operate:
        require_operable(plan, case, names, combined)
        require_no_study(place, case.sections)
        plan = operated_plan(plan, combined, shortcuts, failures, progress)
        case, names = plan.scenario, names or operated_policies(plan)[-1:]
        plans, motions = given_plans(plan, names), plan.motions
    elif failures is not None:
        raise RequestError("failures are for what is operated: give operate, too")
    elif isinstance(plan, PlanResult):
        own = NAMED_POLICIES.keys() - {OPEN_LOOP}
        possible = [p for p in possible_policies(plan) if p in own]
        usual = with_baselines(possible[-1])
        names = names or tuple(policy for policy in usual if policy in possible)
        plans = given_plans(plan, names)
        saved = "" if plan.folder is None else str(plan.folder.resolve())
    experiment = Experiment(
        policies=names or default_policies(case.sections),
        variants=combined,
        replications=replications,
        precision=precision or Precision(),
        antithetic=antithetic,
        audited=audited,
        audit_engine=engine,
    )
    budget = shortcut_budget(case.sections) if shortcuts is None else shortcuts
    request = StudyRequest(
        *(case.sections, case.folder, experiment, budget, deadline_s, sobol, saved),
        operated=bool(operate),
    )
    require_no_study(place, request.scenario)
    executor = partial(open_executor, workers, cluster)
    with run_folder(place, f"study-{case.name}") as folder:
        result = start_study(request, folder, executor, progress, plans, motions)
    write_report(result, progress)
    return Study(result)


@checks_arguments
def resume_study(
    folder: PathOrName,
    scenario: AnyScenario | None = None,
    *,
    workers: int | None = 0,
    cluster: Cluster | None = None,
    progress: Report = report_nothing,
) -> Study:
    """Resume an interrupted study; nothing is computed twice.

    A study that has come to its end is read.

    Args:
        folder: of the study.
        scenario: that it must be of, None for any.
        workers: see study.
        cluster: whose workers do it instead.
        progress: receives the progress of each stage.

    Raises:
        OutputError: the folder is not one of a study that got as far as its plans.
        RequestError: it is one of another scenario.
    """
    if cluster is not None:
        check_cluster(cluster)
    place = Path(folder)
    if scenario is not None:
        require_same_study(place, load(scenario).sections)
    with lock_folder(place):
        result = resumed(place, partial(open_executor, workers, cluster), progress)
    write_report(result, progress)
    return Study(result)


def combine_variations(variations: Sequence[Variation]) -> tuple[Variant, ...]:
    """Return every combination of values, the last key changing fastest; one empty if none.

    Raises:
        ScenarioError: a key is varied twice.
    """
    keys = [variation.key for variation in variations]
    for key in keys:
        if keys.count(key) > 1:
            raise ScenarioError(f"{key} is varied twice")
    return tuple(
        dict(zip(keys, values, strict=True))
        for values in product(*(v.values for v in variations))
    )
