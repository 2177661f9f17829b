"""Random operations of small cells of every kind: what goes wrong is drawn, and what must be true at their end is checked.

    python -m tests.twin.operations.random_operations --count 500 [--first SEED] [--only CELL ...]

operates one drawn case after another in this process, and prints what is wrong with each of them.
"""

from __future__ import annotations

import argparse
import re
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.operate import audited
from planning.errors import PlanInvariantError
from planning.tasks.task import Handling, TaskKind
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.rollout import earliest_times
from scheduling.invariant import check_invariant
from scheduling.verification.verify import verify_plan
from tests.twin.operations.operated import STACK, operated, planned
from tests.twin.operations.reworked import BIN, REWORKED, with_crate
from tests.twin.planning.test_variants import mix
from tests.twin.scenarios.ovens import OVEN
from tests.twin.scenarios.tool_line import AT_RACKS, tool_line
from twin.operations.operation import Operation
from twin.runs.events import Event
from twin.runs.trajectory import object_placements
from twin.scenario.sections.kind import assembly_kind
from twin.trial.loaded_scenario import LoadedScenario
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_scenario, with_failures

ROOT = Path(__file__).parents[3] / "scenarios"

Values = dict[str, Any]
Draw = np.random.Generator


def _shipped(name: str) -> str:
    return (ROOT / f"{name}.yaml").read_text("utf-8")


def _magazine() -> str:
    before, goals = _shipped("assembly/magazine").split("       goals: ", 1)
    line, after = goals.split("\n", 1)
    line = line.replace("counts: [6, 2]", "counts: [2, 2]")
    before = before.replace("counts: [6, 2]", "counts: [4, 2]")
    return before.replace("count: 12", "count: 6") + f"       goals: {line}\n{after}"


def _stations() -> str:
    text = re.sub(r"    - \{name: \w+_[b-e], .*\n", "", STACK)
    return re.sub(r"(_a, brick: 2x4, at: \[.*?\])", r"\1, station: true", text)


def _inspected() -> str:
    """Return machine tending with a gauge beside the mill, and a crate for what it rejects."""
    text = _shipped("assembly/machine_tending")
    crate = "{name: crate, size_m: [0.2, 0.2, 0.3], pose: {xyz_m: [-0.5, 0.3, 0.15]}}"
    for old, new in {
        r"    mill: \{door.*\n": "    mill: {}\n    gauge: {}\n",
        r"(    washing: \{)": "    inspect: {duration: {kind: fixed, value_s: 3}, machine: gauge}\n\\1",
        r"(process: milling, at: \{part: blank\})(\})": "\\1, name: milled\\2\n    - {process: inspect, at: {part: blank}}",
        r"(    - \{name: table)": f"    - {crate}\n\\1",
    }.items():
        text, count = re.subn(old, new, text)
        assert count == 1, old
    return text


def _looked_at() -> str:
    """Return machine tending in which the cart inspects what it has put onto a tray."""
    text = _shipped("assembly/machine_tending")
    for old, new in {
        r"(    washing: \{)": "    inspect: {duration: {kind: fixed, value_s: 3}}\n\\1",
        r"(    - \{place: blank, robots: \[cart\]\}\n)": "\\1    - {process: inspect, at: {part: blank, pose: {xyz_m: [0, 0, 0.05]}}, robots: [cart]}\n",
    }.items():
        text, count = re.subn(old, new, text)
        assert count == 1, old
    return text


def _mix() -> str:
    """Return the mix without its shifts, in which all that is rejected is driven again."""
    text = (ROOT / "lines" / "mix.yaml").read_text("utf-8")
    return text[: text.index("  calendar:")]


def _rushed() -> str:
    """Return kits of two variants from trays, a conveyor and feeders, with two rush orders."""
    folder = Path(tempfile.mkdtemp(prefix="rushed-"))
    rush = [
        {"at_s": 25.0, "variant": "long"},
        {"at_s": 60.0, "count": 2, "variant": "short"},
    ]
    file = mix(folder, count=4, spare=1, rush=rush, variants={"short": 1, "long": 1})
    return file.read_text("utf-8")


