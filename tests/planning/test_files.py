"""Files are read whole or refused, packages are found, and answers are found once, and again where files are damaged."""

import resource
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FrameType

import numpy as np
import pytest
from trimesh.creation import extrude_triangulation

import planning
from planning import caches, errors, files, packed, transforms
from planning.caches import Arrays, cache_folder, load_or_compute
from planning.cell import cover, shape
from planning.cell.cover import capsule_cover, capsule_covers
from planning.errors import ShapeError
from planning.files import is_file, read_file, resolve_file_name
from planning.meshes import mesh_loading
from planning.robots import self_collision
from planning.robots.registry import robot_model
from planning.robots.self_collision import never_colliding_pairs
from planning.transforms import Array


@pytest.mark.parametrize("size", [0, 1, 5000, 3_000_000])
def test_a_file_is_read_whole(tmp_path: Path, size: int) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"x" * size)
    assert read_file(path, size) == b"x" * size
    if size:
        with pytest.raises(OSError, match="larger than"):
            read_file(path, size - 1)


def test_a_small_file_takes_little_memory_whatever_it_might_be(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"little")
    before = resource.getrlimit(resource.RLIMIT_DATA)
    resource.setrlimit(resource.RLIMIT_DATA, (8 << 30, before[1]))
    try:
        assert read_file(path, 1 << 40) == b"little"
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


def test_devices_and_impossible_paths_are_errors_like_others() -> None:
    with pytest.raises(OSError, match="is no regular file"):
        read_file(Path("/dev/zero"), 1 << 20)
    with pytest.raises(OSError, match="null"):
        read_file(Path("a\0b"))
    assert not is_file(Path("a\0b"))
    assert not is_file(Path("x" * 5000))


HERE = Path(planning.__file__).parent


def test_a_path_is_relative_to_the_folder(tmp_path: Path) -> None:
    assert resolve_file_name("a/b.stl", tmp_path, ShapeError) == tmp_path / "a/b.stl"
    assert resolve_file_name("/a/b.stl", tmp_path, ShapeError) == Path("/a/b.stl")


def test_files_of_packages_of_python_are_found_without_importing_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = resolve_file_name(
        "package://planning/robots/urdf/ur5e.urdf", tmp_path, ShapeError
    )
    assert found == HERE / "robots/urdf/ur5e.urdf"
    (tmp_path / "loud").mkdir()
    (tmp_path / "loud/__init__.py").write_text("raise SystemExit")
    (tmp_path / "loud/arm.urdf").write_text("")
    monkeypatch.syspath_prepend(tmp_path)
    assert resolve_file_name("package://loud/arm.urdf", HERE, ShapeError).is_file()


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
    assert resolve_file_name("package://planning/arm.urdf", HERE, ShapeError) == file
    # What ROS's package of that name has not may be in Python's.
    name = "package://planning/errors.py"
    assert resolve_file_name(name, tmp_path, ShapeError) == HERE / "errors.py"


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
        resolve_file_name(name, HERE, ShapeError)


NAMES = frozenset({"a", "b"})


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(caches, "LEAST_SECONDS_TO_CACHE", 0.0)
    return cache_folder("tried")


def counted(answer: Arrays) -> tuple[list[int], Callable[[], Arrays]]:
    times: list[int] = []

    def find() -> Arrays:
        times.append(1)
        return answer

    return times, find


def test_an_answer_is_found_once(folder: Path) -> None:
    times, find = counted({"a": np.arange(3), "b": np.array([0.1, -np.inf])})
    for _ in range(3):
        known = load_or_compute("tried", b"one", NAMES, find, [])
        assert known["a"].tolist() == [0, 1, 2]
        assert known["b"].tolist() == [0.1, -np.inf]
    assert len(times) == 1
    load_or_compute("tried", b"two", NAMES, find, [])
    assert len(times) == 2
    assert len(list(folder.iterdir())) == 2


@pytest.mark.parametrize("content", [b"", b"no arrays", b"PK" * 50])
def test_a_damaged_file_is_made_anew(folder: Path, content: bytes) -> None:
    times, find = counted({"a": np.arange(3), "b": np.zeros(1)})
    load_or_compute("tried", b"one", NAMES, find, [])
    (file,) = folder.iterdir()
    file.write_bytes(content)
    assert load_or_compute("tried", b"one", NAMES, find, [])["a"].tolist() == [0, 1, 2]
    assert load_or_compute("tried", b"one", NAMES, find, [])["a"].tolist() == [0, 1, 2]
    assert len(times) == 2


def test_other_arrays_are_no_answer() -> None:
    load_or_compute("tried", b"one", frozenset({"c"}), lambda: {"c": np.zeros(1)}, [])
    times, find = counted({"a": np.arange(3), "b": np.zeros(1)})
    assert load_or_compute("tried", b"one", NAMES, find, []).keys() == NAMES
    assert times == [1]


