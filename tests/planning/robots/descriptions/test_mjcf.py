"""MJCF, against PyBullet, which reads it with a parser of its own."""

from pathlib import Path
from xml.etree.ElementTree import Element, tostring

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planning.errors import FittingError, RobotModelError
from planning.robots.descriptions.fitting import Fitting, Tool, hold_joints
from planning.robots.descriptions.read_description import mjcf_to_urdf
from planning.robots.descriptions.urdf_file import GivenLimits
from planning.robots.descriptions.xml_files import read_xml
from planning.robots.registry import robot_model
from planning.transforms import Transform, from_quat_wxyz, inverse
from tests.planning.robots.descriptions.test_mounting import link_poses
from tests.planted import rows

HAND = """<mujoco model="hand">
  <compiler angle="radian"/>
  <default>
    <geom rgba="0.2 0.2 0.2 1"/>
    <default class="finger">
      <joint type="slide" axis="0 1 0" limited="true" range="0 0.04"/>
      <geom type="box" size="0.01 0.004 0.02"/>
    </default>
  </default>
  <worldbody>
    <body name="palm" pos="0 0 0.01" quat="0.9238795 0 0 0.3826834">
      <geom name="palm" type="cylinder" size="0.03 0.04" pos="0 0 0.04"/>
      <body name="left" pos="0 0.004 0.1" childclass="finger">
        <joint name="left"/><geom name="left" class="finger"/>
        <body name="nail" pos="0 0 0.02" quat="0.7071068 0.7071068 0 0">
          <joint name="bend" type="hinge" axis="0 1 1" pos="0 0.01 0" limited="true" range="-1 1"/>
          <geom type="capsule" fromto="0 0 0 0 0 0.03" size="0.004"/>
        </body>
      </body>
      <body name="right" pos="0 -0.004 0.1" quat="0 0 0 1" childclass="finger">
        <joint name="right"/><geom class="finger"/>
        <geom type="sphere" size="0.05" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="left" joint2="right" polycoef="0.002 0.5 0 0 0"/></equality>
</mujoco>"""

ARM = """<mujoco><worldbody><body name="foot"><geom type="box" size="0.1 0.1 0.1"/>
  <body name="upper" pos="0 0 0.2"><joint name="lift" axis="0 1 0" range="-90 90" limited="true"/>
    <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.03"/>
    <body name="lower" pos="0.4 0 0"><joint name="bend" axis="0 1 0" range="-120 0" limited="true"/>
      <geom type="capsule" fromto="0.1 0 0 0.3 0 0" size="0.03"/>
      <body name="tool0" pos="0.33 0 0" euler="0 90 0"/></body></body></body></worldbody></mujoco>"""


PLAIN = """<mujoco model="plain"><compiler angle="radian"/><worldbody>
  <body name="base" pos="0.1 -0.2 0.3" quat="0.9238795 0 0.3826834 0">
    <geom type="box" size="0.1 0.1 0.1"/>
    <body name="first" pos="0 0.1 0.2" quat="0.9238795 0 0 0.3826834">
      <joint name="slide" type="slide" axis="0 1 0" pos="0 0 0" range="0 1"/>
      <geom type="box" size="0.02 0.02 0.02"/>
      <body name="second" pos="0.1 0 0.3" quat="0.7071068 0.7071068 0 0">
        <joint name="bend" type="hinge" axis="0 0 1" pos="0 0 0" range="-1 1"/>
        <geom type="sphere" size="0.02"/>
        <body name="third" pos="0.1 0.2 0.3"><geom type="sphere" size="0.02"/></body>
      </body>
    </body>
  </body></worldbody></mujoco>"""
"""Without classes, which PyBullet does not read."""


@pytest.fixture
def hand(tmp_path: Path) -> Path:
    path = tmp_path / "hand.xml"
    path.write_text(HAND)
    return path


def poses_of_bullet(path: Path, values: dict[str, float]) -> dict[str, Transform]:
    """Return where PyBullet puts the bodies of an MJCF file."""
    bullet = pytest.importorskip("pybullet")
    server = bullet.connect(bullet.DIRECT)
    try:
        (body,) = bullet.loadMJCF(str(path), physicsClientId=server)
        joints = range(bullet.getNumJoints(body, physicsClientId=server))
        infos = [bullet.getJointInfo(body, j, physicsClientId=server) for j in joints]
        for info in infos:
            value = values.get(info[1].decode())
            if value is not None:
                bullet.resetJointState(body, info[0], value, physicsClientId=server)
        out = {}
        for info in infos:
            state = bullet.getLinkState(
                body, info[0], computeForwardKinematics=1, physicsClientId=server
            )
            x, y, z, w = state[5]
            out[info[12].decode()] = from_quat_wxyz(state[4], (w, x, y, z))
        return out
    finally:
        bullet.disconnect(server)