_FEW_PLACES = {"counts": [1, 1], "pitch_m": [0.1, 0.1]}

CELLS: dict[str, tuple[Callable[[], str], Values]] = {
    "stack": (lambda: STACK, {}),
    "stack of stations": (_stations, {}),
    "stack in windows of one": (lambda: STACK, {"window": {"steps": 1, "least": 0}}),
    "stack in windows of two": (lambda: STACK, {"window": {"steps": 2, "least": 1}}),
    "cliff in windows": (
        lambda: _shipped("lego/cliff"),
        {"window": {"steps": 4, "least": 2}},
    ),
    "reworked": (lambda: REWORKED, {}),
    "rejecting": (lambda: with_crate(REWORKED), {"recovery.bin": BIN}),
    "rejecting to a person": (lambda: REWORKED, {"recovery.bin": "person"}),
    "rejecting in a line": (
        _inspected,
        {
            "assembly.products": {"count": 3, "spare": 1},
            "machines": {},
            "recovery.bin": {"fixture": "crate", "pose": {"xyz_m": [0, 0, 0.35]}},
        },
    ),
    "rejecting on trays": (
        _looked_at,
        {
            "assembly.products": {
                "count": 3,
                "spare": 1,
                "places": {"counts": [2, 1], "pitch_m": [0.15, 0.15]},
                "leave_s": 5,
            },
            "machines": {},
            "recovery.bin": "person",
        },
    ),
    "magazine": (_magazine, {}),
    "gluing": (lambda: _shipped("assembly/gluing"), {}),
    "gluing, held back": (lambda: _shipped("assembly/gluing"), {"windows.hold": 0.8}),
    "tending": (
        lambda: _shipped("assembly/machine_tending"),
        {
            "assembly.products.count": 2,
            "assembly.products.places": _FEW_PLACES,
            "machines": {},
        },
    ),
    "tending with spares": (
        lambda: _shipped("assembly/machine_tending"),
        {
            "assembly.products": {"count": 2, "spare": 2, "leave_s": 5},
            "machines": {},
        },
    ),
    "tending in windows": (
        lambda: _shipped("assembly/machine_tending"),
        {
            "assembly.products": {"count": 3, "spare": 1, "leave_s": 5},
            "machines": {},
            "window": {"steps": 5, "least": 2},
        },
    ),
    "tools in a line": (
        lambda: tool_line(Path(tempfile.mkdtemp(prefix="railed-"))) + AT_RACKS,
        {"assembly.products": {"count": 2, "spare": 1, "in_progress": 2}},
    ),
    "oven": (lambda: OVEN, {}),
    "mix": (lambda: _mix(), {"assembly.products.count": 4, "machines": {}}),
    "rushed": (_rushed, {}),
    "truss": (lambda: _shipped("assembly/truss"), {}),
    "tower": (
        lambda: _shipped("construction/tower"),
        {"assembly.model.levels": 4, "cell.team.count": 2},
    ),
    "goals": (lambda: _shipped("multi_arm/multi_goal"), {}),
}
"""Text of a scenario, and values of it that make it small."""


@cache
def plan_of(name: str) -> PlanResult:
    """Return the plan of a cell, which begins with a few steps where it has windows."""
    text, values = CELLS[name]
    folder = Path(tempfile.mkdtemp(prefix="operations-"))
    robots = ROOT / "assembly" / "tools"
    file = folder / "own.yaml"
    written = text().replace("tools/gripper.urdf", f"{robots}/gripper.urdf")
    file.write_text(written, "utf-8")
    few: Values = {"recovery.shortcuts": 0, "policy": "asynchronous"}
    return planned(file, **{**few, **values, "planning.shortcut_candidates": 0})