def test_where_nothing_can_be_written_answers_are_found_anew(folder: Path) -> None:
    folder.parent.mkdir(parents=True)
    folder.write_text("a file where the folder should be")
    times, find = counted({"a": np.arange(3), "b": np.zeros(1)})
    for _ in range(2):
        assert load_or_compute("tried", b"one", NAMES, find, [])["b"].tolist() == [0.0]
    assert len(times) == 2


def test_what_another_source_found_is_no_answer(tmp_path: Path) -> None:
    sources = [str(tmp_path / name) for name in ("one.py", "other.py")]
    for source in sources:
        Path(source).write_text("a = 1")
    times, find = counted({"a": np.arange(3), "b": np.zeros(1)})

    def in_another_process() -> None:
        caches._hash_of.cache_clear()
        for _ in range(2):
            load_or_compute("tried", b"one", NAMES, find, sources)

    in_another_process()
    in_another_process()
    assert len(times) == 1
    for count, source in enumerate(sources, start=2):
        Path(source).write_text("a = 2")
        in_another_process()
        assert len(times) == count
    Path(sources[0]).write_text("a = 1")
    Path(sources[1]).write_text("a = 1")
    in_another_process()  # as it was at first
    assert len(times) == 3


def test_sources_are_read_once_a_process_and_when_they_are_first_needed(
    tmp_path: Path,
) -> None:
    source = tmp_path / "one.py"
    source.write_text("a = 1")
    _, find = counted({"a": np.arange(3), "b": np.zeros(1)})
    load_or_compute("tried", b"one", NAMES, find, [str(source)])
    source.unlink()
    load_or_compute("tried", b"two", NAMES, find, [str(source)])


def test_what_is_found_quickly_is_not_written(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(caches, "LEAST_SECONDS_TO_CACHE", 60.0)
    times, find = counted({"a": np.arange(3), "b": np.zeros(1)})
    for _ in range(2):
        load_or_compute("tried", b"one", NAMES, find, [])
    assert len(times) == 2
    assert not folder.exists()


def test_covers_are_those_of_each_hull(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)
    hulls: list[Array] = [rng.normal(size=(n, 3)) for n in (6, 12, 30)]
    found = capsule_covers(hulls, thrift=0.2)
    monkeypatch.setattr(cover, "capsule_cover", None)
    again = capsule_covers(hulls, thrift=0.2)
    for hull, one, other in zip(hulls, found, again, strict=True):
        alone = capsule_cover(hull, thrift=0.2)
        for name in ("start", "end", "radius"):
            wanted = getattr(alone, name)
            assert np.array_equal(getattr(one, name), wanted)
            assert np.array_equal(getattr(other, name), wanted)
            assert not getattr(other, name).flags.writeable
    assert capsule_covers([]) == ()


def test_pairs_of_a_robot_are_those_that_were_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robot = robot_model("ur5e")
    given = (robot.chain, robot.parts, robot.lower, robot.upper, robot.home)
    found = never_colliding_pairs(*given)
    assert found == robot.never_collide
    assert len(found) > len(robot.parts)
    monkeypatch.setattr(self_collision, "_Pairs", None)
    assert never_colliding_pairs(*given) == found
    # Another question: joints that turn less far.
    with pytest.raises(TypeError):
        never_colliding_pairs(*given[:2], robot.lower / 2, robot.upper, robot.home)


PLUMBING = {
    Path(str(m.__file__)) for m in (caches, errors, files, transforms, packed, shape)
}
"""Code that hands answers on, and decides none."""


def a_bracket(folder: Path) -> Callable[[], object]:
    corners = [(0, 0), (0.1, 0), (0.1, 0.02), (0.02, 0.02), (0.02, 0.1), (0, 0.1)]
    triangles = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    file = folder / "bracket.stl"
    extrude_triangulation(corners, triangles, height=0.01).export(file)
    return lambda: mesh_loading.load_mesh(file)


def a_hull(_: Path) -> Callable[[], object]:
    hull = np.random.default_rng(3).normal(size=(9, 3))
    return lambda: capsule_covers([hull])


def a_robot(_: Path) -> Callable[[], object]:
    robot = robot_model("ur5e")
    some = robot.parts[::3]  # all would take long while being watched
    given = (robot.chain, some, robot.lower, robot.upper, robot.home)
    return lambda: never_colliding_pairs(*given)


@pytest.mark.parametrize(
    ("question", "sources"),
    [
        (a_bracket, mesh_loading._SOURCES),
        (a_hull, [cover.__file__]),
        (a_robot, self_collision._SOURCES),
    ],
)
def test_the_sources_of_an_answer_are_the_code_that_finds_it(
    question: Callable[[Path], Callable[[], object]],
    sources: Sequence[str],
    tmp_path: Path,
) -> None:
    """What runs while an answer is found is written down, and compared with what is named."""
    ask = question(tmp_path)
    ran = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        ran.add(Path(frame.f_code.co_filename))

    sys.setprofile(note)
    try:
        ask()
    finally:
        sys.setprofile(None)
    project = Path(files.__file__).parent
    own = {path for path in ran if path.is_relative_to(project)}
    assert own - PLUMBING == {Path(source) for source in sources}
