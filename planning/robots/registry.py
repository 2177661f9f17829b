"""Registry of the robots that a scenario can name, with their descriptions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from pathlib import Path
from types import MappingProxyType

import numpy as np

from planning.cell.robot_model import RobotModel
from planning.errors import FittingError, RobotModelError
from planning.files import is_file, resolve_file_name
from planning.robots.descriptions.fitting import Fitting
from planning.robots.descriptions.read_description import is_plain_urdf
from planning.robots.descriptions.urdf_file import UrdfOptions
from planning.transforms import from_rpy, identity, translation

_DESCRIPTIONS = Path(__file__).parent / "urdf"

_GP4_FLANGE_DEPTH = 0.072
"""Distance of the GP4's flange from the centre of its wrist [m]."""

# Last row of the Denavit-Hartenberg table per tool frame: d6 and a6 [m].
_GP4_TOOL_ROWS = {
    "tool": (-0.183, 0.0),
    "assemble": (-0.1825, 0.0078),
    "disassemble": (-0.192, 0.0),
    "alt": (-0.1784, -0.0174),
    "alt_assemble": (-0.1784, -0.0078),
    "handover_assemble": (-0.1815, 0.0078),
}

# The face of the vacuum pad, z out of it.
_MOBILE_PAD = {"tool": translation(0.0, 0.0, 0.11)}
_IIWA_PAD = {"tool": translation(0.0, 0.0, 0.1)}
_CRANE_PAD = {"tool": from_rpy((0.0, 0.0, -0.13), (np.pi, 0.0, 0.0))}

_GP4_TOOLS = MappingProxyType({"dual-arm": "gp4", "slim": "gp4-slim-tool"})

_FILE = "-file"
"""What follows the name of a robot from a file that is called as a registered one."""


@dataclass(frozen=True, kw_only=True)
class RobotEntry(UrdfOptions):
    """A registered robot type.

    Attributes:
        name: what scenarios call it.
        source: where the description comes from.
        licence: of the description.
        note: one-line description.
        home: HOME, joint by joint [rad or m].
        file: path of the description in its folder.
        folder: of the description, of others' among ours; None for our own.
        meshes: a further folder among ours in which meshes are looked up.
        limits_source: where its limits come from that others publish; what is not named there
            is the usual value.
        tools: tools it comes with, each with the name of the entry that carries it; the same
            for all of them.
    """

    name: str
    source: str
    licence: str
    note: str
    home: tuple[float, ...]
    file: str
    folder: str | None = None
    meshes: str | None = None
    limits_source: str = ""
    tools: Mapping[str, str] = field(default_factory=dict)


def _radians(*degrees: float) -> tuple[float, ...]:
    return tuple(float(value) for value in np.radians(degrees))


def _gp4(name: str, tool: str, file: str) -> RobotEntry:
    return RobotEntry(
        name=name,
        source="own primitives around the measured dimensions",
        licence="MIT",
        note=f"Yaskawa GP4, 6 joints, with force sensor and LEGO tool ({tool})",
        home=_radians(0.0, -15.4560, -40.3566, 0.0, -65.0995, 0.0),
        tool_links=("tool",),
        frames={
            key: translation(a6, 0.0, -d6 - _GP4_FLANGE_DEPTH)
            for key, (d6, a6) in _GP4_TOOL_ROWS.items()
        },
        file=file,
        flange_link="flange",
        payload=4.0,
        limits_source="payload: maker's data sheet; masses: estimated",
        tools=_GP4_TOOLS,
    )


