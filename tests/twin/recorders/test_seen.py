"""What is seen in a recording: frames that lead to the world, names, words, colours, warnings, camera."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from planning.tasks.task import Task, TaskKind
from scheduling.graph.barriers import with_barriers
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.recorders.recorded_toys import recorded_run, rows, static, toy_of
from tests.twin.recorders.transform_chains import broken_chains
from tests.twin.simulated import NOMINAL
from tests.twin.twin_toys import two_robot_tpg
from twin.activities.activities import IDLE, RETRYING
from twin.activities.progress import STALLED
from twin.drawing.looks import paint_robot
from twin.drawing.team_colours import parse_rgb, team_colours
from twin.follow.follow import Silence
from twin.follow.recording import LiveRecording
from twin.follow.state import FollowedRun
from twin.rerun.camera import camera, camera_looking_at, site_points
from twin.rerun.event_rows import long_waits
from twin.rerun.plan_descriptions import PlanDescriptions
from twin.runs.events import Event
from twin.runs.execution_record import ExecutionRecord, Policy

TEAMS = {
    "arms": toy_of(["gp4", "panda", "gp4"], idle=1),
    "site": toy_of(["mobile-manipulator", "mobile-iiwa14"]),
}
Recorded = tuple[TemporalPlanGraph, ExecutionRecord, list[Event], Path]


@pytest.fixture(scope="module", params=list(TEAMS))
def recorded(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Recorded:
    path = tmp_path_factory.mktemp("seen") / "run.rrd"
    tpg = TEAMS[request.param]
    return tpg, *recorded_run(path, tpg), path


@pytest.fixture(scope="module")
def followed(recorded: Recorded) -> Path:
    """The same run as ``twin follow`` records it while it goes on."""
    tpg, _, events, path = recorded
    target = path.with_name("follow.rrd")
    state = FollowedRun(tpg)
    live = LiveRecording(state, target)
    for k, event in enumerate(events):
        state.apply(event)
        live(event)
        if k % 7 == 0:
            live(Silence(0.0))
    live(state)
    return target


def test_every_frame_leads_to_the_world_from_the_first_row_on(
    recorded: Recorded, followed: Path
) -> None:
    assert broken_chains(recorded[-1]) == []
    assert broken_chains(followed) == []


def test_a_part_that_comes_up_later_is_drawn_from_then_on(
    recorded: Recorded, followed: Path
) -> None:
    _, _, events, path = recorded
    comes = next(e for e in events if e.object == "later").t_ns
    assert comes > 0
    for file in (path, followed):
        for entity in ("/objects/later", "/objects/later/edges"):
            shown = rows(file, entity, "Boxes3D:half_sizes")
            assert [(t, len(cell or ())) for t, cell in shown] == [(0, 0), (comes, 1)]


def test_robots_are_named_and_so_is_what_they_hold(
    recorded: Recorded, followed: Path
) -> None:
    tpg, _, events, path = recorded
    taken = [event for event in events if event.kind == "attached"]
    for file in (path, followed):
        for robot in tpg.cell.robots:
            expected = {0: robot.name}
            for event in events:
                held = [e for e in taken if e.t_ns <= event.t_ns]
                if event.kind == "attached" and event.robot == robot.name:
                    expected[event.t_ns] = f"{robot.name}: {event.object}"
                elif (
                    event.kind == "detached"
                    and held
                    and (held[-1].robot, held[-1].object) == (robot.name, event.object)
                ):
                    expected[event.t_ns] = robot.name
            entity = f"/robot-{robot.name}/name"
            shown = rows(file, entity, "Points3D:labels")
            assert {t: cell[0] for t, cell in shown} == expected
            assert static(file, entity, "Points3D:show_labels") == [True]
    assert len(taken) == 2


def test_events_are_told_in_sentences(recorded: Recorded, followed: Path) -> None:
    tpg, _, events, path = recorded
    for file in (path, followed):
        told = [cell[0] for _, cell in rows(file, "/events", "TextLog:text")]
        for event in events:
            task = tpg.tasks[event.task]
            step = f"(step {task.step}/{tpg.tasks[-1].step})"
            if event.kind == "attached":
                assert f"{event.robot} holds {event.object}" in told
            elif event.kind == "started":
                assert f"{event.robot} started {task.label} {step}" in told
        assert "run finished: completed" in told


def test_curves_have_the_colours_of_the_robots(recorded: Recorded) -> None:
    tpg, _, _, path = recorded
    colours = team_colours([robot.name for robot in tpg.cell.robots])
    for chain in tpg.chains:
        styled = static(path, f"/progress/{chain.robot}", "SeriesLines:colors")
        assert styled == [int(f"{colours[chain.robot][1:]}ff", 16)]


def test_paint_covers_what_is_coloured_and_tints_white_meshes() -> None:
    visual = '<link name="a"><visual><geometry>{}</geometry>{}</visual></link>'.format
    coat = '<material name="{0}"><color rgba="{1} 1"/></material>'.format
    box, mesh = '<box size="1 1 1"/>', '<mesh filename="a.dae"/>'
    steel, white = coat("steel", "0.6 0.6 0.6"), coat("white", "1 1 1")
    looks = {
        "own": visual(box, coat("body", "0.9 0.4 0.1")),
        "grey": visual(box, steel),
        "named": coat("far", "0.1 0.1 0.9") + visual(box, '<material name="far"/>'),
        "mesh": visual(mesh, white),
        "grey mesh": visual(mesh, steel),
        "bare mesh": visual(mesh, ""),
        "white": visual(box, white),
    }
    seen = {}
    for name, body in looks.items():
        root = ElementTree.fromstring(f"<robot>{body}</robot>")
        paint_robot(root, (255, 0, 0))
        color = root.find(".//visual/material/color")
        seen[name] = (
            [] if color is None else [float(c) for c in color.attrib["rgba"].split()]
        )
    assert seen["own"] == seen["named"] == [1, 0, 0, 1]
    assert seen["grey"] == seen["grey mesh"] == [0.6, 0.6, 0.6, 1]
    assert seen["white"] == [1, 1, 1, 1]
    assert seen["mesh"] == seen["bare mesh"]
    red, green, blue, _ = seen["mesh"]
    assert red == 1.0
    assert 0.4 < green == blue < 0.6


# Sight without one kind of cone, by Machado, Oliveira and Fernandes (2009), on linear channels.
BLIND = {
    "none": np.eye(3),
    "protan": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deutan": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
}


@pytest.mark.parametrize("sight", BLIND)
def test_colours_of_a_team_stay_apart_for_colour_blind_eyes(sight: str) -> None:
    names = [f"robot_{k}" for k in range(8)]
    seen = [_lab(BLIND[sight] @ _linear(c)) for c in team_colours(names).values()]
    apart = [float(np.linalg.norm(a - b)) for a, b in combinations(seen, 2)]
    assert min(apart) > 12.0  # 2.3 is what can just be told
    many = list(team_colours([f"robot_{k}" for k in range(16)]).values())
    assert len(set(many)) == 16
    assert many[:8] == list(team_colours(names).values())


def _linear(colour: str) -> np.ndarray:
    s = np.array(parse_rgb(colour)) / 255.0
    return np.where(s <= 0.04045, s / 12.92, ((s + 0.055) / 1.055) ** 2.4)


def _lab(linear: np.ndarray) -> np.ndarray:
    """Return CIE L*a*b* of linear sRGB channels."""
    to_xyz = [
        [0.4124, 0.3576, 0.1805],
        [0.2126, 0.7152, 0.0722],
        [0.0193, 0.1192, 0.9505],
    ]
    white = np.array([0.9505, 1.0, 1.089])
    f = np.cbrt(np.maximum(np.array(to_xyz) @ np.clip(linear, 0, 1), 1e-6) / white)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def test_only_waits_of_half_a_second_are_warnings(
    recorded: Recorded, followed: Path
) -> None:
    tpg, run, events, path = recorded
    length = {
        (tpg.chains[wait.chain].robot, wait.node): wait.end_ns - wait.start_ns
        for wait in run.waits()
    }
    for file in (path, followed):
        levels = rows(file, "/events", "TextLog:level")
        kinds = rows(file, "/events", "kind")
        nodes = rows(file, "/events", "node")
        robots = rows(file, "/events", "robot")
        waits = 0
        for (_, level), (_, kind), (_, node), (_, robot) in zip(
            levels, kinds, nodes, robots, strict=True
        ):
            if kind == ["waiting"]:
                long = length[robot[0], node[0]] >= 5e8
                assert level == (["WARN"] if long else ["DEBUG"])
                waits += 1
        assert waits == sum(event.kind == "waiting" for event in events) > 0


def test_a_wait_under_way_is_long_once_it_has_lasted() -> None:
    events = [
        Event(0, "a", "waiting", node=1),
        Event(2 * 10**8, "b", "waiting", node=1),
        Event(3 * 10**8, "a", "started", node=1),
    ]
    assert long_waits(events, 3 * 10**8) == {0: False, 1: None}
    assert long_waits(events, 7 * 10**8) == {0: False, 1: True}


def test_followed_lanes_say_what_recorded_ones_do(
    recorded: Recorded, followed: Path
) -> None:
    tpg, _, _, path = recorded
    for chain in tpg.chains:
        entity = f"/lanes/{chain.robot}"
        whole = dict(rows(path, entity, "StateChange:state"))
        live = rows(followed, entity, "StateChange:state")
        known = set(static(followed, entity, "StateConfiguration:values"))
        assert {cell[0] for _, cell in live} <= known
        for t, cell in live:
            assert t not in whole or whole[t] in (cell, [""])


@pytest.mark.parametrize("team", TEAMS)
def test_the_camera_sees_all_of_the_site_from_near(team: str) -> None:
    tpg = TEAMS[team]
    view = camera(tpg)
    assert view.position is not None
    assert view.look_target is not None
    eye = np.array(view.position.as_arrow_array().to_pylist()[0])
    target = np.array(view.look_target.as_arrow_array().to_pylist()[0])
    points = site_points(tpg)
    for item in tpg.cell.objects:
        assert np.all(points.min(axis=0) <= item.start[:3, 3])
        assert np.all(points.max(axis=0) >= item.start[:3, 3])
    seen = np.abs(_in_picture(points, eye, target, 16 / 9))
    assert seen.max() <= 1.0
    assert seen.max() > 0.9
    assert eye[2] > target[2]


def test_an_eye_sees_what_it_looks_at_wherever_that_is() -> None:
    rng = np.random.default_rng(0)
    for scale in (0.5, 1.0, 30.0):
        points = scale * rng.uniform([-3, -1, 0], [1, 2, 0.5], (50, 3)) + 7.0
        towards = np.array([0.4, -0.7, 0.5])
        target, eye = camera_looking_at(points, towards / np.linalg.norm(towards))
        seen = np.abs(_in_picture(points, eye, target, 16 / 9))
        assert 0.85 < seen.max() <= 1.0


def _in_picture(
    points: np.ndarray, eye: np.ndarray, target: np.ndarray, aspect: float
) -> np.ndarray:
    """Project points as an eye with a vertical angle of 55 degrees does; its edges are at 1."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    side = np.cross(forward, [0, 0, 1])
    side /= np.linalg.norm(side)
    up = np.cross(side, forward)
    rays = points - eye
    depth = rays @ forward
    assert np.all(depth > 0)
    half = np.tan(np.radians(27.5))
    return np.stack(
        [rays @ side / depth / half / aspect, rays @ up / depth / half], axis=1
    )


