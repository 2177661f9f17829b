"""Descriptions in xacro are expanded, and nothing that is written in them is executed."""

import math
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.errors import FittingError, RobotModelError
from planning.robots.descriptions.fitting import Fitting
from planning.robots.registry import robot_model
from planning.vendor_files.vendor_files import with_vendor_files
from planning.vendor_files.xacro_expressions import (
    FUNCTIONS,
    XacroExpressionError,
    evaluate,
)
from planning.vendor_files.xacro_file import xacro_root
from tests.planning.vendor_files.folding_arm import SRDF
from tests.twin.program import invoke

pytest.importorskip("xacro")

NS = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
ARM = f"""<robot name="folding" {NS}>
  <xacro:arg name="count" default="3"/>
  <xacro:property name="size" value="${{xacro.load_yaml('sizes.yaml')}}"/>
  <xacro:include filename="$(find rods)/urdf/rod.xacro"/>
  <link name="foot"/>
  <xacro:rod k="1" parent="foot" x="0" z="${{0.2 / 2}}"/>
  <xacro:rod k="2" parent="link1" x="${{size['rod']['length']}}" z="0"/>
  <xacro:if value="${{int('$(arg count)') == 3}}">
    <xacro:rod k="3" parent="link2" x="${{size.rod.length}}" z="0"/>
  </xacro:if>
</robot>"""
ROD = f"""<robot {NS}><xacro:macro name="rod" params="k parent x z">
  <link name="link${{k}}"><collision><origin xyz="${{0.5 * size.rod.length}} 0 0"/>
    <geometry><box size="${{size.rod.length}} 0.04 0.04"/></geometry></collision></link>
  <joint name="turn${{k}}" type="revolute"><parent link="${{parent}}"/><child link="link${{k}}"/>
    <origin xyz="${{x}} 0 ${{z}}"/><axis xyz="0 0 1"/>
    <limit lower="${{-radians(160)}}" upper="${{radians(160)}}" effort="50" velocity="2"/></joint>
</xacro:macro></robot>"""
CELL = """version: 1
name: own
cell: {robots: [{name: one, model: package/urdf/arm.urdf.xacro, home_deg: [0, 0, 0]}]}
assembly: {kind: goals, moves: [{robot: one, to_deg: [10, 20, 30], frame: flange}]}
"""


def package(folder: Path, text: str = ARM) -> Path:
    """Write a package with a description, and return the description."""
    urdf = folder / "package" / "urdf"
    urdf.mkdir(parents=True)
    (folder / "package" / "package.xml").write_text(
        "<package><name>rods</name></package>"
    )
    (urdf / "sizes.yaml").write_text("rod: {length: 0.3}\n")
    (urdf / "rod.xacro").write_text(ROD)
    path = urdf / "arm.urdf.xacro"
    path.write_text(text)
    return path


def test_a_package_is_expanded_with_includes_and_arguments(tmp_path: Path) -> None:
    path = package(tmp_path)
    (path.parent / "arm.srdf").write_text(SRDF)
    model = robot_model(*with_vendor_files(str(path), tmp_path, Fitting())[:1])
    assert model.joint_names == ("turn1", "turn2", "turn3")
    assert model.upper == pytest.approx([math.radians(160)] * 3)
    assert model.chain.placement[1][0, 3] == pytest.approx(0.3)
    name, fitting = with_vendor_files(
        str(path), tmp_path, Fitting(), xacro={"count": 2}
    )
    assert robot_model(name, None, fitting).dof == 2
    assert ("link3", "link1") not in fitting.ignored


def test_the_commands_take_arguments(tmp_path: Path) -> None:
    path = package(tmp_path)
    done = invoke("robots", path, "--xacro", "count=2", code=0)
    assert "2 joints" in done.output
    (tmp_path / "cell.yaml").write_text(CELL)
    invoke("check", tmp_path / "cell.yaml", code=0)


EXPRESSIONS = (
    "().__class__.__bases__[0].__subclasses__()",
    "(lambda: ().__class__.__mro__)()",
    "[x for x in ().__class__.__mro__]",
    "__import__('os').system('touch SENTINEL')",
    "open('SENTINEL', 'w')",
    "python.vars(xacro)",
    "python.type('')",
    "'{0.__class__}'.format(1)",
    "f'{().__class__}'",
    "xacro.load_yaml.__globals__['os']",
    "xacro.load_yaml('SENTINEL.yaml')",
    "xacro.load_yaml('/etc/passwd')",
    "map(str, [1])",
    "(x := 1)",
    "max([1], key=print)",
    "'a' * 10**11",
    "10 ** 10 ** 10",
    "(" * 3000,
)
ATTACKS = (
    *(f'<link name="${{{text}}}"/>' for text in EXPRESSIONS),
    *(f'<link name="$(eval {text})"/>' for text in EXPRESSIONS[3:5]),
    '<xacro:property name="len" value="${python.vars}"/><link name="${len(xacro)[0]}"/>',
    '<link name="$(env HOME)"/>',
    '<link name="$(find ../../..)"/>',
    '<xacro:include filename="/etc/passwd"/>',
    '<xacro:include filename="/*"/>',
    '<xacro:include filename=".hidden.xacro"/>',
    '<xacro:include filename="arm.urdf.xacro"/>',
    '<xacro:macro name="a" params=""><xacro:a/></xacro:macro><xacro:a/>',
    '<xacro:property name="y" value="${xacro.load_yaml(\'evil.yaml\')}"/><link name="${y}"/>',
    '<xacro:property name="y" value="${xacro.load_yaml(\'angle.yaml\')}"/><link name="${y}"/>',
)


