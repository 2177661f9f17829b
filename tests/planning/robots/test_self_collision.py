"""Pairs of links exempt from self-collision checks, compared with a search that measures every distance."""

from collections.abc import Callable
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.body import ConvexBody
from planning.cell.cover import capsule_cover
from planning.cell.robot_model import KinematicChain, LinkPart
from planning.geometry.exact import Solid, hull_distance_at
from planning.kinematics.chain import chain_table
from planning.robots import self_collision
from planning.robots.load_urdf import load_urdf
from planning.robots.registry import robot_model
from planning.robots.self_collision import never_colliding_pairs
from planning.transforms import Array, from_rpy

Given = tuple[KinematicChain, tuple[LinkPart, ...], Array, Array, Array]
"""Arguments of ``never_colliding_pairs``."""


def measured_pairs(
    chain: KinematicChain,
    parts: tuple[LinkPart, ...],
    lower: Array,
    upper: Array,
    home: Array,
) -> set[tuple[int, int]]:
    """Return the pairs to skip, each box and sample decided by the distance of the hulls."""
    joints = chain_table(chain, lower, upper)
    hulls = [Solid("", p.body, np.eye(4), joints, p.joint) for p in parts]
    rng = np.random.default_rng(20)
    samples = [rng.uniform(lower, upper) for _ in range(self_collision._SAMPLES)]
    found = set()
    for pair in combinations(range(len(parts)), 2):
        near, far = sorted(pair, key=lambda k: parts[k].joint)

        def distance(q: Array, a: Solid = hulls[near], b: Solid = hulls[far]) -> float:
            return hull_distance_at(a, q, b, q)

        first, last = parts[near].joint + 1, parts[far].joint + 1
        if last - first <= 1 or distance(home) <= 0.0:
            found.add(pair)
        elif all(distance(q) > 0.0 for q in samples):
            reach = displacement_bounds(chain, parts[far], lower, upper)[first:last]
            between = slice(first, last)
            if proved_apart(
                distance, chain.prismatic, reach, between, lower, upper, home
            ):
                found.add(pair)
    return found


def proved_apart(
    distance: Callable[[Array], float],
    slides: Any,
    reach: Array,
    between: slice,
    lower: Array,
    upper: Array,
    home: Array,
) -> bool:
    """Tell whether no box of joint values between two parts holds a contact, by bisection."""
    turn = np.where(slides[between], np.inf, 2.0 * np.pi)
    low = lower[between]
    boxes, made, q = [(low, np.minimum(upper[between], low + turn))], 0, home.copy()
    while boxes:
        low, high = boxes.pop()
        q[between] = (low + high) / 2.0
        gap = distance(q)
        if gap > reach @ (high - low) / 2.0:
            continue
        if made > 0 and gap <= 0.0:
            return False
        k = int(np.argmax(reach * (high - low)))
        middle = (low[k] + high[k]) / 2.0
        left, right = high.copy(), low.copy()
        left[k] = right[k] = middle
        boxes += [(low, left), (right, high)]
        made += 2
        if made > self_collision._BUDGET:
            return False
    return True


def displacement_bounds(
    chain: KinematicChain, part: LinkPart, lower: Array, upper: Array
) -> Array:
    """Return how far a part moves at most, per rad or metre of each joint before it."""
    out = np.zeros(len(lower))
    reach = np.linalg.norm(part.body.vertices, axis=1).max()
    for k in reversed(range(part.joint + 1)):
        out[k] = 1.0 if chain.prismatic[k] else reach
        reach += np.linalg.norm(chain.placement[k, :3, 3])
        if chain.prismatic[k]:
            reach += max(abs(lower[k]), abs(upper[k]))
    return out


def random_robot(seed: int, joints: int, bodies: int) -> Given:
    """Return a chain of short links that carries hulls of any size, from flat to long."""
    rng = np.random.default_rng(seed)
    placement = np.array(
        [
            from_rpy(rng.uniform(-0.3, 0.3, 3), rng.uniform(-3.0, 3.0, 3))
            for _ in range(joints)
        ]
    ).reshape(-1, 4, 4)
    axis = rng.normal(size=(joints, 3))
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    prismatic = rng.uniform(size=joints) < 0.2
    parts = []
    for k in range(bodies):
        scale = rng.uniform(0.01, 0.1) * rng.uniform(0.1, 1.0, 3)
        points = rng.normal(size=(10, 3)) * scale + rng.uniform(-0.1, 0.1, 3)
        body = ConvexBody(f"body {k}", points, capsule_cover(points))
        parts.append(LinkPart(int(rng.integers(-1, joints)), "arm", body))
    spread = np.where(prismatic, 0.2, rng.uniform(0.2, 4.0, joints))
    chain = KinematicChain(placement, axis, prismatic)
    return chain, tuple(parts), -spread, spread, rng.uniform(-0.2, 0.2, joints)


@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1), st.integers(2, 5), st.integers(2, 9))
def test_pairs_are_those_of_a_search_that_measures_each(
    seed: int, joints: int, bodies: int
) -> None:
    robot = random_robot(seed, joints, bodies)
    assert self_collision._Pairs(*robot).apart() == measured_pairs(*robot)


def test_pairs_of_a_shipped_robot_are_those_of_a_search() -> None:
    model = robot_model("fr3")
    robot = model.chain, model.parts[:8], model.lower, model.upper, model.home
    found = measured_pairs(*robot)
    assert self_collision._Pairs(*robot).apart() == found
    apart = [abs(robot[1][a].joint - robot[1][b].joint) > 1 for a, b in found]
    assert any(apart)


@pytest.mark.parametrize(("joints", "bodies"), [(0, 0), (0, 1), (2, 0), (2, 1)])
def test_a_robot_of_one_body_or_none_has_no_pairs(joints: int, bodies: int) -> None:
    robot = random_robot(0, joints, bodies)
    assert never_colliding_pairs(*robot) == frozenset()
    assert measured_pairs(*robot) == set()


def test_bodies_of_one_joint_are_all_exempt() -> None:
    robot = random_robot(0, 0, 3)
    assert never_colliding_pairs(*robot) == {(0, 1), (0, 2), (1, 2)}


def test_a_robot_of_balls_needs_few_measured_distances(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ball = "<collision><origin xyz='{} 0 0'/><geometry><sphere radius='0.05'/></geometry></collision>"
    balls = "".join(ball.format(x) for x in (0.05, 0.12, 0.2))
    links = [f"<link name='{name}'>{balls}</link>" for name in "abcd"]
    joints = [
        f"<joint name='{a}{b}' type='revolute'><parent link='{a}'/><child link='{b}'/>"
        "<origin xyz='0.25 0 0'/><axis xyz='0 0 1'/><limit lower='-2' upper='2' effort='1'"
        " velocity='1'/></joint>"
        for a, b in pairwise("abcd")
    ]
    file = tmp_path / "balls.urdf"
    file.write_text(f"<robot name='balls'>{''.join(links + joints)}</robot>")
    distance, measured = self_collision._Pairs._distance, []

    def counted(pairs: Any, *args: Any) -> float:
        measured.append(args)
        return distance(pairs, *args)

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(self_collision._Pairs, "_distance", counted)
    model = load_urdf(file)
    assert len(model.parts) == 12
    assert 33 < len(model.never_collide) < 66  # 33 of neighbours
    assert len(measured) < 400  # of some thousands