@cache
def _whole(name: str) -> PlanResult:
    """Return the plan of all steps that are wanted of a cell."""
    plan = plan_of(name)
    if plan.scenario.sections.execution.window is None:
        return plan
    return plan_scenario(plan.scenario.varied({"window": None}), keep=True)


def drawn_values(name: str, seed: int) -> Values:
    """Return what goes wrong in an operation, drawn by its seed."""
    draw = np.random.default_rng([seed, *name.encode()])
    plan = _whole(name)
    case, cell = plan.scenario, plan.scenario.sections.cell
    end_s = earliest_times(plan.tpg).makespan
    every = with_failures(case, plan.tpg, 0.5).sections.execution.failures
    values: Values = {}
    for skill in sorted(every):
        values[f"failures.{skill}"] = _failure(draw, skill, case.sections.processes)
    if name.startswith("rejecting"):
        line = {"rejecting in a line": ["milled"], "rejecting on trays": []}
        works = line.get(name, ["first", "second", "third"])
        values["failures.inspect"] |= _rejects(np.random.default_rng(seed), works)
    values["recovery.again"] = int(draw.integers(0, 4))
    values["recovery.planning_s"] = float(draw.choice([0.0, 1.0, 8.0]))
    values["latency_s"] = float(draw.choice([0.0, 0.0, 0.05, 0.5]))
    if draw.random() < 0.4:
        values["recovery.ask"] = {
            "answer_s": float(draw.choice([0.0, 20.0])),
            "helps": float(draw.choice([0.0, 0.6, 1.0])),
            "times": int(draw.integers(1, 4)),
        }
    if draw.random() < 0.4:
        team = [
            *(robot.name for robot in cell.robots),
            *getattr(case.sections.assembly, "machines", {}),
        ]
        count = int(draw.integers(1, 3))
        names = draw.choice(team, size=min(count, len(team)), replace=False)
        values["outages"] = [
            {"robot": str(own), "at_s": round(draw.uniform(0.0, 1.2 * end_s), 3)}
            for own in names
        ]
    if draw.random() < 0.4:
        steps = assembly_kind(case.sections.assembly).written_out().wanted_steps()
        drop = draw.choice(np.arange(1, steps + 1), size=min(2, steps), replace=False)
        values["changes"] = [
            {"at_s": round(draw.uniform(0.0, end_s), 3), "drop": [int(step)]}
            for step in drop
        ]
        if "spare" in name:
            values["changes"][0]["more"] = 1
        if name == "rushed":
            values["changes"] = [{"at_s": values["changes"][0]["at_s"], "more": 1}]
    if draw.random() < 0.3 and (late := _may_be_late(plan_of(name))):
        part = late[int(draw.integers(len(late)))]
        values["late"] = [{"part": part, "at_s": round(draw.uniform(0.0, end_s), 3)}]
    if draw.random() < 0.3:
        values["emergency_stops"] = [
            {"at_s": round(draw.uniform(0.0, end_s), 3), "duration_s": 5.0}
        ]
    if draw.random() < 0.3:
        values["stalls"] = {"count_per_robot": 2, "duration_s": [1.0, 20.0]}
    return values


def _failure(draw: Draw, skill: str, processes: Mapping[str, object]) -> Values:
    """Return how attempts at a skill fail."""
    item: Values = {
        "probability": float(draw.choice([0.0, 0.1, 0.3, 0.5])),
        "retries": int(draw.integers(0, 2)),
    }
    if skill in TaskKind.HANDLING:
        item["loses"] = float(draw.choice([0.0, 0.5, 1.0]))
        kind = "wrong" if skill == "pick" else "slips"
        item[kind] = float(draw.choice([0.0, 0.5]))
    elif skill in processes:
        item["then"] = str(draw.choice(["again", "rework", "scrap"]))
    return item


