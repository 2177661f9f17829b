"""Algorithm 1 of APEX-MR as it is written, slow and plain: the oracle of the fast search.

No capsules, no trees, no segments, no clocks: every pair of nodes, every pair of bodies but those
whose balls are apart, and networkx for the reduction. Occupancies are swept, so an edge starts at
the conflicting node.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import networkx as nx
import numpy as np
from scipy.spatial.distance import cdist

from planning.cell.workcell import Attachment
from planning.geometry.exact import (
    TOLERANCE,
    Solid,
    hull_distance_at,
    may_come_close,
    place_at_middle,
    resting_solid,
)
from planning.kinematics.chain import placed_joints
from planning.kinematics.kinematics import frame_pose
from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph

Node = tuple[int, int]


def graph_of(sizes: Iterable[int], edges: Indices) -> "nx.DiGraph[Node]":
    """Chains of so many nodes each, and type-2 edges between them."""
    graph: nx.DiGraph[Node] = nx.DiGraph()
    for r, size in enumerate(sizes):
        nodes = [(r, n) for n in range(size)]
        graph.add_nodes_from(nodes)
        nx.add_path(graph, nodes)
    graph.add_edges_from(((r, u), (s, v)) for r, u, s, v in np.asarray(edges).tolist())
    return graph


def order_of(tpg: TemporalPlanGraph) -> "nx.DiGraph[Node]":
    """What precedes what in a graph; it has no cycle."""
    graph = graph_of(map(len, tpg.chains), tpg.edges)
    assert nx.is_directed_acyclic_graph(graph)
    return graph


def check_conflicts_are_ordered(tpg: TemporalPlanGraph) -> None:
    """Require that of two nodes that conflict the later one waits."""
    graph = order_of(tpg)
    behind = {node: nx.descendants(graph, node) for node in graph}
    for u, v in PlainGraph(tpg, -TOLERANCE).conflicts:
        assert v in behind[u], (u, v)


@dataclass(frozen=True)
class Piece:
    """A body and the straight motion that carries it."""

    entity: str
    solid: Solid
    q_a: Array
    q_b: Array

    @cached_property
    def ball(self) -> tuple[Array, float]:
        """Centre and radius of a ball that the body is in, wherever it is on its motion."""
        pose, strays = place_at_middle(self.solid, self.q_a, self.q_b)
        corners = self.solid.vertices
        if self.solid.carrier is not None:
            turn, shift = self.solid.local[:3, :3], self.solid.local[:3, 3]
            corners = (corners - shift) @ turn
        middle = corners.mean(axis=0)
        radius = np.linalg.norm(corners - middle, axis=1).max()
        centre = pose.getRotation() @ middle + pose.getTranslation()
        return centre, float(radius + strays)


class PlainGraph:
    """All nodes of a graph with what they occupy, found by walking through the plan in order.

    ``slack`` is added to the clearances [m].
    """

    def __init__(self, tpg: TemporalPlanGraph, slack: float = 0.0) -> None:
        self.tpg = tpg
        self.slack = slack
        self.nodes: list[Node] = sorted(
            ((r, n) for r, c in enumerate(tpg.chains) for n in range(len(c))),
            key=lambda x: (
                tpg.chains[x[0]].planned_start[x[1]],
                tpg.chains[x[0]].task[x[1]],
                x[1],
            ),
        )
        self.place = {node: k for k, node in enumerate(self.nodes)}
        self.allowed = [(frozenset((a.first, a.second)), a.tasks) for a in tpg.allowed]
        self.joints = [placed_joints(tpg.cell.robot(c.robot)) for c in tpg.chains]
        self._walk()

    def path(self, node: Node) -> Array:
        """Waypoints of a node, the one before it first."""
        r, n = node
        chain = self.tpg.chains[r]
        a, b = chain.first[n], chain.first[n + 1]
        before = chain.start if a == 0 else chain.waypoints[a - 1]
        return np.vstack([before[None], chain.waypoints[a:b]])

    def stands(self, robot: int, node: int) -> Array:
        """Configuration after a node, -1 for the start."""
        if node < 0:
            return self.tpg.chains[robot].start
        last: Array = self.path((robot, node))[-1]
        return last

    def _walk(self) -> None:
        tpg = self.tpg
        where = {o.name: Attachment(None, o.start) for o in tpg.cell.objects}
        names = [c.robot for c in tpg.chains]
        last = [-1] * len(names)
        self.pieces: dict[Node, list[Piece]] = {}
        # Objects that may be met between nodes: after the node counted k in planned order.
        self.carried_after: dict[Node, list[tuple[str, Array]]] = {}

        for node in self.nodes:
            r, n = node
            out: list[Piece] = []
            path = self.path(node)
            events = sorted(
                (h for h in tpg.handlings if (h.robot, h.node) == node),
                key=lambda h: h.waypoint,
            )
            touched = {h.object for h in events}

            for name in touched:
                out += self._resting(r, name, where, last, path[0])
            for k in range(len(path)):
                for event in (e for e in events if e.waypoint == k):
                    where[event.object] = Attachment(event.holder, event.pose)
                    out += self._resting(r, event.object, where, last, path[0])
                if k + 1 < len(path):
                    out += self._robot(r, path[k], path[k + 1])
                    for name, at in where.items():
                        if at.holder == names[r]:
                            out.append(
                                self._carried(r, name, at.pose, path[k], path[k + 1])
                            )
            self.pieces[node] = out
            last[r] = n
            self.carried_after[node] = [
                (name, at.pose) for name, at in where.items() if at.holder == names[r]
            ]

    def _resting(
        self, r: int, name: str, where: dict[str, Attachment], last: list[int], q: Array
    ) -> list[Piece]:
        """An object in the world, or in the hand of another robot, which stands."""
        names = [c.robot for c in self.tpg.chains]
        at = where[name]
        if at.holder == names[r]:
            return []
        pose = at.pose
        if at.holder is not None:
            other = names.index(at.holder)
            stands = self.stands(other, last[other])
            pose = frame_pose(self.tpg.cell.robot(at.holder), stands) @ at.pose
        (body,) = self.tpg.cell.object(name).shape.pieces
        return [Piece(name, resting_solid(name, body, pose), q, q)]

    def _robot(self, r: int, q_a: Array, q_b: Array) -> list[Piece]:
        name = self.tpg.chains[r].robot
        model = self.tpg.cell.robot(name).model
        return [
            Piece(
                f"{name}/{p.group}",
                Solid("", p.body, np.eye(4), self.joints[r], p.joint),
                q_a,
                q_b,
            )
            for p in model.parts
        ]

    def _carried(self, r: int, name: str, pose: Array, q_a: Array, q_b: Array) -> Piece:
        model = self.tpg.cell.robot(self.tpg.chains[r].robot).model
        local = model.flange @ pose
        (body,) = self.tpg.cell.object(name).shape.pieces
        solid = Solid(name, body, local, self.joints[r], model.dof - 1)
        return Piece(name, solid, q_a, q_b)

    def task(self, node: Node) -> int:
        return int(self.tpg.chains[node[0]].task[node[1]])

    def may_touch(self, x: str, y: str, tasks: tuple[int, ...]) -> bool:
        if x == y:
            return True
        pair = frozenset((x, y))
        return any(pair == p and set(tasks) <= t for p, t in self.allowed)

    def limit(self, a: Piece, b: Piece) -> float:
        """The least distance: what is carried keeps the robots' clearance, as a robot does."""
        robots = all("/" in p.entity or p.solid.carrier is not None for p in (a, b))
        clearances = self.tpg.cell.clearances
        least = clearances.robot_robot if robots else clearances.robot_object
        return least + self.slack

    def conflict(self, u: Node, v: Node, a: Piece, b: Piece) -> bool:
        """Tell whether a body of one node may meet one of another, anywhere on both motions."""
        if a.solid.carrier is None and b.solid.carrier is None:
            return False
        if self.may_touch(a.entity, b.entity, (self.task(u), self.task(v))):
            return False
        limit = self.limit(a, b)
        return may_come_close(a.solid, a.q_a, a.q_b, b.solid, b.q_a, b.q_b, limit)

    @cached_property
    def conflicts(self) -> set[tuple[Node, Node]]:
        """All conflicting pairs of nodes of different robots, the earlier one first."""
        bodies = [(node, piece) for node in self.nodes for piece in self.pieces[node]]
        centre = np.array([piece.ball[0] for _, piece in bodies])
        radius = np.array([piece.ball[1] for _, piece in bodies])
        clearances = self.tpg.cell.clearances
        most = max(clearances.robot_robot, clearances.robot_object) + self.slack + 1e-6
        near = cdist(centre, centre) < radius[:, None] + radius[None] + most
        out: set[tuple[Node, Node]] = set()
        for i, j in np.argwhere(np.triu(near, 1)).tolist():
            (u, a), (v, b) = bodies[i], bodies[j]
            if u[0] != v[0] and (u, v) not in out and self.conflict(u, v, a, b):
                out.add((u, v))
        return out

    def reduced_edges(self, task_edges: Indices) -> set[tuple[int, int, int, int]]:
        """Type-2 edges of the transitive reduction of the graph with every raw edge."""
        graph = graph_of(map(len, self.tpg.chains), task_edges)
        graph.add_edges_from(self.conflicts)
        reduced = nx.transitive_reduction(graph)
        return {(*u, *v) for u, v in reduced.edges if u[0] != v[0]}

    def hold_pieces(self, robot: int, node: int) -> list[Piece]:
        """What a robot occupies when it stands after a node, -1 for before its first."""
        q = self.stands(robot, node)
        held = self.carried_after.get((robot, node), [])
        return self._robot(robot, q, q) + [
            self._carried(robot, name, pose, q, q) for name, pose in held
        ]

    def overlap(self, a: Piece, at_a: Array, b: Piece, at_b: Array) -> bool:
        """Tell whether two bodies are closer than allowed at two configurations."""
        if a.entity == b.entity:
            return False
        limit = self.limit(a, b) - TOLERANCE
        return hull_distance_at(a.solid, at_a, b.solid, at_b) < limit
