"""How far a robot was from its path: against points of it that lie close together."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.kinematics.kinematics import frame_pose
from tests.twin.twin_toys import random_tpg
from twin.run.events import Measured
from twin.run.tracking import nearest_on_path, tracking_errors


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_nearest_point_is_that_of_a_dense_search(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tpg = random_tpg(seed % 1000, tasks=6)
    chain = tpg.chains[0]
    node = np.sort(rng.integers(-1, len(chain), 12))
    q = rng.uniform(-1.0, 1.0, (12, chain.waypoints.shape[1]))
    found = nearest_on_path(chain, q, node)
    path = np.vstack([chain.start, chain.waypoints])
    for row, n in enumerate(node.tolist()):
        low, high = max(n - 1, 0), min(max(n, 0) + 2, len(chain))
        own = path[chain.first[low] : chain.first[high] + 1]
        dense = np.vstack(
            [np.linspace(a, b, 400) for a, b in zip(own, own[1:], strict=False)]
        )
        # Of each leg the point that is nearest as the crow flies, then the leg that is least off by a joint.
        legs = dense.reshape(len(own) - 1, 400, -1)
        nearest = [leg[np.linalg.norm(leg - q[row], axis=1).argmin()] for leg in legs]
        least = min(float(np.abs(p - q[row]).max()) for p in nearest)
        assert abs(float(np.abs(found[row] - q[row]).max()) - least) < 0.01


def test_who_is_on_the_path_is_off_by_nothing_and_who_is_beside_it_by_that() -> None:
    tpg = random_tpg(4, dofs=(3,), tasks=4)
    chain = tpg.chains[0]
    node = np.repeat(np.arange(len(chain)), np.diff(chain.first))
    times = np.arange(len(node))
    assert tracking_errors(
        tpg, {"robot_0": Measured(times, chain.waypoints, node)}
    ) == {"robot_0": (0.0, 0.0)}
    aside = chain.waypoints + np.array([0.0, 0.0, 5.0])
    (found,) = tracking_errors(tpg, {"robot_0": Measured(times, aside, node)}).values()
    assert found.joint > 1.0
    robot = tpg.cell.robots[0]
    far = [
        np.linalg.norm(
            frame_pose(robot, a, "tool")[:3, 3] - frame_pose(robot, b, "tool")[:3, 3]
        )
        for a, b in zip(aside, nearest_on_path(chain, aside, node), strict=True)
    ]
    assert found.tool_m == max(far)