def test_bodies_are_where_pinocchio_puts_them(hand: Path) -> None:
    """Joints off the origin of their body, turned bodies, and a joint that follows another.

    pinocchio leaves out where the first body is, so what is compared is seen from there.
    """
    import pinocchio

    values = {"right": 0.03, "bend": 0.4}
    tool = Tool(name="h", description=hand, held=values, tcp=np.eye(4))
    model = robot_model("iiwa14", None, Fitting(tool=tool))
    mjcf = pinocchio.buildModelFromMJCF(str(hand))
    q = pinocchio.neutral(mjcf)
    for name, value in (values | {"left": 0.002 + 0.5 * 0.03}).items():
        q[mjcf.joints[mjcf.getJointId(name)].idx_q] = value
    data = mjcf.createData()
    pinocchio.framesForwardKinematics(mjcf, data, q)
    found = link_poses(model.urdf, {})
    palm = inverse(found["h.palm"])
    for body in ("left", "nail", "right"):
        number = mjcf.getFrameId(body, pinocchio.FrameType.BODY)
        wanted = data.oMf[number].homogeneous
        assert np.allclose(palm @ found[f"h.{body}"], wanted, atol=1e-7), body
    there = inverse(found["h.world"]) @ found["h.palm"]
    half = np.pi / 8
    turned = (np.cos(half), 0, 0, np.sin(half))
    assert np.allclose(there, from_quat_wxyz((0, 0, 0.01), turned), atol=1e-6)


def test_bodies_are_where_bullet_puts_them(tmp_path: Path) -> None:
    path = tmp_path / "plain.xml"
    path.write_text(PLAIN)
    values = {"slide": 0.03, "bend": 0.4}
    tool = Tool(name="h", description=path, held=values, tcp=np.eye(4))
    model = robot_model("iiwa14", None, Fitting(tool=tool))
    found, wanted = link_poses(model.urdf, {}), poses_of_bullet(path, values)
    root = inverse(found["h.world"])
    for name in ("first", "second", "third"):
        (key,) = (k for k in wanted if k.startswith(name))
        assert np.allclose(root @ found[f"h.{name}"], wanted[key], atol=1e-6), name


def test_what_cannot_be_touched_is_no_body(hand: Path) -> None:
    """The ball has neither contype nor conaffinity; a capsule is a cylinder and two balls."""
    model = robot_model(
        "iiwa14", None, Fitting(tool=Tool(name="h", description=hand, tcp=np.eye(4)))
    )
    bodies = [part.body for part in model.parts if part.group == "tool"]
    assert len(bodies) == 1 + 1 + 3 + 1
    assert max(float(np.ptp(body.vertices, axis=0).max()) for body in bodies) < 0.09


