"""State of a run in progress, computed from its events, with violations of the temporal plan graph.

If a run is replanned, each event is checked against the plan that was executed at that time.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field

import numpy as np

from planning.tasks.task import TaskKind
from scheduling.graph.barriers import with_barriers
from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.activities.activities import CAUSES
from twin.activities.progress import STOPPED, RobotProgress
from twin.durations.nanoseconds import NANOSECONDS
from twin.engine.passage import DriveTimes, drive_times
from twin.runs.events import Event
from twin.runs.execution_record import Policy
from twin.uncertainty.disturbances import Speed
from twin.uncertainty.draws import LEAST_UNIFORM

Versions = Callable[[int], TemporalPlanGraph]
"""Returns the plan of a version, given its number, from 1."""


@dataclass(frozen=True)
class ForbiddenEvent:
    """An event that the TPG forbids.

    Attributes:
        t_ns: when [ns].
        robot: whose event, empty for the whole cell.
        node: index of the robot's node, -1 where there is none.
        task: index of its task, -1 where there is none.
        edges: nodes that should have been complete before, as (robot, node).
        text: all of it, for people.
    """

    t_ns: int
    robot: str
    node: int
    task: int
    edges: tuple[tuple[str, int], ...]
    text: str


@dataclass
class FollowedRun:
    """A run in progress.

    Attributes:
        tpg: the executed plan; replaced by each plan revision.
        policy: how nodes are released; ``synchronous`` adds the barriers of its slots.
        versions: returns the plans that take over; None where none does.
        late: machines that bring late parts: robots wait for them only after such a part was missed.
        speed: speed factors of the robots; the slower a robot, the longer it takes to brake.
        version: number of the plan that is executed.
        robots: progress of each chain.
        now_ns: time of the last event [ns].
        events: how many there were.
        violations: forbidden events, in order.
        outcome: outcome of the run, empty until its end.
    """

    tpg: TemporalPlanGraph
    policy: Policy = "asynchronous"
    versions: Versions | None = None
    late: Collection[str] = ()
    speed: Speed = field(default_factory=Speed)
    version: int = 1
    robots: list[RobotProgress] = field(init=False)
    now_ns: int = 0
    events: int = 0
    violations: list[ForbiddenEvent] = field(default_factory=list)
    outcome: str = ""

    def __post_init__(self) -> None:
        self._missed: set[str] = set()
        self._hold_against(self.tpg)
        chains = self._graph.chains
        self.robots = [RobotProgress(chain.robot, len(chain)) for chain in chains]

    def _hold_against(self, tpg: TemporalPlanGraph) -> None:
        """Check following events against a plan, of which nothing has been executed yet."""
        self.tpg = tpg
        graph = with_barriers(self.tpg) if self.policy == "synchronous" else self.tpg
        self._graph = graph
        self._dispatcher = Dispatcher(graph)
        self._chain = {chain.robot: k for k, chain in enumerate(graph.chains)}
        edges = map(tuple, graph.edges.tolist())
        self._cause = dict(zip(edges, graph.cause.tolist(), strict=True))
        self._handled = {(h.object, h.robot, h.node) for h in graph.handlings}
        self._brings = {
            k: str(graph.tasks[int(chain.task[0])].object)
            for k, chain in enumerate(graph.chains)
            if chain.robot in self.late and len(chain)
        }
        self._drives: dict[int, DriveTimes] = {}

    @property
    def nodes_done(self) -> int:
        """Nodes that are complete."""
        return sum(robot.completed for robot in self.robots)

    def waits_for(self, chain: int) -> str:
        """Return a text on the nodes that a robot's next node waits for, empty for none."""
        node = self.robots[chain].completed
        waits = self._waits(chain, node)
        names = [f"{self._node(r, u)})" for r, u in waits]
        return "waits for " + " and ".join(names) if names else ""

    def apply(self, event: Event) -> Sequence[ForbiddenEvent]:
        """Apply an event; return its violations."""
        before = len(self.violations)
        if event.t_ns < self.now_ns:
            self._flag(event, f"comes after an event of {_seconds(self.now_ns)}")
        self.now_ns = max(self.now_ns, event.t_ns)
        self.events += 1
        if not event.robot:
            if event.kind == "finished":
                self._finish(event)
            elif event.kind == "replanned":
                self._take_version(event)
        elif event.robot not in self._chain:
            names = ", ".join(self._chain)
            self._flag(event, f"no robot of the plan (robots: {names})")
        else:
            self._apply_to(self._chain[event.robot], event)
        return self.violations[before:]

    def _finish(self, event: Event) -> None:
        """Apply the end of the run; a premature completion is a violation."""
        left = sum(
            len(robot.start_ns) - robot.completed
            for k, robot in enumerate(self.robots)
            if k not in self._brings  # a part that comes after the end never comes
        )
        self.outcome = event.detail or "finished"
        if self.outcome == "completed" and left:
            self.outcome = "incomplete"
            self._flag(event, f"{left} nodes are not complete")

    def _take_version(self, event: Event) -> None:
        """Continue with the next plan revision, which must keep started nodes."""
        if self.versions is None:
            self._flag(event, "the versions of the plan are not known")
            return
        before, robots = self._graph, self.robots
        self.version += 1
        self._hold_against(self.versions(self.version))
        chains = self._graph.chains
        known = {robot.name: robot for robot in robots}
        self.robots = [
            known[chain.robot].continued(len(chain))
            if chain.robot in known
            else RobotProgress(chain.robot, len(chain))
            for chain in chains
        ]
        for k, robot in enumerate(self.robots):
            if robot.completed:
                self._dispatcher.observe(k, robot.completed - 1)
        for old, robot in zip(before.chains, robots, strict=True):
            begun = robot.completed + (robot.under_way >= 0)
            k = self._chain.get(old.robot, -1)
            tasks = chains[k].task[:begun] if k >= 0 else old.task[:0]
            if tasks.tolist() != old.task[:begun].tolist():
                words = f"version {self.version} lacks nodes that {old.robot} has begun"
                self._flag(event, words)

    def _apply_to(self, k: int, event: Event) -> None:
        robot, chain = self.robots[k], self._graph.chains[k]
        node = event.node
        if not -1 <= node < len(chain):
            self._flag(event, f"it has nodes 0 to {len(chain) - 1}")
            return
        if event.kind == "waiting" and self._is_left_out(event.task):
            node = -1  # it waited for nodes that were then replanned
        if node >= 0 and event.task not in (-1, int(chain.task[node])):
            self._flag(event, f"node {node} is of task {int(chain.task[node])}")
        if event.kind == "failed" and node >= 0:
            task = self._graph.tasks[int(chain.task[node])]
            self._missed |= {str(task.object)} & {*self._brings.values()}
        if event.kind in ("released", "started", "completed") and node < 0:
            self._flag(event, "it names no node")
        elif event.kind == "released":
            self._check_edges(k, event)
        elif event.kind == "started":
            self._start(k, event)
        elif event.kind == "completed":
            self._complete(k, event)
        elif event.kind == "recovered":
            self._recover(k, event)
        elif (
            event.kind in ("attached", "detached")
            and (event.object, k, node) not in self._handled
        ):
            what = f"the plan does not handle {event.object!r} in node {node}"
            self._flag(event, what)
        else:
            robot.take(event)

    def _is_left_out(self, task: int) -> bool:
        tasks = self._graph.tasks
        return 0 <= task < len(tasks) and tasks[task].kind == TaskKind.LEFT_OUT

    def _start(self, k: int, event: Event) -> None:
        robot, node = self.robots[k], event.node
        if robot.start_ns[node] >= 0:
            self._flag(event, f"node {node} has started before")
            return
        if node != robot.completed:
            self._flag(event, f"node {robot.completed} comes next")
        if robot.standing and not self._still_moves(k, event):
            self._flag(event, f"the robot is {robot.standing}")
        self._check_edges(k, event)
        robot.take(event)

    def _still_moves(self, k: int, event: Event) -> bool:
        """Return whether a robot with limits may start a node while it brakes for a stop.

        A stop is a command: the robot brakes along its path, for at most its ramp from full speed to rest, and
        passes borders of nodes at speed meanwhile. What it executes is a lag behind its commands, so it also
        executes what was commanded before the stop. It begins no stretch and no skill.
        """
        robot, node = self.robots[k], event.node
        if robot.standing != STOPPED or node == 0:
            return False
        if k not in self._drives:
            chain = self._graph.chains[k]
            none = np.zeros(len(chain), dtype=np.int64)
            self._drives[k] = drive_times(chain, none, self._least_factor(k))
        drive = self._drives[k]
        if drive.length[node] <= 0.0 or drive.last[node - 1] != drive.last[node]:
            return False
        since_ns, lag = event.t_ns - robot.since_ns, int(drive.lag[node])
        passes = robot.end_ns[node - 1] == event.t_ns
        return since_ns < lag or (passes and since_ns <= lag + drive.ramp[node] + 1.0)

    def _least_factor(self, k: int) -> float:
        """Return the least speed override of a robot's stretches."""
        speed = self.speed.model_of(self.robots[k].name)
        if speed is None:
            return 1.0
        return min(float(speed.ppf(np.array([LEAST_UNIFORM]))[0]), 1.0)

    def _complete(self, k: int, event: Event) -> None:
        robot, node = self.robots[k], event.node
        if robot.end_ns[node] >= 0:
            self._flag(event, f"node {node} is complete already")
            return
        if robot.start_ns[node] < 0:
            self._flag(event, f"node {node} has not started")
        robot.take(event)
        self._dispatcher.observe(k, node)

    def _recover(self, k: int, event: Event) -> None:
        robot, node = self.robots[k], event.node
        if not (robot.failed and node == robot.under_way):
            self._flag(event, f"no attempt has failed in node {node}")
            return
        robot.take(event)
        self._dispatcher.observe(k, node)

    def _waits(self, k: int, node: int) -> list[tuple[int, int]]:
        """Return the incomplete predecessors of a node in other chains."""
        return [
            (r, u)
            for r, u in self._dispatcher.waits_for(k, node)
            if r not in self._brings or self._brings[r] in self._missed
        ]

    def _check_edges(self, k: int, event: Event) -> None:
        """Flag an event of a node with incomplete predecessors."""
        waits = self._waits(k, event.node)
        if not waits:
            return
        reasons = [
            f"{self._node(r, u)}; {CAUSES[self._cause[r, u, k, event.node]]})"
            for r, u in waits
        ]
        self._flag(
            event,
            "the plan lets it wait for " + " and ".join(reasons),
            tuple((self.robots[r].name, u) for r, u in waits),
        )

    def _node(self, chain: int, node: int) -> str:
        """Return a node as text, with an unclosed bracket."""
        task = self._graph.tasks[int(self._graph.chains[chain].task[node])]
        return f"node {node} of {self.robots[chain].name} ({task.label}"

    def _flag(
        self, event: Event, reason: str, edges: tuple[tuple[str, int], ...] = ()
    ) -> None:
        task = event.task
        known = 0 <= task < len(self.tpg.tasks)
        label = f" ({self.tpg.tasks[task].label})" if known else ""
        node = f" node {event.node}{label}" if event.node >= 0 else ""
        text = (
            f"{_seconds(event.t_ns)}: {event.robot or 'the run'} {event.kind}{node},"
            f" but {reason}"
        )
        self.violations.append(
            ForbiddenEvent(event.t_ns, event.robot, event.node, task, edges, text)
        )


def _seconds(t_ns: int) -> str:
    return f"{t_ns / NANOSECONDS:.3f} s"
