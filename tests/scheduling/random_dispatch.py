"""Nodes started and completed in any order the dispatcher allows, each pair looked at."""

import numpy as np

from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.scheduling.algorithm_one import Piece, PlainGraph


def run_at_random(
    tpg: TemporalPlanGraph,
    plain: PlainGraph,
    rng: np.random.Generator,
    met: set[tuple[object, object]],
) -> None:
    """Start and complete nodes in any order the dispatcher allows; look at every pair."""
    dispatcher = Dispatcher(tpg)
    active: dict[int, int] = {}
    favourite = int(rng.integers(len(tpg.chains)))
    while not dispatcher.finished:
        ready = [n for n in dispatcher.ready() if n[0] not in active]
        moves = [("start", n) for n in ready]
        moves += [("complete", (r, n)) for r, n in active.items()]
        assert moves, "deadlock"
        # One robot is much quicker than the others, so delays are long.
        quick = [m for m in moves if m[1][0] == favourite]
        if quick and rng.random() < 0.8:
            moves = quick
        elif rng.random() < 0.1:
            favourite = int(rng.integers(len(tpg.chains)))
        what, (robot, node) = moves[int(rng.integers(len(moves)))]
        if what == "complete":
            del active[robot]
            dispatcher.complete(robot, node)
            continue
        active[robot] = node
        for other in range(len(tpg.chains)):
            if other == robot:
                continue
            if other in active:
                pair = ((other, active[other]), (robot, node))
                if pair not in met:
                    met.add(pair)
                    u, v = sorted(pair, key=plain.place.__getitem__)
                    assert (u, v) not in plain.conflicts
            else:
                hold = dispatcher.completed(other) - 1
                held = (("hold", other, hold), (robot, node))
                if held not in met:
                    met.add(held)
                    _check_hold(plain, other, hold, (robot, node), rng)


def _check_hold(
    plain: PlainGraph,
    other: int,
    hold: int,
    node: tuple[int, int],
    rng: np.random.Generator,
) -> None:
    stands = plain.stands(other, hold)
    tasks = plain.tpg.chains[other].task
    near = {int(tasks[k]) for k in (hold, hold + 1) if 0 <= k < len(tasks)}
    for _ in range(2):
        for piece, q in _random_point(plain, *node, rng):
            for still in plain.hold_pieces(other, hold):
                if any(
                    plain.may_touch(piece.entity, still.entity, (plain.task(node), t))
                    for t in near
                ):
                    continue
                assert not plain.overlap(piece, q, still, stands)


def _random_point(
    plain: PlainGraph, robot: int, node: int, rng: np.random.Generator
) -> list[tuple[Piece, np.ndarray]]:
    """Bodies of a node, each somewhere on its motion (a skill node: in any of its parts)."""
    share = rng.random()
    path = plain.path((robot, node))
    k = int(rng.integers(len(path) - 1))
    q = path[k] + share * (path[k + 1] - path[k])
    out = []
    for piece in plain.pieces[(robot, node)]:
        if piece.solid.carrier is None or (
            np.array_equal(piece.q_a, path[k])
            and np.array_equal(piece.q_b, path[k + 1])
        ):
            out.append((piece, q))
    return out
