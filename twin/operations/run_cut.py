"""Cut of a run at a time: the state from which a new plan continues, and the work that remains (``RUN@T``)."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from planning.errors import RequestError
from planning.tasks.task import TaskKind
from scheduling.graph.temporal_plan_graph import NodeChain
from scheduling.graph.windows import window_opening_times
from scheduling.rolling.cut import Counts, cut_after
from twin.durations.nanoseconds import NANOSECONDS
from twin.operations.commitment import Failure
from twin.operations.operation import require_rolling
from twin.operations.remainder import RunRemainder
from twin.runs.events import EventCode
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.run_moment import RunMoment
from twin.trial.run_result import RunResult

_MOST_DEVIATION = 0.02
"""Largest deviation of a joint from the planned rest; with more, the robot was moved externally [rad or m]."""


def cut_run(
    case: LoadedScenario, moment: RunMoment, out: Collection[str]
) -> RunRemainder:
    """Return the remainder of a run from a time on.

    Every robot continues to the end of the first node after which it is at rest and within no skill; the plan
    begins in the world state that results.

    Args:
        case: scenario of the remaining plan.
        moment: when.
        out: robots that are out of service from then on.

    Raises:
        RequestError: a robot cannot continue.
    """
    require_rolling(case.sections)
    run, t_ns = moment.run, moment.t_ns
    for name in out:
        if name not in case.robots:
            raise RequestError(f"there is no robot {name!r}", choices=case.robots)
    for section in ("cell", "assembly"):
        if getattr(run.sections, section) != getattr(case.sections, section):
            raise RequestError(f"{section} is not that of the run {run.name!r}")
    tpg = run.tpg
    if tpg.cell.begun is not None:
        raise RequestError(
            f"the run {run.name!r} itself began in the middle, after {tpg.cell.begun.after}: what was done"
            " before is not in it"
        )
    if any(task.kind == TaskKind.BROUGHT for task in tpg.tasks):
        raise RequestError("what somebody brought in a run is not known to a new plan")
    counts, failures, left_s, ago = _first_rests(run, moment)
    gone = {
        event.robot
        for event in run.history
        if event.t_ns <= t_ns and event.code is EventCode.OUT_OF_SERVICE
    }
    return RunRemainder(
        case.sections,
        tpg,
        counts,
        failures,
        frozenset({*out, *gone}),
        left_s,
        ago,
        str(moment),
        _skipped_steps(run),
    )


def _skipped_steps(run: RunResult) -> dict[int, str]:
    """Return the abandoned or dropped steps of a run, by number, with the reason."""
    operation = run.summary.get("operation") or {}
    return {
        int(step): str(why)
        for key in ("given_up", "dropped")
        for step, why in operation.get(key, {}).items()
    }


def _first_rests(
    run: RunResult, moment: RunMoment
) -> tuple[Counts, tuple[Failure, ...], dict[str, float], dict[int, float]]:
    """Return the number of nodes of each robot up to its first rest outside skills after a time.

    Also returned are the skills that had failed by then, at whose start their robots stand; for how long each
    machine still works once all robots are at rest; and how long before that each task ended that opens a time
    window, by index of the task [s].

    Raises:
        RequestError: the run ended before that, or a robot was not where its plan has it.
    """
    tpg, index = run.tpg, run.tpg.chain_index
    times = [(start, end.copy()) for start, end in run.node_times_ns]
    failed: dict[tuple[int, int], Failure] = {}
    for event in run.history:
        if event.kind == "failed" and event.node >= 0:
            at = index[event.robot], event.node
            failed[at] = Failure(*at)
        elif event.kind == "recovered":  # the attempt is over then
            at = index[event.robot], event.node
            times[at[0]][1][at[1]] = event.t_ns
            del failed[at]
    before = [np.count_nonzero((s >= 0) & (s < moment.t_ns)) for s, _ in times]
    tried = tuple(own for k, own in sorted(failed.items()) if k[1] < before[k[0]])
    begun, counts = [int(count) for count in before], Counts()
    for own in tried:
        begun[own.chain] = own.node
    while counts != tuple(begun):
        counts = cut_after(tpg, begun, failed, steps=False)
        begun = list(map(_to_rest, tpg.chains, counts))
    for chain, count, (_, end) in zip(tpg.chains, counts, times, strict=True):
        machine = tpg.cell.is_machine(chain.robot)
        if np.any(end[:count] < 0):
            raise RequestError(
                f"{chain.robot!r} does not come to rest between {moment} and the end of the run"
            )
        if machine:
            continue
        when = end[count - 1 : count] if count else np.zeros(1, dtype=np.int64)
        stood = run.motions[chain.robot].at(when)[0]
        if (away := np.abs(stood - chain.stands_at(count)).max()) > _MOST_DEVIATION:
            raise RequestError(
                f"{chain.robot!r} came to rest {away:.3g} rad or m from where its plan has it: who moved it?"
            )
    rest = [
        (chain.robot, int(end[count - 1]))
        for chain, count, (_, end) in zip(tpg.chains, counts, times, strict=True)
        if count
    ]
    machines = {name: t for name, t in rest if tpg.cell.is_machine(name)}
    still = max((t for name, t in rest if name not in machines), default=moment.t_ns)
    left = {name: (t - still) / NANOSECONDS for name, t in machines.items()}
    opened = window_opening_times(tpg, np.concatenate([end for _, end in times]))
    ago = {k: (still - t) / NANOSECONDS for k, t in opened.items() if t <= still}
    return counts, tried, {name: s for name, s in left.items() if s > 0.0}, ago


def _to_rest(chain: NodeChain, count: int) -> int:
    """Return the first number of nodes, from a given one, after which a robot is at rest."""
    if chain.drive is None or count == 0:
        return count
    return count + int(np.argmax(chain.drive.rests[count - 1 :]))
