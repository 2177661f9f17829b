"""Results of blocks on disk, one file each, whole or not there: what a killed study goes on from."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from planning.errors import OutputError
from twin.host.atomic import replacing
from twin.study.replications.experiment import Block
from twin.study.replications.replication_rows import ReplicationRows
from twin.study.replications.task_tally import TaskTally
from twin.study.replications.workload import BlockResult

_NAME = re.compile(r"(\d+)-(\d+)-(\d+)\.npz")
_ROWS = ("replication", "makespan_ns", "busy_ns", "waited_ns")
_TEXTS = ("outcome", "error")
_TALLY = ("critical", "critical_edges", "slack_ns", "start_ns", "end_ns")


def write_block(folder: Path, result: BlockResult) -> None:
    """Write the result of a block.

    Raises:
        OutputError: the file cannot be written.
    """
    arrays = {name: getattr(result.rows, name) for name in _ROWS}
    arrays |= {name: getattr(result.rows, name).astype(str) for name in _TEXTS}
    arrays |= {name: getattr(result.tally, name) for name in _TALLY}
    arrays["count"] = np.array(result.tally.count)
    arrays["engine"] = np.array(result.rows.engine)
    arrays["robots"] = np.array(result.rows.robots, dtype=str)
    with replacing(_path(folder, result.block)) as temporary:
        np.savez_compressed(temporary, **arrays)


def read_block(folder: Path, block: Block) -> BlockResult:
    """Return what ``write_block`` wrote.

    Raises:
        OutputError: the file is missing or damaged.
    """
    path = _path(folder, block)
    try:
        with np.load(path, allow_pickle=False) as arrays:
            rows = ReplicationRows(
                **{name: arrays[name] for name in _ROWS},
                **{name: arrays[name].astype(object) for name in _TEXTS},
                engine=str(arrays["engine"]),
                robots=tuple(arrays["robots"].tolist()),
            )
            tally = TaskTally(
                int(arrays["count"]), **{name: arrays[name] for name in _TALLY}
            )
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise OutputError(f"{path}: is no block of a study: {error}") from error
    return BlockResult(block, rows, tally)


def blocks_done(folder: Path) -> Iterator[Block]:
    """Yield the blocks of which there is a file."""
    for path in folder.glob("*.npz"):
        match = _NAME.fullmatch(path.name)
        if match:
            cell, first, count = (int(text) for text in match.groups())
            yield Block(cell, first, count)


def _path(folder: Path, block: Block) -> Path:
    return folder / f"{block.cell}-{block.first}-{block.count}.npz"