def _rejects(draw: Draw, every: list[str]) -> Values:
    """Return what becomes of a part that is rejected, mostly that some steps are done again."""
    if draw.random() < 0.3:
        return {"then": "scrap"}
    names = [name for name in every if draw.random() < 0.6]
    rework: Values = {"steps": names} if names else {}
    if draw.random() < 0.7:
        rework["times"] = int(draw.integers(1, 4))
    return {"then": "rework", "rework": rework}


def _may_be_late(plan: PlanResult) -> list[str]:
    """Return the parts that are picked, and on which and before which nothing stands."""
    work, lego = plan.motions.work, plan.scenario.sections.assembly.kind == "lego"
    if work is None or not (lego or plan.scenario.sections.execution.window is None):
        return []
    if getattr(plan.scenario.sections.assembly, "products", None):
        return []
    problem = work.problem
    under = {item.object for item in problem.primaries if item.after}
    there = {item.name for item in plan.tpg.cell.objects} - problem.unlimited
    picked = there.intersection(item.object for item in problem.primaries)
    return sorted(picked - under)


def problems_of(
    name: str, seed: int, *, audit: bool = True
) -> tuple[list[str], Operation]:
    """Operate a drawn case, and return what is wrong with it in words."""
    plan, values = plan_of(name), drawn_values(name, seed)
    done, events = operated(plan, seed, **values)
    if done.rush_after:
        values["assembly.products.rush_after"] = list(done.rush_after)
    case = plan.scenario.varied(values)
    found = [
        *_order(done),
        *_ends(done, events, values, _whole(name)),
        *_untold(done, plan, _whole(name)),
        *_absent(done, case),
    ]
    found += [f"verify: {words}" for words in verify_plan(done.tpg).problems]
    if audit:
        found += [f"audit: {words}" for words in audited(done, case)]
    return found, done


def _order(done: Operation) -> Iterator[str]:
    """Yield what was executed in an order that edges forbid, or not at all."""
    try:
        check_invariant(DerivedTpg(done.tpg))
    except PlanInvariantError as error:
        yield f"invariant: {error}"
    start, end = done.record.start_ns, done.record.end_ns
    left = sum(int((own < 0).sum()) for own in (*start, *end))
    if left:
        yield f"{left} nodes were not executed"
    for k, u, i, v in done.tpg.edges.tolist():
        if not 0 <= end[k][u] <= start[i][v]:
            yield f"edge {k}:{u} -> {i}:{v} was not kept"


def _ends(
    done: Operation, events: list[Event], values: Values, whole: PlanResult
) -> Iterator[str]:
    """Yield what is wrong with the end of an operation: its outcome, and how many plans it took."""
    last = events[-1]
    if (last.kind, last.robot, last.detail) != ("finished", "", done.record.outcome):
        yield f"the last event is {last}, the outcome {done.record.outcome}"
    kind = assembly_kind(whole.scenario.sections.assembly).written_out()
    if kind.wanted_steps() == kind.steps() and "more" not in str(values):
        short = bool(done.given_up)
        if (done.record.outcome == "failed") != short:
            yield f"{done.record.outcome} with {len(done.given_up)} steps given up"
    causes = sum(event.kind == "failed" for event in events)
    causes += len(values.get("changes", ())) + len(values.get("outages", ()))
    if len(done.versions) > causes + kind.steps():
        yield f"{len(done.versions)} plans of {causes} causes"
    told = sum(event.kind == "replanned" for event in events)
    if told != len(done.versions):
        yield f"{told} plans are told of {len(done.versions)}"


