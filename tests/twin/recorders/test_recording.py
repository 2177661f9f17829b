import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Annotation
from rerun.chunk import RrdReader

from planning.cell.shape import Cylinder, Element, box_shape, shape_of
from planning.cell.workcell import Fixture, PlacedRobot
from planning.kinematics.kinematics import joint_poses_of
from planning.robots.descriptions.fitting import Fitting, Tool
from planning.robots.registry import robot_model
from planning.transforms import from_quat_wxyz, from_rpy, identity, translation
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.activities.lane_oracle import robot_lanes
from tests.twin.drawn_runs import VARIED
from tests.twin.recorders.recorded_toys import moved_by, recorded_run, rows, static
from tests.twin.simulated import watched
from tests.twin.twin_toys import random_tpg
from twin.activities.activities import WAITING
from twin.drawing.gantt import gantt_figure
from twin.drawing.lane_colours import LANE_COLOURS
from twin.drawing.team_colours import parse_rgb, team_colours
from twin.durations.nanoseconds import NANOSECONDS
from twin.engine.execution_model import Messages
from twin.host.atomic_files import save_png
from twin.rerun.bodies import frame_times
from twin.runs.events import Event
from twin.runs.execution_record import ExecutionRecord
from twin.runs.trajectory import object_placements, robot_trajectories


def gp4_tpg() -> TemporalPlanGraph:
    """Two GP4 that face each other, in random motion."""
    tpg = random_tpg(4, dofs=(6, 6), tasks=10, edges=16)
    model = robot_model("gp4")
    bases = (from_rpy((0, 0, 0.9), (0, 0, 0)), from_rpy((0.9, 0, 0.9), (0, 0, np.pi)))
    robots = tuple(
        PlacedRobot(f"robot_{k}", model, base, model.home)
        for k, base in enumerate(bases)
    )
    return replace(tpg, cell=replace(tpg.cell, robots=robots))


Recorded = tuple[TemporalPlanGraph, ExecutionRecord, list[Event], Path]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    path = tmp_path_factory.mktemp("recording") / "run.rrd"
    tpg = gp4_tpg()
    return tpg, *recorded_run(path, tpg), path


