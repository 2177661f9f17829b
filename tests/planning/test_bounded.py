"""Files that somebody else made: their size is bounded before they are read, and they are files."""

import json
import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from planning.errors import OutputError
from planning.files import read_file, read_npz, require_own_files
from planning.json_files import MOST_VALUES, parse_json
from planning.parquet import read_parquet


def test_only_regular_files_are_read_and_pipes_of_the_shell(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    for path, words in (
        (tmp_path / "fifo", "no regular file"),
        (tmp_path, "directory"),
        (Path("/dev/null"), "no regular file"),
        (tmp_path / "none", "No such file"),
    ):
        with pytest.raises(OSError, match=words):
            read_file(path)
    end, begin = os.pipe()
    os.write(begin, b"piped")
    os.close(begin)
    assert read_file(Path(f"/dev/fd/{end}")) == b"piped"
    os.close(end)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[" + "{}," * (MOST_VALUES // 2) + "1]", "more than"),
        ("[" * 100_000, "nested too deeply"),
        ('{"a": 1, "b": {"c": 1, "c": 2}}', "key 'c' is given twice"),
        (r'["\ud800"]', "half of a surrogate pair"),
        (r'{"\\\uDC00": 1}', "half of a surrogate pair"),
        ("[NaN]", "NaN is no number"),
        ("[1, -Infinity]", "-Infinity is no number"),
        ("[1,,]", "Expecting value"),
        ("9" * 5000, "4300"),
        (b"[1, \xff]", r"^not UTF-8 \(byte 4\)$"),
    ],
)
def test_json_of_no_bounds_is_refused(text: str | bytes, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        parse_json(text if isinstance(text, bytes) else text.encode())


def test_json_is_what_the_library_makes_of_it() -> None:
    text = json.dumps({"a": [1, 2.5, None, {"b": "\u00e9"}], "c": {"a": "{[,"}})
    assert parse_json(text) == json.loads(text)


def test_arrays_are_looked_at_before_there_is_room_for_them(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez_compressed(path, a=np.zeros(1 << 20))
    content = path.read_bytes()
    assert len(content) < 1 << 14
    assert read_npz(content, kinds="f", most=9 << 20)["a"].shape == (1 << 20,)
    with pytest.raises(ValueError, match="take more than"):
        read_npz(content, kinds="f", most=1 << 23)
    with pytest.raises(ValueError, match="holds float64"):
        read_npz(content, kinds="i", most=9 << 20)
    with pytest.warns(UserWarning, match="Duplicate"), zipfile.ZipFile(path, "a") as a:
        a.writestr("a.npy", a.read("a.npy"))
    with pytest.raises(ValueError, match="given twice"):
        read_npz(path.read_bytes(), kinds="f", most=1 << 30)
    entries = content + b"PK\x01\x02" * 300_000
    with pytest.raises(ValueError, match="more than 200000 arrays"):
        read_npz(entries, kinds="f", most=1 << 30)


def test_what_leads_out_of_a_folder_is_refused(tmp_path: Path) -> None:
    folder, outside = tmp_path / "in", tmp_path / "out"
    (folder / "deep").mkdir(parents=True)
    outside.mkdir()
    (outside / "file").write_text("")
    (folder / "file").write_text("")
    (folder / "deep/inside").symlink_to(folder / "file")
    names = ("file", "deep", "missing")
    require_own_files(folder, names)
    (tmp_path / "link").symlink_to(folder)
    require_own_files(tmp_path / "link", names)
    bad: dict[str, Callable[[Path], object]] = {
        "deep/out": lambda p: p.symlink_to(outside / "file"),
        "deep/up": lambda p: p.symlink_to("../../out/file"),
        "deep/other": lambda p: p.symlink_to(outside),
        "deep/loop": lambda p: p.symlink_to(p),
        "deep/self": lambda p: p.symlink_to(folder / "deep"),
        "deep/fifo": os.mkfifo,
        "missing": lambda p: p.symlink_to(outside / "file"),
    }
    for name, make in bad.items():
        make(folder / name)
        with pytest.raises(OutputError, match=name):
            require_own_files(folder, names)
        (folder / name).unlink()


def test_tables_of_a_run_are_small_and_have_their_columns(tmp_path: Path) -> None:
    robots = pa.array(["a", "a"]).dictionary_encode()
    good = {"t_s": [0.0, 1.0], "robot": robots, "node": [0, 1], "q_0": [0.0, None]}
    path = tmp_path / "trajectory.parquet"
    pq.write_table(pa.table(good), path)
    assert read_parquet(path).num_rows == 2
    for name, values, words in (
        ("t_s", [0, 1], "column t_s is int64, not double"),
        ("t_s", [0.0, np.nan], "column t_s has cells without a value"),
        ("node", [0, None], "column node has cells without a value"),
        ("robot", [1.0, 2.0], "column robot is double, not string"),
        ("q_0", ["a", "a"], "column q_0 is string, not double"),
        ("t_s", None, "column t_s is missing"),
    ):
        table = {k: v for k, v in (good | {name: values}).items() if v is not None}
        pq.write_table(pa.table(table), path)
        with pytest.raises(OutputError, match=words):
            read_parquet(path)
    path = tmp_path / "objects.parquet"
    names, turns = ["a"], [[1.0, 0.0, 0.0, 0.0]]
    good = {"t_s": [0.0], "object": names, "parent": names, "quat_wxyz": turns}
    for place, words in (
        ([0.0] * 3, ""),
        ([0.0], "a value"),
        ([np.inf] * 3, "a value"),
    ):
        pq.write_table(pa.table(good | {"xyz": [place]}), path)
        if not words:
            assert read_parquet(path).num_rows == 1
            continue
        with pytest.raises(OutputError, match=f"xyz has cells without {words}"):
            read_parquet(path)
    many = tmp_path / "many.parquet"
    pq.write_table(pa.table({"a": np.zeros(50_000_001, dtype=np.int8)}), many)
    assert many.stat().st_size < 1 << 20
    with pytest.raises(OutputError, match="50000001 rows of 1 columns"):
        read_parquet(many)
    many.write_bytes(b"PAR1" * 10)
    with pytest.raises(OutputError, match="cannot be read"):
        read_parquet(many)
