"""Look at a run again: in the viewer, or as still pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from planning.errors import OutputError
from twin.run.folder import RECORDING
from twin.run.viewer import open_viewer, render_stills


def replay_run(
    run: Path, *, stills_s: Sequence[float] = (), out: Path | None = None
) -> list[Path]:
    """Open the viewer on the recording of a run, or render stills of it.

    Args:
        run: folder of a run, or a ``.rrd`` file.
        stills_s: simulated times to render without a display [s]; none opens the viewer.
        out: folder for the stills; by default ``stills`` beside the recording.

    Returns:
        The stills rendered.

    Raises:
        OutputError: there is no recording.
        ViewerError: the viewer cannot be used; says how to look at the recording otherwise.
    """
    recording = run if run.is_file() else run / RECORDING
    if not recording.is_file():
        where = (
            "no such file or folder" if not run.exists() else f"it has no {RECORDING}"
        )
        raise OutputError(f"{run}: nothing to replay, {where}")
    if stills_s:
        return render_stills(recording, stills_s, out or recording.parent / "stills")
    open_viewer(recording)
    return []
