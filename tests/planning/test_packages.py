"""Files of packages, named as ROS names them, are found in Python's packages and in those of ROS."""

from __future__ import annotations

from pathlib import Path

import pytest

import planning
from planning.errors import ShapeError
from planning.files import file_named

HERE = Path(planning.__file__).parent


def test_a_path_is_relative_to_the_folder(tmp_path: Path) -> None:
    assert file_named("a/b.stl", tmp_path, ShapeError) == tmp_path / "a/b.stl"
    assert file_named("/a/b.stl", tmp_path, ShapeError) == Path("/a/b.stl")


def test_files_of_packages_of_python_are_found_without_importing_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = file_named("package://planning/robots/urdf/ur5e.urdf", tmp_path, ShapeError)
    assert found == HERE / "robots/urdf/ur5e.urdf"
    (tmp_path / "loud").mkdir()
    (tmp_path / "loud/__init__.py").write_text("raise SystemExit")
    (tmp_path / "loud/arm.urdf").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    assert file_named("package://loud/arm.urdf", HERE, ShapeError).is_file()


@pytest.mark.parametrize(
    ("variable", "folder"), [("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")]
)
def test_packages_of_ros_come_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str, folder: str
) -> None:
    file = tmp_path / folder / "planning" / "arm.urdf"
    file.parent.mkdir(parents=True)
    file.write_text("")
    monkeypatch.setenv(variable, str(tmp_path))
    assert file_named("package://planning/arm.urdf", HERE, ShapeError) == file
    # What ROS's package of that name has not may be in Python's.
    name = "package://planning/errors.py"
    assert file_named(name, tmp_path, ShapeError) == HERE / "errors.py"


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("package://nowhere/a.stl", "no package 'nowhere' is installed"),
        ("package://planning.robots/a.stl", "no package 'planning.robots'"),
        ("package://__main__/a.stl", "no package '__main__'|no file 'a.stl'"),
        ("package://planning/a.stl", "there is no file 'a.stl' in"),
        ("package://", "no package ''"),
    ],
)
def test_what_is_not_there_is_said(name: str, says: str) -> None:
    with pytest.raises(ShapeError, match=says):
        file_named(name, HERE, ShapeError)
