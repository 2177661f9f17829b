"""The viewer: stills that it renders, who listens in a browser, and that a run that is followed gets there."""

import subprocess
import sys
import urllib.request
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from tests.twin.recorders.recorded_toys import recorded_run
from tests.twin.simulated import NOMINAL
from tests.twin.sockets import listening
from tests.twin.twin_toys import random_tpg, toy_cell
from twin.rerun import viewer
from twin.rerun.viewer import ViewerError, render_stills

ARM = """<robot name="toy">
  <link name="base"/>
  <link name="bar">
    <visual name="bar">
      <origin xyz="0.2 0 0"/>
      <geometry><box size="0.4 0.1 0.1"/></geometry>
      <material name="red"><color rgba="0.9 0.1 0.1 1"/></material>
    </visual>
  </link>
  <joint name="joint_0" type="revolute">
    <parent link="base"/><child link="bar"/>
    <axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="1" effort="1"/>
  </joint>
</robot>
"""


@pytest.mark.expensive
def test_stills_show_the_robot_where_it_is(tmp_path: Path) -> None:
    urdf = tmp_path / "toy.urdf"
    urdf.write_text(ARM)
    tpg = random_tpg(1, dofs=(1,), tasks=2)
    tpg = replace(tpg, cell=toy_cell((1,), urdf=urdf))
    run, _ = recorded_run(tmp_path / "run.rrd", tpg, NOMINAL, seed=0)
    times = (0.0, run.makespan_s / 2)
    try:
        pictures = render_stills(tmp_path / "run.rrd", times, tmp_path / "stills")
    except ViewerError as error:
        pytest.skip(f"no headless viewer here: {error}")
    assert [p.parent for p in pictures] == [tmp_path / "stills"] * 2
    scenes = [imread(p)[70:560, :1000, :3] for p in pictures]
    # The first robot of a team is blue, whatever its description says.
    arm = [(s[..., 2] > 0.4) & (s[..., 0] < 0.2) for s in scenes]
    assert all(np.count_nonzero(mask) > 500 for mask in arm)
    assert np.count_nonzero(arm[0] != arm[1]) > 500


@pytest.mark.parametrize(
    ("script", "state", "words"),
    [
        ("echo starting; echo no device >&2; exit 3", "exit code 3", "no device"),
        ("exec sleep 60", "did not answer after 1 s", "none"),
    ],
)
def test_a_viewer_that_draws_nothing_is_told_and_leaves_no_folder(
    script: str,
    state: str,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    program = tmp_path / "viewer"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setattr(viewer, "_program", lambda remark="": str(program))
    monkeypatch.setattr(viewer, "_START_S", 0.6)
    recording, folder = tmp_path / "run.rrd", tmp_path / "stills"
    recording.write_bytes(b"")
    with pytest.raises(ViewerError) as found:
        render_stills(recording, (0.0,), folder)
    said = str(found.value)
    assert all(part in said for part in (str(program), state, words, "Vulkan")), said
    assert not folder.exists()
    folder.mkdir()
    with pytest.raises(ViewerError):
        render_stills(recording, (0.0,), folder)
    assert folder.exists(), "it was there before"


CODE = """
import sys, time, urllib.request
from twin.rerun.viewer import web_viewer
address, page = web_viewer()
print(address, page, flush=True)
sys.stdin.readline()
"""


def test_the_viewer_is_served_to_this_machine_only_and_ends_with_the_program() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", CODE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        address, page = process.stdout.readline().split()
        ports = {int(address.split(":")[2].split("/")[0])}
        ports.add(int(page.split(":")[2].split("/")[0]))
        assert len(ports) == 2
        hosts = {host for host, port in listening() if port in ports}
        assert hosts == {"127.0.0.1"}
        with urllib.request.urlopen(page, timeout=20) as answer:
            assert b"<html" in answer.read().lower()
        process.stdin.write("\n")
        process.stdin.flush()
        assert process.wait(timeout=20) == 0
    for _ in range(50):
        if not {port for _, port in listening()} & ports:
            break
        subprocess.run(["sleep", "0.1"], check=True)
    assert not {port for _, port in listening()} & ports