_ENTRIES = (
    _gp4("gp4", "dual-arm tool", "gp4.urdf"),
    _gp4("gp4-slim-tool", "slim tool", "gp4_slim_tool.urdf"),
    RobotEntry(
        name="panda",
        source="copy of pybullet_data/franka_panda",
        licence="Apache-2.0",
        note="Franka Emika Panda, 7 joints, hand with fingers held 40 mm apart",
        home=_radians(0.0, -45.0, 0.0, -135.0, 0.0, 90.0, 45.0),
        tool_links=("panda_hand", "panda_leftfinger", "panda_rightfinger"),
        frames={
            "tool": from_rpy((0.0, 0.0, 0.105), (0.0, 0.0, -np.pi / 4)),
            "tip": from_rpy((0.0, 0.0, 0.1115), (0.0, 0.0, -np.pi / 4)),
        },
        folder="franka_panda",
        file="panda.urdf",
        flange_link="panda_link8",
        frozen={"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02},
        acceleration=(15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0),
        jerk=(7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0),
        payload=3.0,
        limits_source="accelerations, jerks, efforts: Franka Control Interface (libfranka), robot limits;"
        " payload: maker's data sheet; masses: of the description, not the maker's",
    ),
    RobotEntry(
        name="fr3",
        source="as panda, with the limits and masses of the FR3",
        licence="Apache-2.0",
        note="Franka Research 3, 7 joints, hand with fingers held 60 mm apart; meshes of the Panda,"
        " whose lengths are its own",
        home=_radians(0.0, -45.0, 0.0, -135.0, 0.0, 90.0, 45.0),
        tool_links=("fr3_hand", "fr3_leftfinger", "fr3_rightfinger"),
        frames={
            "tool": from_rpy((0.0, 0.0, 0.1034), (0.0, 0.0, -np.pi / 4)),
            "tip": from_rpy((0.0, 0.0, 0.1115), (0.0, 0.0, -np.pi / 4)),
        },
        folder="franka_panda",
        file="fr3.urdf",
        flange_link="fr3_link8",
        frozen={"fr3_finger_joint1": 0.03, "fr3_finger_joint2": 0.03},
        acceleration=(10.0,) * 7,
        jerk=(5000.0,) * 7,
        payload=3.0,
        limits_source="positions, speeds, accelerations, jerks, efforts: Franka Control Interface, robot limits,"
        " of positions and speeds those that are independent of each other; payload: maker's data sheet;"
        " masses: maker's description",
    ),
    RobotEntry(
        name="iiwa14",
        source="copy of pybullet_data/kuka_iiwa",
        licence="BSD-2-Clause",
        note="KUKA LBR iiwa 14, 7 joints, bare flange; speeds of the data sheet",
        home=_radians(0.0, 30.0, 0.0, -75.0, 0.0, 75.0, 0.0),
        tool_links=(),
        frames={"tool": identity()},
        folder="kuka_iiwa",
        file="model.urdf",
        flange_link="lbr_iiwa_link_7",
        flange_offset=translation(0.0, 0.0, 0.045),
        velocity=_radians(85.0, 85.0, 100.0, 75.0, 130.0, 135.0, 135.0),
        effort=(320.0, 320.0, 176.0, 176.0, 110.0, 40.0, 40.0),
        payload=14.0,
        limits_source="speeds, efforts, payload: maker's data sheet; masses: of the description, not the"
        " maker's",
    ),
    RobotEntry(
        name="ur5e",
        source="own primitives around the measured dimensions",
        licence="MIT",
        note="arm like the Universal Robots UR5e, 6 joints, bare flange",
        home=_radians(0.0, -140.0, 120.0, -70.0, -90.0, 0.0),
        tool_links=(),
        frames={"tool": identity()},
        file="ur5e.urdf",
        flange_link="tool0",
        payload=5.0,
        limits_source="speeds, payload: user manual of the UR5e; efforts: maker's article on maximum joint"
        " torques; masses: maker's article on parameters for dynamics",
    ),
    RobotEntry(
        name="mobile-manipulator",
        source="own primitives",
        licence="MIT",
        note="holonomic platform with a 4-joint arm and a vacuum pad, 7 joints",
        home=(0.0, 0.0, 0.0, -0.5, 2.3, 1.341593, 0.0),
        tool_links=("pad",),
        frames=_MOBILE_PAD,
        file="mobile_manipulator.urdf",
        flange_link="flange",
    ),
    RobotEntry(
        name="mobile-iiwa14",
        source="own platform; arm of pybullet_data/kuka_iiwa",
        licence="MIT; arm BSD-2-Clause",
        note="KUKA LBR iiwa 14 on a holonomic platform, vacuum pad, 10 joints",
        home=(0.0, 0.0, 0.0, 0.0, -0.35, 0.0, -1.9, 0.0, 1.591593, 0.0),
        tool_links=("pad",),
        frames=_IIWA_PAD,
        file="mobile_iiwa14.urdf",
        flange_link="flange",
        meshes="kuka_iiwa",
    ),
    RobotEntry(
        name="tower-crane",
        source="own primitives",
        licence="MIT",
        note="tower crane with a vacuum pad: slew, trolley, hoist and hook, 4 joints",
        home=(0.0, 2.0, 0.3, 0.0),
        tool_links=("pad",),
        frames=_CRANE_PAD,
        file="tower_crane.urdf",
        flange_link="flange",
    ),
)

ROBOTS: Mapping[str, RobotEntry] = MappingProxyType({e.name: e for e in _ENTRIES})
"""Registered robots by name."""


def with_tool(model: str, tool: str | None, others: tuple[str, ...] = ()) -> str:
    """Return the name of a robot type with one of its own tools.

    Args:
        model: a name in ROBOTS, or the path of a URDF file, which comes with its tool.
        tool: such as ``"slim"``; None for the tool that the model names.
        others: further tools that could be meant, for messages.

    Raises:
        RobotModelError: the model does not come with such a tool.
    """
    if tool is None:
        return model
    tools = ROBOTS[model].tools if model in ROBOTS else {}
    choices = (*tools, *others)
    if not choices:
        raise FittingError(
            f"the robot {model!r} has no tools to choose from, and 'tools' of the cell names none",
            key="tool",
        )
    if tool not in tools:
        raise FittingError(
            f"the robot {model!r} has no tool {tool!r}", key="tool", choices=choices
        )
    return tools[tool]


def robot_model(
    name_or_path: str, base_dir: Path | None = None, fitting: Fitting | None = None
) -> RobotModel:
    """Return a registered robot, or one read from a file. Results are cached.

    Args:
        name_or_path: name in ROBOTS, or path of a URDF or MJCF file, or ``package://PACKAGE/PATH``.
        base_dir: what a relative path is relative to; the working directory by default.
        fitting: what a cell adds to it: a tool, a flange, limits, joints that are held.

    Raises:
        RobotModelError: no such robot or file, or the description cannot be used.
    """
    fitting = fitting or Fitting()
    if name_or_path in ROBOTS:
        if fitting.is_nothing:
            return _registered(name_or_path)
        entry = ROBOTS[name_or_path]
        dirs = _folders(entry)
        return _fitted(dirs[0] / entry.file, entry, fitting, dirs)
    try:
        folder = Path(base_dir or ".")
        path = resolve_file_name(name_or_path, folder, RobotModelError).resolve()
    except (OSError, ValueError) as error:
        raise RobotModelError(f"no robot {name_or_path[:60]!r}: {error}") from None
    if not is_file(path) and path.suffix.lower() not in (".urdf", ".xml", ".mjcf"):
        raise RobotModelError(
            f"no robot {name_or_path!r} in the registry, and no such file",
            choices=(*ROBOTS, "path of a .urdf file"),
        )
    if fitting.is_nothing and is_plain_urdf(path):
        return _from_file(path, path.stat().st_mtime_ns)
    return _fitted(path, UrdfOptions(), fitting, ())


def _fitted(
    path: Path, options: UrdfOptions, fitting: Fitting, dirs: tuple[Path, ...]
) -> RobotModel:
    """Return a robot with the changes of a cell, under a name that states them."""
    from planning.robots.descriptions.description_files import store_description
    from planning.robots.descriptions.mounting import fitted_description

    root = fitted_description(path, options, fitting, dirs)
    name = options.name or path.stem
    if fitting.tool is not None:
        name += f"+{fitting.tool.name}"
    elif fitting.bare:
        name += "+tools"
    elif name in ROBOTS:
        name += "-fitted" if path.is_relative_to(_DESCRIPTIONS) else _FILE
    kept = store_description(root, name)
    return _from_file(kept, kept.stat().st_mtime_ns)


def _folders(entry: RobotEntry) -> tuple[Path, ...]:
    """Return the folders of a registered robot's description and its meshes."""
    folders = [_DESCRIPTIONS / (entry.folder or "")]
    if entry.meshes:
        folders.append(_DESCRIPTIONS / entry.meshes)
    return tuple(folders)


@cache
def _registered(name: str) -> RobotModel:
    from planning.robots.load_urdf import load_urdf

    entry = ROBOTS[name]
    folders = _folders(entry)
    return load_urdf(folders[0] / entry.file, entry, package_dirs=folders)


@lru_cache(maxsize=32)
def _from_file(path: Path, stamp: int) -> RobotModel:
    """Load a user's description; ``stamp`` invalidates the cache of an edited file."""
    from planning.robots.load_urdf import load_urdf

    # A file that is called as a registered robot is not that robot.
    model = load_urdf(path)
    return replace(model, name=model.name + _FILE) if model.name in ROBOTS else model
