"""The simplest loop that executes a plan on drivers: what is safe is cleared, what is done is reported."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.live.scene import Scene
from planning.kinematics.kinematics import frame_pose
from planning.transforms import Transform
from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.task_edges import actuation_nodes
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.drivers.driver import Driver, Sample, cleared_node

_PERIOD_S = 0.01
"""How often drivers are asked [s]."""


@dataclass(frozen=True, eq=False)
class Driven:
    """What came of a plan that was driven.

    Attributes:
        poses: of the objects at the end.
        off: farthest that a joint of each robot was from its path [rad].
        tool_off: farthest that its tool was from where it would be on its path [m].
        simulated_s: makespan by the simulator's clock [s].
        wall_s: by the clock on the wall [s].
        failed: why it is not finished; empty where it is.
    """

    poses: dict[str, Transform]
    off: dict[str, float]
    tool_off: dict[str, float]
    simulated_s: float
    wall_s: float
    failed: str


def tool_off(tpg: TemporalPlanGraph, k: int, samples: list[Sample]) -> float:
    """Return how far the tool of a robot was from its path at most [m].

    Args:
        tpg: the plan.
        k: index of the robot's chain.
        samples: where it was measured.
    """
    chain = tpg.chains[k]
    robot = tpg.cell.robot(chain.robot)
    farthest = 0.0
    for sample in samples:
        # The node that it is in, with what it is passed from and to.
        low = max(sample.done - 1, 0)
        high = min(sample.done + 2, len(chain))
        own = chain.waypoints[chain.first[low] : chain.first[high]]
        before = chain.waypoints[chain.first[low] - 1] if low else chain.start
        points = np.vstack([before, own])
        ways = np.diff(points, axis=0)
        squares = np.maximum((ways**2).sum(axis=1), 1e-18)
        share = ((sample.q - points[:-1]) * ways).sum(axis=1) / squares
        near = points[:-1] + np.clip(share, 0.0, 1.0)[:, None] * ways
        best = near[np.argmin(np.abs(near - sample.q).max(axis=1))]
        at, wanted = (frame_pose(robot, q, "tool") for q in (sample.q, best))
        farthest = max(farthest, float(np.linalg.norm(at[:3, 3] - wanted[:3, 3])))
    return farthest


def drive(
    tpg: TemporalPlanGraph,
    drivers: Mapping[str, Driver],
    scene: Scene,
    patience_s: float = 15.0,
) -> Driven:
    """Execute a plan to its end, or to a fault, a skill that failed, or a standstill of all.

    Args:
        tpg: the plan.
        drivers: by robot.
        scene: that the robots are in.
        patience_s: how long nothing may be done [s].
    """
    dispatcher = Dispatcher(tpg)
    acts = actuation_nodes(tpg)
    nodes = [
        [cleared_node(tpg, k, node, acts[k]) for node in range(len(chain))]
        for k, chain in enumerate(tpg.chains)
    ]
    own = [drivers[chain.robot] for chain in tpg.chains]
    given, off = [0] * len(own), {chain.robot: 0.0 for chain in tpg.chains}
    samples: list[list[Sample]] = [[] for _ in own]
    for chain, driver in zip(tpg.chains, own, strict=True):
        driver.begin(chain.start, 0)
    begin, clock = scene.look().seconds, time.monotonic()
    last, failed = clock, ""
    while not dispatcher.finished and not failed:
        for k, driver in enumerate(own):
            chain = tpg.chains[k]
            state = driver.state()
            off[chain.robot] = max(off[chain.robot], state.off)
            samples[k] += state.samples
            while dispatcher.completed(k) < state.done:
                dispatcher.complete(k, dispatcher.completed(k))
                last = time.monotonic()
            stop = given[k]
            while stop < len(chain) and not dispatcher.waits_for(k, stop):
                stop += 1
            driver.take(nodes[k][given[k] : stop])
            given[k] = stop
            if state.mode == "fault" or state.failed >= 0:
                failed = f"{chain.robot} at node {state.done}: {state.words}"
        if time.monotonic() - last > patience_s:
            failed = f"nothing done after {[d.state().done for d in own]}"
        time.sleep(_PERIOD_S)
    wall = time.monotonic() - clock
    seconds = scene.look().seconds - begin
    time.sleep(1.0)
    for driver in own:
        driver.leave()
    tools = {
        chain.robot: tool_off(tpg, k, samples[k]) for k, chain in enumerate(tpg.chains)
    }
    return Driven(scene.look().poses, off, tools, seconds, wall, failed)
