"""The function ``twin.explore``: search for the best design of a robot cell."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from planning.errors import RequestError, ScenarioError
from planning.parallel import usable_cores
from twin.cluster.client import ClusterLostError
from twin.document.validation import (
    InvalidScenarioError,
    parse_document,
    validate_document,
)
from twin.explorations.crew import ClusterCrew, Crew, Evaluators
from twin.explorations.dimensions import dimensions_of, vary_section
from twin.explorations.exploration import Exploration
from twin.explorations.finals import ChangeValue, Finalist, Finals
from twin.explorations.folder import (
    SUMMARY,
    ExploreRequest,
    read_request,
    require_free,
    write_request,
)
from twin.explorations.report import write_report
from twin.explorations.section import ExploreSection, explore_section
from twin.explorations.single_changes import (
    SingleChange,
    candidates,
    change_dimensions,
    judge_changes,
    try_changes,
)
from twin.explorations.summary import ExploreSummary, summary_of
from twin.host.arguments import checks_arguments
from twin.host.atomic_files import write_json
from twin.host.progress import Report, report_nothing
from twin.runs.folder import lock_folder, run_folder
from twin.studies.replications.executors import (
    check_cluster,
    open_executor,
    parallelism,
)
from twin.trial.loaded_scenario import AnyScenario, LoadedScenario, PathOrName, load

if TYPE_CHECKING:
    from twin.cluster.address import Cluster


@dataclass(frozen=True)
class Explored:
    """A finished exploration in its folder.

    Attributes:
        folder: of its files.
        request: the request.
        found: the findings.
    """

    folder: Path
    request: ExploreRequest
    found: ExploreSummary

    def __repr__(self) -> str:
        """Return a one-line description."""
        return f"<exploration of {self.request.scenario.name!r} in {self.folder}>"

    @property
    def summary(self) -> Mapping[str, Any]:
        """All figures, the content of ``summary.json``."""
        return self.found.content()


@checks_arguments
def explore(
    scenario: AnyScenario | None = None,
    *,
    vary: Sequence[str] = (),
    single_changes: int | None = None,
    sampler: str | None = None,
    designs: int | None = None,
    seconds: float | None = None,
    replications: int | None = None,
    seed: int | None = None,
    workers: int | None = None,
    cluster: Cluster | None = None,
    resume: PathOrName | None = None,
    out: PathOrName | None = None,
    progress: Report = report_nothing,
) -> Explored:
    """Search among designs of a cell for the best, and estimate its gain.

    What may be different, and what is looked for, is in the section explore of the scenario. Each design
    is checked, then reached for, planned, planned in full and replicated; what is refused says why.

    Args:
        scenario: a scenario, or the path of its file.
        vary: key=low..high, key=a,b,c or key=order, for any key of the scenario; in place of what its
            section explore varies.
        single_changes: search for nothing, but try changes of one key of a scenario that works (a base, a
            feeder, HOME, a grip, an order, a quicker tool), and tell the so many that gain most for
            their effort.
        sampler: tpe, cma-es, nsga-ii or random, in place of the section's.
        designs: how many are tried, in place of the section's.
        seconds: for how long more are tried, in place of the section's [s].
        replications: of each design, in place of the section's.
        seed: of all choices and draws, in place of the scenario's.
        workers: processes; by default one per core. With 1 the same seed finds the same. What a script does
            stands under ``if __name__ == "__main__":``, as processes import it.
        cluster: whose workers evaluate designs instead; files that the scenario names must be in the same
            folder on their machines.
        resume: resume the exploration in this folder; nothing is evaluated twice.
        out: folder for the results; by default ``logs/explore-<scenario>-<UTC time>``.
        progress: receives the progress of each stage.

    Raises:
        ScenarioError: the file is not valid, or a key does not fit.
        RequestError: nothing varies, the folder holds results, or optuna is not installed.
    """
    if cluster is not None:
        check_cluster(cluster)
    count = usable_cores() if workers is None else max(1, workers)
    if resume is not None:
        if vary or sampler or replications or seed is not None or out is not None:
            raise RequestError(
                "a resumed exploration keeps its settings: with --resume give --designs and --seconds only"
            )
        place = Path(resume)
        request = read_request(place)
        now = None if scenario is None else load(scenario).sections
        if now is not None and now.changed(explore=None) != request.scenario:
            raise RequestError(
                f"{place} holds an exploration of scenario {request.scenario.name!r} as it was"
                " then, not of this one"
            )
        with lock_folder(place), _evaluators(place, request, count, cluster) as crew:
            return _run(place, request, crew, designs, seconds, progress)
    if scenario is None:
        raise RequestError("give a scenario file, or --resume DIR")
    case = load(scenario)
    given: dict[str, Any] = {
        "sampler": sampler,
        "designs": designs,
        "seconds": seconds,
        "replications": replications,
    }
    given = {key: value for key, value in given.items() if value is not None}
    section = resolve_request(case, vary, given, single=single_changes is not None)
    folder = None if out is None else Path(out)
    require_free(folder)
    # Before anything is written.
    dimensions_of(case.sections, section, case.document, case.folder)
    drawn = case.varied({} if seed is None else {"seed": seed})
    singles = single_changes or 0
    bare = drawn.sections.changed(explore=None)
    request = ExploreRequest(bare, case.folder, section, singles)
    with run_folder(folder, f"explore-{case.name}") as place:
        write_request(place, request)
        with _evaluators(place, request, count, cluster) as crew:
            return _run(place, request, crew, None, None, progress)


def resolve_request(
    case: LoadedScenario,
    vary: Iterable[str],
    given: Mapping[str, Any],
    *,
    single: bool = False,
) -> ExploreSection:
    """Return the request: the scenario's section, overridden by options.

    Args:
        case: the scenario.
        vary: options.
        given: other options, by key of the section.
        single: whether to try single changes, which need no varied keys.

    Raises:
        ScenarioError: an option does not fit.
        RequestError: nothing varies, or single changes are requested with several goals.
    """
    own = explore_section(case.sections) or ExploreSection()
    varied = tuple(map(vary_section, vary)) or own.vary
    if single:
        if vary or len(own.goals) > 1:
            raise RequestError(
                "single changes are found by themselves, and judged by one goal: leave out --vary, and"
                " give one goal"
            )
        varied = ()
    elif not varied:
        raise RequestError(
            f"{case.name} does not say what may be different: give --vary key=low..high, or a"
            " section explore with vary"
        )
    if not given and varied == own.vary:  # with its places in the file
        return own
    content = {**own.model_dump(mode="json"), **given}
    content["vary"] = [item.model_dump(mode="json") for item in varied]
    return _validated(content)


def _validated(content: Mapping[str, Any]) -> ExploreSection:
    document = parse_document(Path("explore"), json.dumps(content))
    try:
        return validate_document(
            document, ExploreSection, ExploreSection.model_json_schema
        )
    except InvalidScenarioError as error:
        raise ScenarioError(f"explore: {error.problems[0].message}") from None


@contextmanager
def _evaluators(
    folder: Path, request: ExploreRequest, workers: int, cluster: Cluster | None
) -> Iterator[Evaluators]:
    """Yield the evaluators of designs: processes of this machine, or a cluster."""
    setting = replace(request, folder=request.folder.resolve())
    limit_s = request.section.design_limit_s
    if cluster is None:
        with Crew(setting, workers, limit_s) as crew:
            yield crew
        return
    try:
        with open_executor(None, cluster) as executor:
            yield ClusterCrew(setting, executor, parallelism(executor), limit_s)
    except ClusterLostError as error:
        raise ClusterLostError(
            f"{error}; what was done is kept, continue with --resume {folder}"
        ) from error


def _run(
    folder: Path,
    request: ExploreRequest,
    crew: Evaluators,
    designs: int | None,
    seconds: float | None,
    progress: Report,
) -> Explored:
    section, scenario = request.section, request.scenario
    case = LoadedScenario(scenario, request.folder)
    changes = candidates(scenario, request.folder) if request.singles else []
    dimensions = (
        change_dimensions(scenario, changes)
        if request.singles
        else dimensions_of(scenario, section, case.document)
    )
    exploration = Exploration(folder, section, dimensions, scenario.seed, progress)
    finals = Finals(exploration, request, progress)
    finalists: tuple[Finalist, ...] = ()
    worths: tuple[ChangeValue, ...] = ()
    singles: tuple[SingleChange, ...] = ()
    most = designs or section.designs
    if request.singles:
        tried = try_changes(exploration, crew, changes[: most - 1])
        singles = judge_changes(exploration, finals, tried, request.singles, progress)
    else:
        exploration.search(crew, most, seconds or section.seconds)
        finalists = finals.race()
        if finalists and len(section.goals) == 1:
            worths = finals.change_values(finalists[0], crew)
    found = summary_of(
        scenario.name, exploration, finalists, worths, scenario.seed, singles
    )
    write_json(folder / SUMMARY, found.content())
    write_report(found, request, dimensions, folder, progress)
    return Explored(folder, request, found)
