"""A small task in the shape in which the authors of APEX-MR publish theirs."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

_HALF_TURN = "3.1415926"
_DH_ROWS = (
    "0 0 0 -1.57079632679",
    f"-1.57079632679 0 0.26 {_HALF_TURN}",
    "0 0 0.015 -1.57079632679",
    "0 -0.29 0 1.57079632679",
    "0 0 0 -1.57079632679",
)
_TOOLS: Mapping[str, tuple[float, float]] = {
    "": (-0.072, 0.0),
    "_tool": (-0.18, 0.0),
    "_tool_assemble": (-0.18, 0.008),
    "_tool_disassemble": (-0.19, 0.0),
    "_tool_handover_assemble": (-0.181, 0.008),
    "_tool_alt": (-0.17, -0.02),
    "_tool_alt_assemble": (-0.17, -0.01),
}


_FITTING: Mapping[str, tuple[float, float]] = {
    "": (-0.072, 0.0),
    "_tool": (-0.183, 0.0),
    "_tool_assemble": (-0.1825, 0.0078),
    "_tool_disassemble": (-0.192, 0.0),
    "_tool_handover_assemble": (-0.1815, 0.0078),
    "_tool_alt": (-0.1784, -0.0174),
    "_tool_alt_assemble": (-0.1784, -0.0078),
}
"""Frames that meet the tools which come with the program."""


def write_task(folder: Path, levels: int = 4) -> Path:
    """Write a task called ``tower``: bricks of two by four studs on each other."""
    steps: dict[str, Any] = {}
    stock: dict[str, Any] = {}
    for k in range(1, levels + 1):
        steps[str(k)] = {
            **{"x": 44, "y": 20, "z": k, "ori": k % 2, "brick_id": 2},
            **{
                "press_side": 1,
                "press_offset": 1,
                "attack_dir": 1,
                "brick_seq": str(k),
            },
            **{"manipulate_type": 0, "support_x": -1, "support_y": -1},
            **{"support_z": 0, "support_ori": -1},
        }
        stock[f"b2_{k}"] = {"x": 8, "y": 6 * k, "z": 1, "ori": 0}
    plate = {"x": 0.4, "y": 0.0, "z": 0.19, "yaw": 0.0}
    files: dict[str, Any] = {
        "lego_library.json": {"2": {"height": 2, "width": 4, "weight": 0.008}},
        "plate_calibration.json": {"assemble_plate": plate},
        "env_setup/env_setup_tower.json": stock,
        "assembly_tasks/tower.json": steps,
    }
    write_files(folder, files)
    write_robots(folder, _FITTING)
    return folder


def write_files(folder: Path, files: Mapping[str, Any]) -> None:
    """Write contents as JSON, by the names of their files."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(content))


def write_robots(
    folder: Path, tools: Mapping[str, tuple[float, float]] = _TOOLS
) -> None:
    """Write where both robots stand, and d and a of their tools [m] by the ends of file names."""
    properties = folder / "robot_properties"
    properties.mkdir(parents=True, exist_ok=True)
    for name, (d, a) in tools.items():
        rows = [*_DH_ROWS, f"0 {d} {a} {_HALF_TURN}"]
        (properties / f"gp4{name}_DH.txt").write_text("\n".join(rows))
    upright = "1 0 0 0\n0 1 0 0\n0 0 1 {}\n0 0 0 1\n"
    for name, z in (("world", 0.9246), ("gp4", 0.33), ("r1", 0.33)):
        (properties / f"{name}_base.txt").write_text(upright.format(z))
    facing = "-1 0 0 0.88\n0 -1 0 0\n0 0 1 0.33\n0 0 0 1\n"
    (properties / "r2_base.txt").write_text(facing)
