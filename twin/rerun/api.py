"""Function ``twin.replay``: shows a run in the Rerun viewer, or renders still pictures."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory

from planning.errors import OutputError, RequestError
from planning.files import replace_atomically
from twin.host.arguments import checks_arguments
from twin.rerun.viewer import open_viewer, render_stills
from twin.runs.folder import RECORDING
from twin.trial.loaded_scenario import PathOrName
from twin.trial.run_result import RunResult

STILLS = "stills"
"""Folder of pictures next to a recording."""


@checks_arguments
def replay(
    run: RunResult | PathOrName,
    *,
    stills: Sequence[float] = (),
    out: PathOrName | None = None,
) -> tuple[Path, ...]:
    """Show a run in the Rerun viewer, or render stills of it.

    Without stills and ``out`` this opens the viewer and returns once it is closed. Pictures need
    no display, but a Vulkan driver; a software one does.

    Args:
        run: a run, its folder, or an ``.rrd`` file.
        stills: render pictures at these simulated times instead [s].
        out: folder for the pictures, by default ``stills`` next to the recording; without stills,
            the ``.rrd`` file that is written instead of opening the viewer.

    Returns:
        The files that were written.

    Raises:
        OutputError: there is no recording, or a file cannot be written.
        ViewerError: the viewer or a display is missing; names the remedy.
        RequestError: pictures of a run without a folder need one.
    """
    with TemporaryDirectory() as name:
        recording = _recording(run, Path(name) / RECORDING)
        if stills:
            if out is None and recording.parent == Path(name):
                raise RequestError(
                    "a run without a folder: say where pictures go by out"
                )
            folder = recording.parent / STILLS if out is None else Path(out)
            return tuple(render_stills(recording, stills, folder))
        if out is None:
            open_viewer(recording)
            return ()
        with replace_atomically(Path(out)) as temporary:
            temporary.write_bytes(recording.read_bytes())
        return (Path(out),)


def _recording(run: RunResult | PathOrName, place: Path) -> Path:
    """Return the recording of a run, writing one if missing."""
    if not isinstance(run, str | PathLike):
        if run.record is not None and run.folder is None:
            from twin.rerun.recorder import write_recording

            write_recording(place, run.tpg, run.record, run.history, name=run.name)
            return place
        folder = Path() if run.folder is None else run.folder
    else:
        folder = Path(run)
    found = folder if folder.is_file() else folder / RECORDING
    if not found.is_file():
        reason = (
            f"it has no {RECORDING}" if folder.exists() else "no such file or folder"
        )
        raise OutputError(f"{folder}: nothing to replay, {reason}")
    return found