PATH = np.zeros((1, 1))
SAID = {
    ("pick b1", "pick", 1, "b1"): "pick b1 (step 1/3)",
    ("HOME with b1", TaskKind.TRANSIT, 1, "b1"): "HOME with b1 (step 1/3)",
    ("to b1", TaskKind.TRANSIT, 1, None): "to b1 (step 1/3)",
    ("to b1", TaskKind.TRANSIT, 1, "b1"): "b1 to its place (step 1/3)",
    ("HOME", TaskKind.TRANSIT, 1, None): "HOME after b1 (step 1/3)",
    ("to its support", TaskKind.TRANSIT, 2, None): "to its support for b2 (step 2/3)",
    ("support step 2", "support-bottom", 2, None): "support for b2 (step 2/3)",
    ("place b2 from below", "place-up", 2, "b2"): "place b2 from below (step 2/3)",
    ("to goal 3", TaskKind.TRANSIT, 3, None): "to goal 3 (step 3/3)",
}


def test_tasks_name_part_and_step() -> None:
    tasks = tuple(
        Task(k, "robot_0", kind, step, label, PATH, object=part)
        for k, (label, kind, step, part) in enumerate(SAID)
    )
    words = PlanDescriptions(replace(two_robot_tpg([]), tasks=tasks))
    assert [words.task(k) for k in range(len(tasks))] == list(SAID.values())
    assert words.task(-1) == words.task(len(tasks)) == ""
    assert words.state(STALLED, 0) == "stalled: pick b1 (step 1/3)"
    assert words.state(RETRYING, 0) == "tries again: pick b1 (step 1/3)"
    assert words.state("pick", 0) == "pick b1 (step 1/3)"
    assert words.state(IDLE, 0) == IDLE
    assert words.state(STALLED, -1) == STALLED