def _untold(done: Operation, plan: PlanResult, whole: PlanResult) -> Iterator[str]:
    """Yield steps of which the world at the end is another than is told, read from the placements of objects."""
    undone = done.given_up.keys() | done.dropped.keys()
    idle = (TaskKind.TRANSIT, TaskKind.LEFT_OUT, TaskKind.FAILED)
    last = {task.step: task.kind for task in whole.tpg.tasks if task.kind not in idle}
    wanted = Counter(task.step for task in whole.tpg.tasks if task.kind not in idle)
    if done.rush_after:  # then steps have other numbers than in the plan
        kind = assembly_kind(whole.scenario.sections.assembly).written_out()
        steps = kind.with_rush(done.rush_after).wanted_steps()
        wanted = Counter(range(1, steps + 1))
    executed = {(t.step, t.kind) for t in done.tpg.tasks if t.kind not in idle}
    for step in wanted:
        skills = {k for s, k in executed if s == step}
        if not skills and step not in undone:
            yield f"step {step} ({last.get(step)}) was not done, and is not told"
    # Where parts stand in the end in a run in which nothing fails, something of their kind stands.
    goals = _goals(whole)
    ends = {
        p.object: p for p in object_placements(done.tpg, done.record)
    }  # the last one of each
    resting = [p.pose[:3, 3] for p in ends.values() if p.holder is None]
    placed = {t.step: t.object for t in done.tpg.tasks if t.kind == "place-down"}
    scrapped = {
        h.object
        for task in done.tpg.tasks
        for h in task.handlings
        if h.holder == Handling.GONE and task.step in done.given_up
    }
    for step, at in goals.items():
        filled = any(np.linalg.norm(at - own) < 1e-3 for own in resting)
        if not filled and placed.get(step) in scrapped:
            continue
        if filled == (step in undone):
            state = "filled and undone" if filled else "neither filled nor told"
            yield f"the goal of step {step} is {state}"


def _absent(done: Operation, case: LoadedScenario) -> Iterator[str]:
    """Yield processes that robots did at a part that was in a hand or not there."""
    placements, chains = object_placements(done.tpg, done.record), done.tpg.chain_index
    for task in done.tpg.tasks:
        k = chains.get(task.robot)
        if k is None or not task.object or done.tpg.cell.is_machine(task.robot):
            continue
        if task.kind not in case.sections.processes:
            continue
        node = int(np.argmax(done.tpg.chains[k].task == task.index))
        begin = int(done.record.start_ns[k][node])
        own = [p for p in placements if p.object == task.object and p.t_ns <= begin]
        if not own or own[-1].holder is not None:
            yield f"task {task.index}, {task.label}: {task.object} is not there"


def _goals(whole: PlanResult) -> dict[int, np.ndarray]:
    """Return where the part of each step stands at the end of a plan of all steps, if it stays there [m]."""
    moved: dict[str, tuple[int, np.ndarray | None]] = {}
    tpg = whole.tpg
    for h in sorted(
        tpg.handlings, key=lambda h: float(tpg.chains[h.robot].planned_start[h.node])
    ):
        task = tpg.task_of(h)
        places = h.holder is None and task.kind in ("place-down", "place-up")
        moved[h.object] = task.step, h.pose[:3, 3] if places else None
    return {step: at for step, at in moved.values() if at is not None}


def main() -> int:
    """Operate drawn cases, and print what is wrong with each."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=100, metavar="N")
    parser.add_argument("--first", type=int, default=0, metavar="SEED")
    parser.add_argument("--only", nargs="+", choices=CELLS, default=list(CELLS))
    options = parser.parse_args()
    wrong, plans = 0, 0
    outcomes = Counter[str]()
    for seed in range(options.first, options.first + options.count):
        name = options.only[seed % len(options.only)]
        begin = time.process_time()
        try:
            found, done = problems_of(name, seed)
        except Exception:
            found, done = [traceback.format_exc()], None
        seconds = time.process_time() - begin
        wrong += bool(found)
        told = "raised"
        if done is not None:
            plans += len(done.versions)
            told = f"{done.record.outcome}, {len(done.versions)} plans, {len(done.given_up)} given up"
            outcomes[done.record.outcome] += 1
        words = f"{name} {seed}: {told}, {seconds:.1f} CPU s"
        sys.stdout.write("\n    ".join([words, *found]) + "\n")
        sys.stdout.flush()
    words = f"{options.count} operations, {wrong} with findings, {plans} plans"
    sys.stdout.write(f"{words}, {dict(outcomes)}\n")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
