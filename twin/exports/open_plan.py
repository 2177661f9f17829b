"""Export of runs as open plans, the JSON format of robot plans that ``twin judge`` reads."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import networkx as nx
import numpy as np

from planning.tasks.task import Handling, TaskKind
from planning.transforms import Array, quat_wxyz
from scheduling.graph.temporal_plan_graph import NodeHandling, TemporalPlanGraph
from twin.activities.activities import SAME_ROBOT
from twin.durations.nanoseconds import NANOSECONDS
from twin.engine.dispatch_policies import with_policy
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel
from twin.exports.segments import CONTROLLER_RATE_HZ, Segment, segments
from twin.judge.open_plan import FORMAT, VERSION
from twin.recorders.observers import MemoryRecorder
from twin.registry import POLICIES
from twin.runs.execution_record import Policy
from twin.trial.plan_result import PlanResult
from twin.trial.run_result import RunResult
from twin.uncertainty.skill_durations import SkillDurations

_EVERY_NS = float(NANOSECONDS)
"""Rate at which no point of a plan is left out or moved [Hz]."""


def open_plan_files(run: RunResult) -> Mapping[str, bytes]:
    """Return ``open_plan.json``: the plan of a run by its policy, with nominal durations.

    Args:
        run: the run.
    """
    release = next((p for p in POLICIES.names() if run.policy.startswith(p)), None)
    if release is None or "TPG" in run.policy:
        release = "asynchronous"
    document = open_plan_of(run.plan, release)
    document["planner"] += f", {run.policy}"
    text = json.dumps(document, ensure_ascii=False, allow_nan=False)
    return {"open_plan.json": text.encode() + b"\n"}


def open_plan_of(plan: PlanResult, release: Policy) -> dict[str, Any]:
    """Return a plan as JSON has it, executed with nominal durations.

    Motions between which a robot does not come to rest are late as one there, and begin once all that they
    wait for is over. Where robots would so wait for each other in a circle, they come to rest before they wait.

    Args:
        plan: the plan.
        release: how its nodes are released.
    """
    tpg = with_policy(plan.tpg, release)
    while True:
        document, borders = _document(_as_planned(replace(plan, tpg=tpg)), release)
        rests = [borders[name] for name in circular_waits(document)]
        if not rests or release == "open-loop":
            return document
        tpg = _resting(tpg, rests)


def circular_waits(document: Mapping[str, Any]) -> list[str]:
    """Return the motions whose waits within passages at speed form a cycle.

    A *passage* is what a robot does from rest to rest, such as several motions between which it does not stop.

    Args:
        document: an open plan, as JSON has it.
    """
    passage: dict[str, int] = {}
    graph: Any = nx.DiGraph()
    inner: list[str] = []
    everybody = [robot["motions"] for robot in document["robots"].values()]
    everybody += document.get("machines", {}).values()
    number = 0
    for motions in everybody:
        number += 1  # a gap: no motion follows the last one of another robot
        begins = True
        for motion in motions:
            if begins:
                number += 1
                graph.add_edge(number - 1, number)
            elif motion.get("after"):
                inner.append(motion["id"])
            passage[motion["id"]] = number
            begins = not motion.get("v") or not np.any(motion["v"][-1])
    for motions in everybody:
        for motion in motions:
            for other in motion.get("after", ()):
                graph.add_edge(passage[other], passage[motion["id"]])
    circles = [c for c in nx.strongly_connected_components(graph) if len(c) > 1]
    within = {number for circle in circles for number in circle}
    return [name for name in inner if passage[name] in within]


def _resting(
    tpg: TemporalPlanGraph, borders: list[tuple[int, int]]
) -> TemporalPlanGraph:
    """Return a graph whose robots rest before some nodes, by chain and node."""
    chains = list(tpg.chains)
    for number, node in borders:
        drive = chains[number].drive
        assert drive is not None
        rests = drive.rests.copy()
        rests[node - 1] = True
        chains[number] = replace(chains[number], drive=replace(drive, rests=rests))
    return replace(tpg, chains=tuple(chains))


def _document(
    nominal: RunResult, release: Policy
) -> tuple[dict[str, Any], dict[str, tuple[int, int]]]:
    """Return a run as JSON values, and the first node of each motion, by chain and number."""
    plan, tpg = nominal.plan, nominal.tpg
    smooth = bool(nominal.smooth_motions)  # whose own rows are written, however sampled
    whole = list(segments(nominal, CONTROLLER_RATE_HZ if smooth else _EVERY_NS))
    machines: dict[str, list[Any]] = {item.name: [] for item in tpg.cell.machines}
    robots: dict[str, list[Any]] = {item.name: [] for item in tpg.cell.robots}
    verbs = dict(_verbs(tpg))
    held: dict[str, set[str]] = defaultdict(set)
    for segment in whole:
        own = {**robots, **machines}[segment.robot]
        entry = _motion(nominal, segment, verbs, held[segment.robot])
        if segment.robot in machines:
            entry = {k: v for k, v in entry.items() if k not in ("q", "v", "a")}
            entry["t_s"] = [entry["t_s"][0], entry["t_s"][-1]]
        own.append({key: value for key, value in entry.items() if value or key == "id"})
    borders = {s.id: (tpg.chain_index[s.robot], s.nodes[0]) for s in whole}
    document = {
        "format": FORMAT,
        "version": VERSION,
        "scenario": plan.scenario.name,
        "planner": "assembly-twin",
        "execution": "clock" if release == "open-loop" else "waits",
        "robots": {
            name: {
                "joints": list(tpg.cell.robot(name).model.joint_names),
                "motions": motions,
            }
            for name, motions in robots.items()
        },
        "machines": {name: motions for name, motions in machines.items() if motions},
    }
    return document, borders


def _as_planned(plan: PlanResult) -> RunResult:
    """Return the run of a plan with planned durations.

    What waits for what by the policy, turns or slots, is in its graph.
    """
    memory = MemoryRecorder()
    done = Simulator(plan.tpg, ExecutionModel(SkillDurations({}))).run(
        seed=0, recorders=(memory,)
    )
    return RunResult(plan=plan, history=memory.events, record=done)


def _motion(
    run: RunResult,
    segment: Segment,
    verbs: Mapping[int, dict[str, str]],
    held: set[str],
) -> dict[str, Any]:
    tpg, task = run.tpg, segment.task
    number = tpg.chain_index[segment.robot]
    begin, t_ns = segment.executed[0], segment.t_ns
    rows: tuple[Array | None, ...] = (segment.q, None, None)
    smooth = run.smooth_motions.get(segment.robot)
    if smooth is not None and smooth.a is not None and segment.motion is not None:
        begin, end = segment.motion
        inside = (smooth.t_ns > begin) & (smooth.t_ns < end)
        at = np.unique(np.r_[begin, smooth.t_ns[inside], end])
        q, v, _ = smooth.states_at(at)
        # Accelerations are written directly: derived from speeds they have fewer digits.
        own = [np.interp(at, smooth.t_ns, column) for column in smooth.a.T]
        t_ns, rows = at - begin, (q, v, np.stack(own, axis=1))
    times = [(begin + t) / NANOSECONDS for t in t_ns.tolist()]
    entry = [None if part is None else part.tolist() for part in rows]
    changes = [
        (k, item)
        for k, item in enumerate(tpg.handlings)
        if item.robot == number and segment.nodes[0] <= item.node <= segment.nodes[1]
    ]
    handled = {item.object for _, item in changes} | held
    tools = {tool.name for tool in tpg.cell.robot(segment.robot).tools}
    events = []
    for (k, item), handled_at in zip(changes, segment.handlings, strict=True):
        if (item.node, item.waypoint) == (0, 0) and item.object in tools:
            continue  # the tool that it has on it at the start
        t_s = min((begin + handled_at.t_ns) / NANOSECONDS, times[-1])
        event: dict[str, Any] = {"t_s": max(t_s, times[0]), **verbs[k]}
        if item.holder != Handling.GONE:
            event["pose"] = _pose(item)
        events.append(event)
        held.discard(item.object)
        if item.holder == segment.robot:
            held.add(item.object)
    return {
        "id": segment.id,
        "t_s": times,
        **dict(zip("qva", entry, strict=True)),
        "task": f"{task.index} {task.label}",
        "skill": None if task.kind == TaskKind.TRANSIT else task.kind,
        "object": task.object,
        "touches": sorted(set(_touched(tpg, segment)) - handled),
        "events": events,
        "after": [item.segment for item in segment.after if item.cause != SAME_ROBOT],
    }


def _pose(item: NodeHandling) -> dict[str, list[float]]:
    turn = np.asarray(quat_wxyz(item.pose)).tolist()
    return {"xyz_m": np.asarray(item.pose[:3, 3]).tolist(), "quat_wxyz": turn}


def _verbs(tpg: TemporalPlanGraph) -> Iterator[tuple[int, dict[str, str]]]:
    """Yield the event of each transfer, by its number, in planned order."""
    there = {item.name for item in tpg.cell.objects if not item.later}
    for k, item in enumerate(tpg.handlings):
        thing, robot = item.object, tpg.chains[item.robot].robot
        if item.holder == Handling.GONE:
            yield k, {"leave": thing}
            there.discard(thing)
        elif item.holder is None:
            yield k, {"put" if thing in there else "appear": thing}
            there.add(thing)
        elif item.holder == robot:
            yield k, {"take": thing}
        else:
            yield k, {"give": thing, "to": item.holder}


def _touched(tpg: TemporalPlanGraph, segment: Segment) -> Iterator[str]:
    """Yield the intended contacts of a robot's tool in a segment."""
    cell, robot = tpg.cell, tpg.cell.robot(segment.robot)
    hands = {f"{robot.name}/tool", *(tool.name for tool in robot.tools)}
    things = {*(o.name for o in cell.objects), *(f.name for f in cell.fixtures)}
    for contact in tpg.allowed:
        pair = {contact.first, contact.second}
        if segment.task.index in contact.tasks and not contact.grazing and pair & hands:
            yield from pair & things - hands