def test_waits_name_robot_and_task_until_it_is_complete() -> None:
    words = PlanDescriptions(two_robot_tpg([(0, 0, 1, 1), (0, 2, 1, 1)]))
    done = {(0, 0)}
    assert words.wait(1, 1, lambda *node: node in done) == (
        "waits for robot_0: transit 0 (step 1/1)"
    )
    done.add((0, 2))
    assert words.wait(1, 1, lambda *node: node in done) == ""
    assert words.wait(1, 0, lambda *_: False) == ""
    assert ("waits for robot_0: transit 0 (step 1/1)", "waiting") in words.lane(1)


@pytest.mark.parametrize(
    "policy", ["asynchronous", "sequential", "synchronous", "open-loop"]
)
def test_waits_are_told_under_every_policy(policy: Policy, tmp_path: Path) -> None:
    tpg = toy_of(["gp4", "gp4"])
    tpg = replace(tpg, slots=np.arange(len(tpg.tasks)))
    path = tmp_path / "run.rrd"
    run, events = recorded_run(path, tpg, NOMINAL, policy=policy)
    texts = [cell[0] for _, cell in rows(path, "/events", "TextLog:text")]
    told = [text for text in texts if " waits for " in text]
    waits = [event for event in events if event.kind == "waiting"]
    assert len(told) == len(waits) > 0
    graph = with_barriers(tpg) if policy == "synchronous" else tpg
    for text, event in zip(told, waits, strict=True):
        assert "node" not in text
        if policy == "open-loop":
            assert text == f"{event.robot} {event.detail}"
            continue
        k = tpg.chain_index[event.robot]
        sources = {
            f"{event.robot} waits for {graph.chains[a].robot}: task"
            for a, m, b, n in graph.edges.tolist()
            if (b, n) == (k, event.node) and run.end_ns[a][m] > event.t_ns
        } or {f"{event.robot} {event.detail}"}
        assert any(text.startswith(source) for source in sources)