def attacked(folder: Path, attack: str) -> tuple[Path, Path]:
    sentinel = folder / "executed"
    attack = attack.replace("SENTINEL", str(sentinel))
    text = ARM.replace("<xacro:include", f"{attack}<xacro:include", 1)
    path = package(folder, text)
    (path.parent / ".hidden.xacro").write_text(ROD)
    command = f"__import__('os').system('touch {sentinel}')"
    (path.parent / "evil.yaml").write_text(
        f'a: !!python/object/apply:os.system ["touch {sentinel}"]\n'
    )
    (path.parent / "angle.yaml").write_text(f'a: !degrees "{command}"\n')
    return path, sentinel


@pytest.mark.parametrize("attack", ATTACKS)
@pytest.mark.nightly
def test_nothing_in_a_file_is_executed(attack: str, tmp_path: Path) -> None:
    path, sentinel = attacked(tmp_path, attack)
    with pytest.raises(RobotModelError) as error:
        xacro_root(path, {})
    assert str(path) in error.value.message
    assert not sentinel.exists()


@pytest.mark.parametrize("command", ["check", "run"])
def test_commands_refuse_an_attack_with_its_place(command: str, tmp_path: Path) -> None:
    path, sentinel = attacked(tmp_path, ATTACKS[3])
    (tmp_path / "cell.yaml").write_text(CELL)
    done = invoke(command, tmp_path / "cell.yaml", code=2)
    assert "arm.urdf.xacro cannot be expanded" in done.output
    assert "cell.yaml:3" in done.output
    assert not sentinel.exists()
    assert path.exists()


@pytest.mark.parametrize("text", EXPRESSIONS)
def test_what_is_no_arithmetic_is_refused(text: str) -> None:
    values = {"xacro": {"load_yaml": print}, "python": {"type": type, "vars": vars}}
    with pytest.raises((XacroExpressionError, MemoryError, RecursionError)):
        evaluate(text, values, FUNCTIONS)


NUMBERS = st.integers(-9, 9).map(str) | st.sampled_from(["x", "0.5", "m['k']", "m.k"])
TERMS = st.recursive(
    NUMBERS,
    lambda inner: st.one_of(
        st.tuples(
            inner, st.sampled_from(["+", "-", "*", "<", "==", " and "]), inner
        ).map(lambda t: f"({t[0]}{t[1]}{t[2]})"),
        inner.map(lambda t: f"max({t}, abs({t}))"),
        st.tuples(inner, inner, inner).map(lambda t: f"({t[0]} if {t[1]} else {t[2]})"),
        inner.map(lambda t: f"[{t}, 1][0]"),
    ),
    max_leaves=8,
)


@settings(max_examples=60, deadline=None)
@given(TERMS)
def test_arithmetic_is_that_of_python(text: str) -> None:
    m = type("M", (dict,), {"__getattr__": dict.__getitem__})({"k": 7})
    expected = eval(text, {"x": 3, "m": m})
    assert evaluate(text, {"x": 3, "m": m}, FUNCTIONS) == expected


DAMAGED = {
    "": "no element found",
    "<robot": "cannot be expanded",
    f"<robot {NS}><xacro:include filename='gone.xacro'/></robot>": "no such file",
    f"<robot {NS}><xacro:gone/></robot>": "gone",
    f"<robot {NS}><link name='${{gone}}'/></robot>": "'gone' is not defined",
    f"<robot {NS}><link name='$(find gone)'/></robot>": "no package 'gone'",
    f"<robot {NS}><link name='${{1/0}}'/></robot>": "ZeroDivisionError",
    f"<robot {NS}><xacro:if value='maybe'/></robot>": "maybe",
}


@pytest.mark.parametrize("text", DAMAGED)
def test_a_damaged_file_is_refused_with_its_place(text: str, tmp_path: Path) -> None:
    path = package(tmp_path, text)
    with pytest.raises(RobotModelError) as error:
        xacro_root(path, {})
    assert str(path) in error.value.message
    assert DAMAGED[text] in error.value.message


def test_a_missing_argument_and_one_for_plain_urdf_name_the_key(tmp_path: Path) -> None:
    path = package(tmp_path, ARM.replace('<xacro:arg name="count" default="3"/>', ""))
    with pytest.raises(
        FittingError, match="argument 'count': give it with 'xacro'"
    ) as error:
        with_vendor_files(str(path), tmp_path, Fitting())
    assert error.value.key == "xacro"
    plain = path.with_name("arm.urdf")
    plain.write_text("<robot/>")
    with pytest.raises(FittingError, match="is no xacro file"):
        with_vendor_files(str(plain), tmp_path, Fitting(), xacro={"a": 1.0})


def test_without_the_package_the_remedy_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("planning.vendor_files.xacro_file.find_spec", lambda _: None)
    with pytest.raises(RobotModelError, match="pip install 'assembly-twin"):
        xacro_root(package(tmp_path), {})