def test_an_arm_in_mjcf_moves_where_its_joints_let_it(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    with pytest.raises(RobotModelError, match=r"limits: \{velocity"):
        robot_model(str(path))
    model = robot_model(str(path), None, Fitting(limits=GivenLimits(velocity=(1.5,))))
    assert model.joint_names == ("lift", "bend")
    assert np.allclose(np.degrees(model.lower), (-90, -120))
    assert np.allclose(np.degrees(model.upper), (90, 0))
    assert model.flange_link == "tool0"
    assert np.allclose(model.flange[:3, 2], (1, 0, 0))


SETTINGS = """<mujoco model="axes"><worldbody><body name="base" childclass="turns">
    <geom type="box" size="0.1 0.1 0.1"/>
    <body name="a" pos="0 0 0.2"><joint name="rail" class="slides"/>
      <body name="b" euler="90 0 90"><joint name="bend"/>
        <body name="c"><joint name="free_turn" limited="false"/>
          <body name="d"><joint name="lift" type="slide" axis="0 0 2" range="-0.5 1.5" ref="0.25"/>
            <body name="e" pos="0.1 0 0" axisangle="0 0 2 -90">
              <joint name="twist" axis="0 1 0" ref="45" range="0 90"/>
              <frame pos="0.3 0 0"><geom type="sphere" size="0.02"/><body name="tip"/></frame>
            </body></body></body></body></body></body></worldbody>
  <default><joint damping="1"/>
    <default class="turns"><joint axis="0 1 0" range="-90 120"/></default>
    <default class="slides"><joint type="slide" axis="1 0 0" range="0 0.04"/></default></default>
  <compiler eulerseq="XYz"/><worldbody><body name="box" pos="9 9 9"/></worldbody></mujoco>"""
"""Angles are in degrees, the default: those of ranges of slides are none."""


def urdf_of(text: str, tmp_path: Path) -> Element:
    path = tmp_path / "made.xml"
    path.write_text(text)
    return mjcf_to_urdf(read_xml(path), path)


def test_only_what_turns_has_its_range_in_degrees(tmp_path: Path) -> None:
    """Of two classes the nearer one counts alone; a joint that is not limited has no range."""
    urdf = urdf_of(SETTINGS, tmp_path)
    joints = {str(joint.get("name")): joint for joint in urdf.findall("joint")}
    ranges = {}
    for name in ("rail", "bend", "free_turn", "lift", "twist"):
        limit = joints[name].find("limit")
        keys = ("lower", "upper")
        if limit is not None:
            ranges[name] = [float(limit.get(key, "nan")) for key in keys]
    quarter = np.pi / 2
    assert ranges["rail"] == [0.0, 0.04]
    assert ranges["lift"] == [-0.5, 1.5]
    assert np.allclose(ranges["bend"], [-quarter, 4 / 3 * quarter])
    assert np.allclose(ranges["twist"], [0.0, quarter])
    assert joints["free_turn"].get("type") == "continuous"
    assert "free_turn" not in ranges
    axis = joints["rail"].find("axis")
    assert axis is not None
    assert axis.get("xyz") == "1.0 0.0 0.0"


def test_values_of_joints_count_from_what_is_drawn(tmp_path: Path) -> None:
    """Where a joint is at its ``ref`` bodies are as they are drawn; the oracle is written by hand."""
    urdf = urdf_of(SETTINGS, tmp_path)
    hold_joints(
        urdf,
        tmp_path,
        {"rail": 0.01, "bend": 0, "free_turn": 0, "lift": 0.35, "twist": np.pi / 4},
    )
    path = tmp_path / "held.urdf"
    path.write_bytes(tostring(urdf))
    found = link_poses(path, {})
    base = inverse(found["base"])
    # XYz: about x, then about y that stands, then about the z that has turned with it.
    turned = Rotation.from_euler("x", 90, degrees=True)
    turned = turned * Rotation.from_euler("z", 90, degrees=True)
    b = np.array([0.01, 0.0, 0.2])
    assert np.allclose((base @ found["b"])[:3, 3], b)
    assert np.allclose((base @ found["b"])[:3, :3], turned.as_matrix(), atol=1e-7)
    # 0.1 above where it is drawn.
    e = b + turned.apply([0.1, 0.0, 0.1])
    assert np.allclose((base @ found["e"])[:3, 3], e)
    # As it is drawn: a quarter turn about -z.
    tip = e + turned.apply([0.0, -0.3, 0.0])
    assert np.allclose((base @ found["tip"])[:3, 3], tip)


def test_a_class_says_the_scale_of_its_meshes(tmp_path: Path) -> None:
    corners = ((0, 0, 0), (100, 0, 0), (0, 100, 0), (0, 0, 100))
    lines = ["v " + " ".join(map(str, corner)) for corner in corners]
    faces = ["f 1 3 2", "f 1 2 4", "f 2 3 4", "f 1 4 3"]
    (tmp_path / "part.obj").write_text("\n".join([*lines, *faces]))
    urdf = urdf_of(
        """<mujoco model="m"><default><mesh scale="0.001 0.001 0.002"/></default>
        <asset><mesh file="part.obj"/></asset>
        <worldbody><body name="b"><geom type="mesh" mesh="part"/></body></worldbody></mujoco>""",
        tmp_path,
    )
    mesh = urdf.find("link/collision/geometry/mesh")
    assert mesh is not None
    assert mesh.get("scale") == "0.001 0.001 0.002"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    rows(r"""
old                                          | new                                          | says
<body name="palm"                            | <thing name="palm"                           | is not XML
type="cylinder" size="0.03 0.04"             | type="ellipsoid" size="1 1 1"                | ellipsoid|Ellipsoid
type="cylinder" size="0.03 0.04"             | type="mesh" mesh="gone"                      | gone
<joint name="left"/>                         | <joint name="left"/><joint name="more"/>     | several joints
pos="0 0.004 0.1" childclass                 | pos="0 nan 0.1" childclass                   | "pos of <body> '\\w+' must be a fin"
pos="0 0 0.01" quat="0.9238795 0 0 0.3826834" | quat="0 0 0 0"                               | quat of <body> 'palm'
childclass="finger"                          | childclass="thumb"                           | childclass 'thumb' of a <body> is not there
polycoef="0.002 0.5 0 0 0"                   | polycoef="0 1 2 0 0"                         | along a curve
angle="radian"                               | angle="grad"                                 | valid: degree, radian
angle="radian"                               | eulerseq="xyw"                               | eulerseq of <compiler> is 'xyw'
limited="true" range="0 0.04"                | limited="true"                               | 'left' is limited: its range must be 2 numbers
</mujoco>                                    | <compiler autolimits="false"/><worldbody><body name="x"><joint range="0 1"/></body></worldbody></mujoco> | 'xJoint_0' has a range, and with autolimits
limited="true" range="-1 1"                  | range="1 -1"                                 | 'bend' is limited: its range must rise
limited="true" range="0 0.04"/>              | range="0 1"/><joint ref="x"/>                | ref of <joint> '' must be a fin
type="hinge" axis="0 1 1"                    | type="screw" axis="0 1 1"                    | 'bend' is of type 'screw'
</mujoco>                                    | <include file="more.xml"/></mujoco>          | more.xml does not exist
</mujoco>                                    | <include file="hand.xml"/></mujoco>          | includes itself
</mujoco>                                    | <asset><mesh file="no.stl"/></asset></mujoco> | 'no.stl' was not found
"""),
)
def test_what_cannot_be_read_is_explained(
    hand: Path, old: str, new: str, words: str
) -> None:
    assert old in HAND
    hand.write_text(HAND.replace(old, new))
    tool = Tool(name="h", description=hand, tcp=np.eye(4))
    with pytest.raises(FittingError, match=words):
        robot_model("iiwa14", None, Fitting(tool=tool))
