"""The Rerun viewer: open a recording, or render stills without a display."""

from __future__ import annotations

import atexit
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any
from urllib.parse import quote

from planning.errors import OutputError, TwinError

TIMELINE = "sim_time"
_HOST = "127.0.0.1"
_START_S = 60.0
"""Longest time that is waited for the viewer, or for its picture [s]."""

_FIRST_SETTLE_S = 3.0
"""Time for the viewer to draw everything after its start [s]."""

_SETTLE_S = 1.2
"""Time for it to draw another moment [s]."""

_STILL_SIZE = "1600x900"


class ViewerError(TwinError):
    """The viewer cannot be started, or does not answer."""


def open_viewer(recording: Path) -> None:
    """Open the viewer window on a recording and return when it is closed.

    Raises:
        ViewerError: there is no viewer or no display; names alternatives.
    """
    program = _program(f"; the recording is {recording}")
    _require_display(
        f"copy {recording} to a computer with one and run 'rerun {recording.name}' there "
        "(pip install rerun-sdk), or render pictures with --stills"
    )
    command = [program, "--bind", _HOST, "--port", str(_free_port()), str(recording)]
    code = subprocess.run(command, check=False).returncode
    if code not in (0, -signal.SIGINT):
        raise ViewerError(f"the viewer ended with exit code {code}")


def live_viewer() -> str:
    """Open a viewer window; return the recording stream that it shows.

    The window stays open when this program ends.

    Raises:
        ViewerError: there is no viewer, no display, or it does not answer.
    """
    _require_display("leave --view out, and look at the recording later")
    port = _free_port()
    command = [_program(), "--bind", _HOST, "--port", str(port)]
    _require_started(_started(command), port)
    return _proxy(port)


def web_viewer() -> tuple[str, str]:
    """Serve a viewer to browsers of this machine; return its stream and its page.

    It is there until this program ends.

    Raises:
        ViewerError: there is no viewer, or it does not answer.
    """
    port, page = _free_port(), _free_port()
    command = [_program(), "--serve-web", "--bind", _HOST, "--port", str(port)]
    process = _started([*command, "--web-viewer-port", str(page)])
    atexit.register(_end, process)
    for own in (port, page):
        _require_started(process, own)
    return _proxy(port), f"http://{_HOST}:{page}/?url={quote(_proxy(port), safe='')}"


def _proxy(port: int) -> str:
    return f"rerun+http://{_HOST}:{port}/proxy"


def _started(
    command: Sequence[str],
    output: IO[bytes] | int = subprocess.DEVNULL,
    environment: Mapping[str, str] | None = None,
) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        command,
        env=environment,
        stdout=output,
        stderr=output,
        start_new_session=True,
    )


def _end(process: subprocess.Popen[bytes]) -> None:
    """Terminate a viewer with its process group: the ``rerun`` program is a wrapper that starts the viewer."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGTERM)


def _require_started(process: subprocess.Popen[bytes], port: int) -> None:
    until = time.monotonic() + _START_S
    while time.monotonic() < until and process.poll() is None:
        with socket.socket() as probe:
            probe.settimeout(0.3)
            if probe.connect_ex((_HOST, port)) == 0:
                return
        time.sleep(0.2)
    raise ViewerError("the viewer did not start")


def render_stills(
    recording: Path, times_s: Sequence[float], folder: Path
) -> list[Path]:
    """Render pictures of a recording at some simulated times, without a display.

    Needs a Vulkan driver; a software one does, such as Mesa's lavapipe.

    Args:
        recording: the ``.rrd`` file.
        times_s: simulated times [s].
        folder: where the pictures go.

    Returns:
        The pictures, ``still_<time>.png``, in the order of the times.

    Raises:
        ViewerError: the viewer does not start, or draws nothing.
        OutputError: the folder cannot be written.
    """
    made = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot hold stills: {error}") from error
    try:
        with _headless_viewer(recording) as client:
            client.open(str(recording.resolve()))
            return [
                _render_still(client, time_s, folder, first=k == 0)
                for k, time_s in enumerate(times_s)
            ]
    finally:
        if made:
            with suppress(OSError):  # keep the folder if it has stills
                folder.rmdir()


def _render_still(client: Any, time_s: float, folder: Path, *, first: bool) -> Path:
    client.set_time(TIMELINE, duration=float(time_s), play_state="paused")
    picture = (folder / f"still_{time_s:09.3f}.png").resolve()
    # The viewer answers before it has drawn everything; the first picture takes longest.
    time.sleep(_FIRST_SETTLE_S if first else _SETTLE_S)
    if first:
        client.save_screenshot(str(picture))
        time.sleep(_SETTLE_S)
    client.save_screenshot(str(picture))
    until = time.monotonic() + _START_S
    while time.monotonic() < until:
        if picture.is_file() and picture.stat().st_size > 0:
            return picture
        time.sleep(0.1)
    raise ViewerError(f"the viewer did not draw {picture}")


def _require_display(otherwise: str) -> None:
    has_display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform.startswith("linux") and not has_display:
        raise ViewerError(f"no display to open the viewer on; {otherwise}")


def _program(remark: str = "") -> str:
    sibling = Path(sys.executable).parent / "rerun"
    program = str(sibling) if sibling.is_file() else shutil.which("rerun")
    if program is None:
        raise ViewerError(
            f"the Rerun viewer is not installed (pip install rerun-sdk){remark}"
        )
    return program


@contextmanager
def _headless_viewer(recording: Path) -> Iterator[Any]:
    """Run a headless viewer, yield its client, and end it with all its children."""
    program = _program(f"; the recording is {recording}")
    port = _free_port()
    command = [program, "--headless", "--bind", _HOST, "--port", str(port)]
    command += ["--window-size", _STILL_SIZE, "--hide-welcome-screen"]
    with tempfile.TemporaryDirectory() as home:
        environment = {
            **os.environ,
            "XDG_DATA_HOME": home,
            "XDG_CONFIG_HOME": home,
            "NO_COLOR": "1",
        }
        log = Path(home) / "viewer.log"
        with log.open("wb") as output:
            process = _started(command, output, environment)
        begin = time.monotonic()
        try:
            yield _connected(process, port)
        except Exception as error:
            raise ViewerError(
                f"no picture was drawn: {' '.join(command)} {_exit_state(process)} after"
                f" {time.monotonic() - begin:.0f} s: {error}. Its last words: {_last_message(log)}. It needs a"
                " Vulkan driver, of which a software one such as Mesa's lavapipe (mesa-vulkan-drivers)"
                f" is enough; 'rerun {recording}' on a computer with a display shows the recording"
            ) from error
        finally:
            _end(process)
            process.wait(timeout=20)


def _exit_state(process: subprocess.Popen[bytes]) -> str:
    code = process.poll()
    return "did not answer" if code is None else f"ended with exit code {code}"


def _last_message(log: Path) -> str:
    """Return the panic message of a viewer, else the last line of its log."""
    lines = [
        line for line in log.read_text(errors="replace").splitlines() if line.strip()
    ]
    panic = next((line for line in lines if "panicked" in line), None)
    return panic or (lines[-1].strip() if lines else "none")


def _connected(process: subprocess.Popen[bytes], port: int) -> Any:
    """Return a client of a viewer, once it answers."""
    from rerun.experimental import ViewerClient

    until = time.monotonic() + _START_S
    while True:
        try:
            return ViewerClient.connect(_proxy(port))
        except Exception as error:
            if process.poll() is not None or time.monotonic() > until:
                raise ConnectionError("no connection") from error
            time.sleep(0.3)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind((_HOST, 0))
        port: int = probe.getsockname()[1]
        return port
