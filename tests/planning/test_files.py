"""Files are read whole, or refused before they take more memory than they may."""

from __future__ import annotations

import resource
from pathlib import Path

import pytest

from planning.files import is_file, read_file


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
    with pytest.raises(OSError, match="larger than 1 MiB"):
        read_file(Path("/dev/zero"), 1 << 20)
    with pytest.raises(OSError, match="null"):
        read_file(Path("a\0b"))
    assert not is_file(Path("a\0b"))
    assert not is_file(Path("x" * 5000))