def test_the_file_verifies(recorded: Recorded) -> None:
    program = Path(sys.executable).parent / "rerun"
    done = subprocess.run(
        [program, "rrd", "verify", str(recorded[-1])],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def test_the_layout_travels_with_the_file(recorded: Recorded) -> None:
    assert len(list(RrdReader(recorded[-1]).blueprints())) == 1


def test_the_recording_holds_the_event_rows(recorded: Recorded) -> None:
    _, _, events, path = recorded
    for column in ("robot", "kind", "node", "object", "detail"):
        cells = rows(path, "/events", column)
        assert [(t, cell[0]) for t, cell in cells] == [
            (e.t_ns, getattr(e, column)) for e in events
        ]


def test_lanes_say_what_each_robot_does_and_whom_it_waits_for(
    recorded: Recorded,
) -> None:
    tpg, run, _, path = recorded
    steps = max(task.step for task in tpg.tasks)
    names = [chain.robot for chain in tpg.chains]
    waits = 0
    for lane in robot_lanes(tpg, run):
        assert (lane.spans[0].start_ns, lane.spans[-1].end_ns) == (0, run.makespan_ns)
        entity = f"/lanes/{lane.robot}"
        shown = {t: cell[0] for t, cell in rows(path, entity, "StateChange:state")}
        values = static(path, entity, "StateConfiguration:values")
        painted = static(path, entity, "StateConfiguration:colors")
        colour = {v: f"#{c >> 8:06x}" for v, c in zip(values, painted, strict=True)}
        befores = [None, *lane.spans[:-1]]
        for before, after in zip(befores, lane.spans, strict=True):
            if before is not None and before.state == after.state:
                continue
            text = shown[after.start_ns]
            assert colour[text] == LANE_COLOURS[after.state]
            if after.state == WAITING:
                k = names.index(lane.robot)
                there = run.start_ns[k] == after.end_ns
                node = int(np.flatnonzero(there & (run.start_ns[k] > 0))[0])
                others = {
                    f"waits for {names[a]}: task {tpg.chains[a].task[m]} (step"
                    for a, m, b, n in tpg.edges.tolist()
                    if (b, n) == (k, node) and run.end_ns[a][m] > after.start_ns
                }
                assert (
                    text[: text.index(" (step") + 6].replace(" and others", "")
                    in others
                )
                waits += 1
            elif after.task >= 0:
                task = tpg.tasks[after.task]
                assert text == f"{task.label} (step {task.step}/{steps})"
    assert waits > 0


def test_fixtures_have_the_colours_that_they_are_given(tmp_path: Path) -> None:
    tpg = gp4_tpg()
    box = box_shape("box", (0.1, 0.1, 0.1))
    pin = shape_of("pin", (Element(Cylinder(0.1, 0.2), identity()),))
    looks = [("red", box, (255, 0, 10)), ("round", pin, (1, 2, 3)), ("grey", box, None)]
    fixtures = tuple(
        Fixture(name, shape, identity(), colour=colour) for name, shape, colour in looks
    )
    painted = replace(tpg, cell=replace(tpg.cell, fixtures=fixtures))
    path = tmp_path / "run.rrd"
    recorded_run(path, painted)
    assert static(path, "/fixtures/red", "Boxes3D:colors") == [0xFF000AFF]
    assert static(path, "/fixtures/round", "Mesh3D:albedo_factor") == [0x010203FF]
    (grey,) = static(path, "/fixtures/grey", "Boxes3D:colors")
    assert grey not in (0xFF000AFF, 0x010203FF)


def test_objects_hang_on_what_holds_them(recorded: Recorded) -> None:
    tpg, run, _, path = recorded
    placements = object_placements(tpg, run)
    assert len(placements) == 3
    parents = rows(path, "/objects/brick_0/pose", "Transform3D:parent_frame")
    assert parents == [
        (p.t_ns, ["world" if p.holder is None else f"{p.holder}/@flange"])
        for p in placements
    ]


def test_joints_move_as_the_kinematics_says(recorded: Recorded) -> None:
    """The chain of recorded joint transforms ends where the planner's kinematics does."""
    tpg, run, _, path = recorded
    for robot, motion in zip(
        tpg.cell.robots, robot_trajectories(tpg, run), strict=True
    ):
        joints = [
            (
                rows(path, entity, "Transform3D:translation"),
                rows(path, entity, "Transform3D:quaternion"),
            )
            for entity in (
                f"/robot-{robot.name}/joints/{name}" for name in robot.model.joint_names
            )
        ]
        for t in frame_times(motion)[::23]:
            pose = robot.base
            for moves, turns in joints:
                xyz = [cell[0] for time, cell in moves if time <= t][-1]
                x, y, z, w = [cell[0] for time, cell in turns if time <= t][-1]
                pose = pose @ from_quat_wxyz(xyz, (w, x, y, z))
            out = joint_poses_of(robot, motion.at(np.array([t]))[0])
            assert pose == pytest.approx(out[-1], abs=2e-5)


def test_motion_is_cut_fine_and_standing_is_not(recorded: Recorded) -> None:
    tpg, run, _, _ = recorded
    for motion in robot_trajectories(tpg, run):
        times = frame_times(motion)
        assert set(motion.t_ns.tolist()) <= set(times.tolist())
        q = motion.at(times)
        step = np.max(np.abs(np.diff(q, axis=0)), axis=1)
        span = np.diff(times)
        assert np.all((step <= 0.02 + 1e-9) | (span <= 5e7 + 1))
        still = np.flatnonzero(np.all(np.diff(motion.q, axis=0) == 0, axis=1))
        for k in still:
            inside = (times > motion.t_ns[k]) & (times < motion.t_ns[k + 1])
            assert not np.any(inside)


def test_meshes_of_other_packages_are_found(tmp_path: Path) -> None:
    """The Panda's description names its meshes by a package that nobody can look up."""
    tpg = random_tpg(3, dofs=(7,), tasks=2)
    path = tmp_path / "run.rrd"
    recorded_run(path, moved_by(tpg, robot_model("panda")))
    assert path.stat().st_size > 2_000_000


def test_an_arm_that_shows_nothing_is_seen_beside_a_tool_that_does(
    tmp_path: Path,
) -> None:
    """A description may have shapes to collide with only; a tool of shapes shows itself."""
    arm = tmp_path / "arm.urdf"
    arm.write_text(
        """<robot name="bare"><link name="base"/>
        <link name="bar"><collision><geometry><box size="0.1 0.1 0.5"/></geometry></collision></link>
        <joint name="slide" type="prismatic"><parent link="base"/><child link="bar"/><axis xyz="1 0 0"/>
        <limit lower="-1" upper="1" velocity="1"/></joint></robot>"""
    )
    cup = Element(Cylinder(0.02, 0.1), translation(0, 0, 0.3))
    tool = Tool(name="cup", shapes=(cup,), tcp=translation(0, 0, 0.35))
    model = robot_model(str(arm), None, Fitting(tool=tool))
    path = tmp_path / "run.rrd"
    recorded_run(path, moved_by(random_tpg(3, dofs=(1,), tasks=2), model))
    drawn = {
        str(chunk.entity_path)
        for chunk in RrdReader(path).store().stream()
        if "visual_geometries" in str(chunk.entity_path)
    }
    assert any("/bar/" in entity for entity in drawn), drawn
    assert any("cup" in entity for entity in drawn), drawn


def test_a_gantt_chart_is_drawn(recorded: Recorded, tmp_path: Path) -> None:
    from matplotlib.image import imread

    tpg, run, events, _ = recorded
    path = tmp_path / "gantt.png"
    save_png(gantt_figure(tpg, run, events, title="toy"), path)
    picture = imread(path)
    assert picture.shape[1] > 1500
    colours = np.unique(picture.reshape(-1, picture.shape[2])[::7], axis=0)
    assert len(colours) > 20
    seen = {
        tuple(c)
        for c in np.rint(255 * picture[::3, ::1, :3]).astype(int).reshape(-1, 3)
    }
    names = [robot.name for robot in tpg.cell.robots]
    assert {parse_rgb(colour) for colour in team_colours(names).values()} <= seen


@pytest.mark.parametrize("latency_s", [0.0, 0.05])
def test_every_wait_has_an_arrow_from_whom_it_is_for(latency_s: float) -> None:
    tpg = random_tpg(1, dofs=(2, 2, 2), tasks=6)
    slow = Messages.of_seconds(None, latency_s, latency_s)
    run, events = watched(tpg, VARIED, messages=slow)
    figure = gantt_figure(tpg, run, events)
    arrows = {
        (int(np.rint(arrow.xyann[1])), int(np.rint(arrow.xy[1])), arrow.xy[0])
        for arrow in figure.axes[0].texts
        if isinstance(arrow, Annotation)
    }
    told = [e for e in events if e.detail.startswith("waits for robot_")]
    assert told
    for event in told:
        waiting, node = int(event.robot[-1]), event.node
        goes_on_s = run.start_ns[waiting][node] / NANOSECONDS
        sources = [
            source
            for source, target, t_s in arrows
            if target == waiting and event.t_ns / NANOSECONDS < t_s <= goes_on_s
        ]
        assert sources, event


def test_long_runs_wrap_into_rows(tmp_path: Path) -> None:
    from matplotlib.image import imread

    heights = []
    for tasks in (10, 300):
        tpg = random_tpg(1, dofs=(2, 2), tasks=tasks, nodes_per_transit=1)
        path = tmp_path / f"{tasks}.png"
        save_png(gantt_figure(tpg, *watched(tpg, VARIED)), path)
        heights.append(imread(path).shape[0])
    assert heights[1] > 2 * heights[0]
