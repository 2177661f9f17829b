"""Where the chain of frames from what is drawn to the world breaks off, in a recording read back.

The viewer warns of every entity of a 3-D view whose frame it cannot follow to the view's own at
the time that is looked at, also where nothing is drawn of that entity yet, and of every frame that
two entities place, both for good or both in time.
"""

from collections import defaultdict
from pathlib import Path

import pyarrow as pa
from rerun.chunk import Chunk, RrdReader

GEOMETRY = ("half_sizes", "lengths", "radii", "positions", "blob", "vertex_positions")
ALWAYS = -(2**63)


def broken_chains(path: Path, root: str = "world") -> list[str]:
    """Return what is wrong with the frames of a recording on its timelines, in words."""
    chunks = list(RrdReader(path).store().stream())
    timelines = {name for chunk in chunks for name in _timelines(chunk)}
    assert timelines, "nothing happens in this recording"
    return [text for name in sorted(timelines) for text in _broken(chunks, name, root)]


def _broken(chunks: list[Chunk], timeline: str, root: str) -> list[str]:
    """Look at every instant from the first row of a timeline on."""
    frame_of: dict[str, dict[int, str]] = defaultdict(dict)
    parent_of: dict[str, dict[int, str]] = defaultdict(dict)
    said_by: dict[tuple[str, bool], set[str]] = defaultdict(set)
    drawn: set[str] = set()
    first = min(
        (t for chunk in chunks for t in _times(chunk, timeline)), default=ALWAYS
    )
    for chunk in chunks:
        batch = chunk.to_record_batch()
        names = batch.schema.names
        times = [ALWAYS] * batch.num_rows
        if not chunk.is_static:
            times = _times(chunk, timeline)
        shapes = [n for n in names if n.split(":")[-1] in GEOMETRY and "3D:" in n]
        for name in shapes:
            if any(batch.column(name).to_pylist()):
                drawn.add(chunk.entity_path)
        if "CoordinateFrame:frame" in names:
            cells = batch.column("CoordinateFrame:frame").to_pylist()
            for t, cell in zip(times, cells, strict=False):
                if cell:
                    frame_of[chunk.entity_path][t] = cell[0]
        if "Transform3D:child_frame" in names:
            ends = zip(
                batch.column("Transform3D:child_frame").to_pylist(),
                batch.column("Transform3D:parent_frame").to_pylist(),
                strict=True,
            )
            for t, (child, parent) in zip(times, ends, strict=False):
                parent_of[child[0]][t] = parent[0]
                said_by[child[0], chunk.is_static].add(chunk.entity_path)
    broken = [
        f"{timeline}: {frame!r} is placed by {sorted(entities)}"
        for (frame, _), entities in said_by.items()
        if len(entities) > 1
    ]
    for entity in sorted(drawn):
        frames = frame_of.get(entity)
        if not frames or min(frames) > first:
            broken.append(f"{timeline}: {entity} has no frame at first")
            continue
        for frame in set(frames.values()):
            if reason := _leads_nowhere(frame, parent_of, first, root, ()):
                broken.append(f"{timeline}: {entity}: {reason}")
    return broken


def _leads_nowhere(
    frame: str,
    parent_of: dict[str, dict[int, str]],
    first: int,
    root: str,
    seen: tuple[str, ...],
) -> str:
    if frame == root:
        return ""
    if frame in seen:
        return f"{frame!r} hangs on itself"
    rows = parent_of.get(frame)
    if not rows:
        return f"{frame!r} has no transform"
    if min(rows) > first:
        return (
            f"{frame!r} has no transform before {min(rows)}, the first row is {first}"
        )
    found = (
        _leads_nowhere(parent, parent_of, first, root, (*seen, frame))
        for parent in sorted(set(rows.values()))
    )
    return next((reason for reason in found if reason), "")


def _timelines(chunk: Chunk) -> list[str]:
    schema = chunk.to_record_batch().schema
    return [
        field.name
        for field in schema
        if (field.metadata or {}).get(b"rerun:kind") == b"index"
    ]


def _times(chunk: Chunk, timeline: str) -> list[int]:
    if timeline not in _timelines(chunk):
        return []
    batch = chunk.to_record_batch()
    times: list[int] = batch.column(timeline).cast(pa.int64()).to_pylist()
    return times
