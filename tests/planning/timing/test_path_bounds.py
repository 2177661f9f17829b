"""Rounded corners within limits of effort and tool speed, against dense sampling by pinocchio."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from planning.kinematics.chain import joint_table
from planning.robots.registry import robot_model
from planning.timing.blended_path import BlendedPath, ordered_windows
from planning.timing.path_bounds import PathBounds
from planning.timing.stretch import RoundedStretch, rounded_stretch, straight_stretch
from planning.timing.tool_speed import greatest_tool_speed, tool_speed_along
from tests.planning.timing.drawn_arm import MODELS, Drawn, PinocchioArm
from twin.runs.cubic_motion import cubic_at


def drawn_path(drawn: Drawn) -> BlendedPath:
    """Return a way with one to four rounded corners at the full speed of joints."""
    count = int(drawn.rng.integers(1, 5))
    points = [drawn.configuration()]
    for _ in range(count + 1):
        far = drawn.rng.choice([1.0, 0.3])
        points.append(points[-1] + far * (drawn.configuration() - points[-1]))
    ways = np.diff(points, axis=0)
    cruise = [straight_stretch(drawn.limits, way).cruise for way in ways]
    at = np.concatenate([[0.0], np.cumsum(cruise)])
    most = 10.0 ** drawn.rng.uniform(-1.5, 0.5, count)
    window = ordered_windows(at[1:-1], most, 0.0, float(at[-1]))
    return BlendedPath(at, np.array(points), window)


def slower(path: BlendedPath, factor: float) -> BlendedPath:
    return BlendedPath(path.at * factor, path.points, path.window * factor)


def worst(
    drawn: Drawn, path: BlendedPath, found: RoundedStretch
) -> tuple[float, float]:
    """Return the greatest shares of effort on legs and on bent pieces, however they are passed."""
    way = np.linspace(0.0, path.at[-1], 500)
    bent = path.bent_pieces()
    own = [np.linspace(a, b, 25) for a, b in zip(bent.low, bent.high, strict=True)]
    velocity = path.velocity
    leg = np.clip(np.searchsorted(path.at, way) - 1, 0, len(velocity) - 1)
    q = path.points[leg] + (way - path.at[leg])[:, None] * velocity[leg]
    legs = max(
        drawn.worst(q, speed * velocity[leg], rate * velocity[leg])
        for speed in (0.0, 1.0)
        for rate in (-1.0 / found.ramp, 1.0 / found.ramp)
    )
    bends = 0.0
    for k, piece in enumerate(own):
        q, first, second = path.states(piece)
        for speed in (0.0, 0.5 * found.cap[k], found.cap[k]):
            for rate in (-1.0 / found.bent_ramp, 1.0 / found.bent_ramp):
                rise = first * rate + second * speed**2
                bends = max(bends, drawn.worst(q, speed * first, rise))
    return legs, bends


@pytest.mark.parametrize("name", MODELS)
@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10**6))
def test_joints_bear_rounded_corners_and_little_is_given_away(
    name: str, seed: int
) -> None:
    drawn = Drawn(name, seed)
    path = drawn_path(drawn)
    assume(np.min(path.window) > 1e-4)
    weight = [
        drawn.dynamics.gravity(q)
        for q in path.states(np.linspace(0, path.at[-1], 200))[0]
    ]
    assume(np.all(np.abs(weight) < 0.9 * drawn.effort))
    path = slower(path, drawn.dynamics.along_legs(path).full_speed_factor())
    bent = path.bent_pieces()
    efforts = drawn.dynamics.along_rounded(path, bent)
    free = rounded_stretch(drawn.limits, path)
    bounds = PathBounds(np.ones(len(bent.low)), efforts)
    found = rounded_stretch(drawn.limits, path, bounds)
    assert free is not None
    assert found is not None
    assert max(worst(drawn, path, found)) <= 1.0 + 1e-6
    # Of the times to full speed only some are tried: those of the one may suit better.
    assert found.seconds >= 0.99 * free.seconds
    if max(worst(drawn, path, free)) < 0.9:
        # What joints bear anyhow costs next to nothing.
        assert found.seconds <= 1.01 * free.seconds
    joint = efforts.nearest(found.ramp, found.bent_ramp, found.cap)
    assert 0 <= joint < drawn.robot.model.dof


def test_where_gravity_leaves_nothing_no_corner_is_passed() -> None:
    drawn = Drawn("ur5e", 0)
    path = drawn_path(drawn)
    bent = path.bent_pieces()
    efforts = drawn.dynamics.along_rounded(path, bent)
    spare = np.full_like(efforts.legs.spare, -1.0)
    heavy = efforts._replace(legs=efforts.legs._replace(spare=spare))
    bounds = PathBounds(np.ones(len(bent.low)), heavy)
    assert rounded_stretch(drawn.limits, path, bounds) is None
    assert heavy.legs.full_speed_factor() == 1.0


def test_a_tool_is_no_faster_around_corners_than_it_may_be() -> None:
    drawn = Drawn("ur5e", 1)
    path = drawn_path(drawn)
    cap = np.full(len(path.bent_pieces().low), 0.25)
    found = rounded_stretch(drawn.limits, path, PathBounds(cap))
    assert found is not None
    assert np.all(found.cap <= 0.25)


ARMS = ("ur5e", "iiwa14", "gp4", "mobile-manipulator", "tower-crane")


@pytest.mark.parametrize("name", ARMS)
@settings(deadline=None, max_examples=15)
@given(st.integers(0, 10**6))
def test_along_straight_lines(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = robot_model(name)
    low, high = np.maximum(model.lower, -3.0), np.minimum(model.upper, 3.0)
    start, end = rng.uniform(low, high), rng.uniform(low, high)
    way = (end - start) * rng.choice([1.0, 0.3, 0.01])
    way[rng.random(model.dof) < 0.3] = 0.0
    tip = model.frame_in_last_joint("tool")[:3, 3]
    bound = tool_speed_along(joint_table(model), tip, start, way)
    shares = np.linspace(0.0, 1.0, 400)
    q = start + shares[:, None] * way
    most = PinocchioArm(model).tool_speeds(q, np.tile(way, (len(q), 1))).max()
    assert most <= bound + 1e-9
    assert bound <= most * 1.005 + 1e-3 * np.abs(way).sum()


@pytest.mark.parametrize("name", ["ur5e", "mobile-manipulator"])
@settings(deadline=None, max_examples=15)
@given(st.integers(0, 10**6))
def test_along_cubic_motions(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = robot_model(name)
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 0.5, 3))])
    a = rng.normal(size=(4, model.dof)) * 3.0
    v, q = [rng.normal(size=model.dof)], [model.home]
    for k, h in enumerate(np.diff(t)):
        q.append(q[-1] + h * v[-1] + h * h * (2.0 * a[k] + a[k + 1]) / 6.0)
        v.append(v[-1] + h * (a[k] + a[k + 1]) / 2.0)
    rows = t, np.array(q), np.array(v), a
    tip = model.frame_in_last_joint("tool")[:3, 3]
    bound = greatest_tool_speed(joint_table(model), tip, *rows)
    at, rate, _ = cubic_at(t, rows[1], rows[2], np.linspace(0.0, t[-1], 600))
    most = PinocchioArm(model).tool_speeds(at, rate).max()
    assert most <= bound + 1e-9
    assert bound <= most * 1.005 + 1e-3
