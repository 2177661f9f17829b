"""The Rerun viewer: open it on a recording, or have it render stills without a display."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from planning.errors import OutputError, TwinError

TIMELINE = "sim_time"
_HOST = "127.0.0.1"
_START_S = 60.0
_FIRST_SETTLE_S = 3.0
_SETTLE_S = 1.2


class ViewerError(TwinError):
    """The viewer cannot be started, or does not answer."""


def open_viewer(recording: Path) -> None:
    """Open the viewer window on a recording and return when it is closed.

    Raises:
        ViewerError: there is no viewer or no display; says how to look at the file otherwise.
    """
    program = _viewer_program(recording)
    has_display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform.startswith("linux") and not has_display:
        raise ViewerError(
            f"no display to open the viewer on; copy {recording} to a computer with one and "
            f"run 'rerun {recording.name}' there (pip install rerun-sdk), or render pictures "
            "with --stills"
        )
    command = [program, "--bind", _HOST, "--port", str(_free_port()), str(recording)]
    code = subprocess.run(command, check=False).returncode
    if code not in (0, -signal.SIGINT):
        raise ViewerError(f"the viewer ended with exit code {code}")


def render_stills(
    recording: Path,
    times_s: Sequence[float],
    folder: Path,
    *,
    size: tuple[int, int] = (1600, 900),
) -> list[Path]:
    """Render pictures of a recording at some simulated times, without a display.

    Needs a Vulkan driver; a software one does, such as Mesa's lavapipe.

    Args:
        recording: the ``.rrd`` file.
        times_s: simulated times [s].
        folder: where the pictures go.
        size: width and height [px].

    Returns:
        The pictures, ``still_<time>.png``, in the order of the times.

    Raises:
        ViewerError: the viewer does not start, or draws nothing.
        OutputError: the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot hold stills: {error}") from error
    pictures = []
    with _headless_viewer(recording, size) as port:
        client = _connect(port)
        client.open(str(recording.resolve()))
        for k, time_s in enumerate(times_s):
            client.set_time(TIMELINE, duration=float(time_s), play_state="paused")
            # The viewer answers before it has drawn everything, most of all the first time.
            time.sleep(_FIRST_SETTLE_S if k == 0 else _SETTLE_S)
            picture = (folder / f"still_{time_s:09.3f}.png").resolve()
            if k == 0:
                client.save_screenshot(str(picture))
                time.sleep(_SETTLE_S)
            client.save_screenshot(str(picture))
            pictures.append(_wait_for(picture))
    return pictures


def _viewer_program(recording: Path) -> str:
    beside = Path(sys.executable).parent / "rerun"
    program = str(beside) if beside.is_file() else shutil.which("rerun")
    if program is None:
        raise ViewerError(
            "the Rerun viewer is not installed (pip install rerun-sdk); "
            f"the recording is {recording}"
        )
    if not recording.is_file():
        raise ViewerError(f"{recording} does not exist")
    return program


@contextmanager
def _headless_viewer(recording: Path, size: tuple[int, int]) -> Iterator[int]:
    """Run a viewer without a window; yield its port and end it with all its children."""
    program = _viewer_program(recording)
    port = _free_port()
    command = [program, "--headless", "--bind", _HOST, "--port", str(port)]
    command += ["--window-size", f"{size[0]}x{size[1]}", "--hide-welcome-screen"]
    with tempfile.TemporaryDirectory() as home:
        environment = {**os.environ, "XDG_DATA_HOME": home, "XDG_CONFIG_HOME": home}
        log = Path(home) / "viewer.log"
        with log.open("wb") as output:
            process = subprocess.Popen(
                command,
                env=environment,
                stdout=output,
                stderr=output,
                start_new_session=True,
            )
        try:
            _wait_for_port(port, process, log)
            yield port
        finally:
            # The program is a shim: the viewer proper is its child, in the same group.
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGTERM)
            process.wait(timeout=20)


def _wait_for_port(port: int, process: subprocess.Popen[bytes], log: Path) -> None:
    until = time.monotonic() + _START_S
    while time.monotonic() < until:
        if process.poll() is not None:
            break
        try:
            with socket.create_connection((_HOST, port), timeout=1.0):
                return
        except OSError:
            time.sleep(0.2)
    tail = log.read_text(errors="replace").strip().splitlines()[-3:]
    raise ViewerError(
        "the headless viewer did not start; it needs a Vulkan driver, such as the package "
        f"mesa-vulkan-drivers. It said: {' | '.join(tail)}"
    )


def _connect(port: int):  # type: ignore[no-untyped-def]  # the client class is experimental
    from rerun.experimental import ViewerClient

    until = time.monotonic() + _START_S
    while True:
        try:
            return ViewerClient.connect(f"rerun+http://{_HOST}:{port}/proxy")
        except Exception as error:
            if time.monotonic() > until:
                raise ViewerError(f"the viewer does not answer: {error}") from error
            time.sleep(0.3)


def _wait_for(picture: Path) -> Path:
    until = time.monotonic() + _START_S
    while time.monotonic() < until:
        if picture.is_file() and picture.stat().st_size > 0:
            return picture
        time.sleep(0.1)
    raise ViewerError(f"the viewer did not draw {picture}")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((_HOST, 0))
        port: int = probe.getsockname()[1]
        return port
