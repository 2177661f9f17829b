from __future__ import annotations

import json
from pathlib import Path

from tests.twin.twin_toys import toy_cell
from twin.scenario.manifest import (
    MANIFEST,
    load_scenario,
    read_manifest,
    scenario_sha256,
    write_manifest,
)

CLIFF = Path(__file__).parents[3] / "scenarios/lego/cliff.yaml"


def test_the_manifest_says_what_is_needed_to_repeat_a_run(tmp_path: Path) -> None:
    scenario = load_scenario(CLIFF)
    write_manifest(tmp_path, scenario, toy_cell((2, 3)), tmp_path, note="more")
    manifest = json.loads((tmp_path / MANIFEST).read_text())
    assert read_manifest(tmp_path, "run") == (scenario, manifest)
    assert set(manifest) == {
        "note",
        "scenario",
        "scenario_sha256",
        "seed",
        "base",
        "versions",
        "files",
        "robots",
    }
    assert scenario_sha256({"a": 1, "b": 2}) == scenario_sha256({"b": 2, "a": 1})
    assert manifest["seed"] == scenario.seed
    assert manifest["versions"]["numpy"]
    assert manifest["robots"][1] == {
        "name": "robot_1",
        "model": "toy",
        "urdf": "toy.urdf",
        "sha256": None,
        "base": {"xyz": [1.0, 0.0, 0.0], "quat_wxyz": [1.0, 0.0, 0.0, 0.0]},
        "joints": ["joint_0", "joint_1", "joint_2"],
        "tool": {
            "last_joint_T_flange": {
                "xyz": [0.1, 0.0, 0.0],
                "quat_wxyz": [1.0, 0.0, 0.0, 0.0],
            },
            "flange_T_frame": {
                "tool": {"xyz": [0.0, 0.0, 0.05], "quat_wxyz": [1.0, 0.0, 0.0, 0.0]}
            },
        },
    }
