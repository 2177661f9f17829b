"""Web server of the page that shows a run.

It serves browsers on this machine only, and refuses cross-site requests.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import logging
import secrets
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, cast, get_args

from planning.errors import RequestError, TwinError
from twin.engine.execution_model import ExecutionModel
from twin.follow.drift import Drift
from twin.follow.forecast import Forecast, Forecaster
from twin.follow.log_lines import POLL_S, lines_of_growing_file
from twin.host.atomic_files import finite_or_none
from twin.page.panel import Action, NodesSoFar, Order, Panel

try:
    from tornado.httpserver import HTTPServer
    from tornado.web import Application, HTTPError, RequestHandler
except ImportError:
    raise RequestError(
        "a page needs the package 'tornado': pip install 'assembly-twin[page]'"
    ) from None

_log = logging.getLogger(__name__)

HOST = "127.0.0.1"
_MOST_BYTES = 1000
"""Largest size of an order [B]."""

_FORECAST_S, _SAMPLES = 2.0, 100
"""Least time between two forecasts [s], and number of simulated futures of each."""

_PAGE = Path(__file__).with_name("page.html")
_CONTENT_SECURITY_POLICY = (
    "default-src 'none'; style-src 'nonce-{0}'; script-src 'nonce-{0}'; connect-src 'self';"
    " img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


class PageServer:
    """Serves one page in a thread of its own.

    Attributes:
        port, address: port and URL of the page.
        token: token that orders must contain.
        hosts: host names under which requests may address this server.

    Args:
        panel: state shared with the run.
        model: execution model with durations of drivers, for forecasts; None for none.
        port: port of this machine, 0 for any free one.
        title: title of the page.
        log: event log of the run, served while it is written; None for none.
        scene: serves the 3-D scene, and returns its address; None for none.

    Raises:
        RequestError: the port is taken.
    """

    def __init__(
        self,
        panel: Panel,
        model: ExecutionModel | None,
        port: int = 0,
        title: str = "",
        log: Path | None = None,
        scene: Callable[[], str] | None = None,
    ) -> None:
        try:
            self._socket = socket.create_server((HOST, port))
        except (OSError, OverflowError) as error:
            raise RequestError(f"no page at port {port} of {HOST}: {error}") from error
        self._panel = panel
        self._socket.setblocking(False)
        self.port: int = self._socket.getsockname()[1]
        self.address = f"http://{HOST}:{self.port}/"
        self.token, self.title, self.log = secrets.token_urlsafe(24), title, log
        self.scene = scene
        self.hosts = {f"{name}:{self.port}" for name in (HOST, "localhost")}
        self.hosts |= {HOST, "localhost"} if self.port == 80 else set()
        self._forecast: Forecast | None = None
        self._drifts: tuple[Drift, ...] = ()
        self._over = threading.Event()
        serve = threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True)
        self._threads = [serve]
        if model is not None:
            update = threading.Thread(
                target=self._update_forecast, args=[model], daemon=True
            )
            self._threads.append(update)

    @contextmanager
    def serving(self) -> Iterator[None]:
        """Serve within the context."""
        for thread in self._threads:
            thread.start()
        try:
            yield
        finally:
            self._over.set()
            self._threads[0].join(timeout=5.0)

    async def _serve(self) -> None:
        answers = (r"/(state|order|scene|)", _PageHandler, {"server": self})
        events = (r"/(events\.jsonl)", _LogHandler, {"server": self})
        application = Application([answers, events], log_function=lambda _: None)
        server = HTTPServer(
            application,
            max_body_size=_MOST_BYTES,
            idle_connection_timeout=60.0,
            body_timeout=10.0,
        )
        server.add_socket(self._socket)
        while not self._over.is_set():
            await asyncio.sleep(0.1)
        server.stop()
        await asyncio.sleep(2 * POLL_S)  # for the last events
        await server.close_all_connections()

    def _update_forecast(self, model: ExecutionModel) -> None:
        """Update the forecast repeatedly from the executed part of the run."""
        before: NodesSoFar | None = None
        while not self._over.wait(_FORECAST_S):
            so_far = self._panel.so_far
            if so_far is None or so_far is before:
                continue
            try:
                if before is None or before.tpg is not so_far.tpg:
                    forecaster = Forecaster(so_far.tpg, model, samples=_SAMPLES)
                run = so_far.followed()
                self._forecast = forecaster.forecast(run)
                self._drifts = forecaster.drifts(run)
            except Exception as error:
                _log.warning("there is no forecast on the page: %s", error)
                return
            before = so_far

    def state(self) -> dict[str, Any]:
        """Return the content of the page as JSON values."""
        shown, forecast = self._panel.shown, self._forecast
        content: dict[str, Any] = {"shown": None, "forecast": None}
        content["drifts"] = [drift.words for drift in self._drifts]
        if shown is not None:
            content["shown"] = asdict(shown)
            content["age_s"] = round(time.monotonic() - self._panel.shown_s, 2)
        if forecast is not None:
            p50, p90 = forecast.quantile(0.5), forecast.quantile(0.9)
            content["forecast"] = {
                "p50_s": finite_or_none(p50),
                "p90_s": finite_or_none(p90),
            }
        return content

    @property
    def over(self) -> bool:
        """Whether the run is over."""
        return self._over.is_set()

    def take(self, body: bytes) -> None:
        """Pass an order to the run.

        Raises:
            ValueError: the order is invalid; the message says why.
        """
        given = json.loads(body)
        if not isinstance(given, dict):
            raise ValueError("an order is an object")
        action, robot = str(given.get("action")), given.get("robot", "")
        question, shown = given.get("question", 0), self._panel.shown
        if action not in get_args(Action):
            raise ValueError(f"action must be one of {', '.join(get_args(Action))}")
        if shown is None or shown.outcome:
            raise ValueError("nothing is under way")
        if robot != "" and robot not in [own.name for own in shown.robots]:
            raise ValueError("there is no such robot")
        answers = action in ("yes", "no")
        if answers:
            if not shown.question or question != shown.asked:
                raise ValueError("that question is not open")
        elif action == "out" and not robot:
            raise ValueError("which robot is out?")
        asked = shown.asked if answers else 0
        self._panel.orders.put(Order(cast(Action, action), robot, asked))


class _SameOriginHandler(RequestHandler):
    """Handler that accepts requests of this page or of non-browsers only."""

    def initialize(self, server: PageServer) -> None:
        self.server = server

    def set_default_headers(self) -> None:
        self.clear_header("Server")
        self.set_header("Cache-Control", "no-store")
        self.set_header("X-Content-Type-Options", "nosniff")
        self.set_header("Referrer-Policy", "no-referrer")
        self.set_header("Cross-Origin-Resource-Policy", "same-origin")

    def prepare(self) -> None:
        host, origin = self.request.host.lower(), self.request.headers.get("Origin")
        own = {f"http://{name}" for name in self.server.hosts}
        if host not in self.server.hosts or origin not in (None, *own):
            _log.warning("page: refused a request of %.80r for %.80r", origin, host)
            raise HTTPError(403)


class _LogHandler(_SameOriginHandler):
    """Streams the log of the run from its first event until the run is over."""

    left = False

    def on_connection_close(self) -> None:
        self.left = True

    async def get(self, _: str) -> None:
        if self.server.log is None:
            raise HTTPError(404)
        self.set_header("Content-Type", "application/jsonl; charset=utf-8")
        last = False
        # Other requests are answered while this one waits for further lines.
        for line in lines_of_growing_file(self.server.log, poll_s=0.0):
            if line is not None:
                self.write(f"{line}\n")
                continue
            if self.left or last:
                return
            await self.flush()
            last = self.server.over
            await asyncio.sleep(POLL_S)


class _PageHandler(_SameOriginHandler):
    """Serves the page and receives its orders."""

    async def get(self, what: str) -> None:
        if what == "state":
            self.finish(self.server.state())
            return
        if what == "scene" and self.server.scene is not None:
            try:
                self.redirect(await asyncio.to_thread(self.server.scene))
            except TwinError as error:
                self.set_status(404)
                self.set_header("Content-Type", "text/plain; charset=utf-8")
                self.finish(f"{error}\n")
            return
        if what:
            raise HTTPError(405)
        nonce = secrets.token_urlsafe(12)
        self.set_header(
            "Content-Security-Policy", _CONTENT_SECURITY_POLICY.format(nonce)
        )
        about = json.dumps({"token": self.server.token, "title": self.server.title})
        text = _PAGE.read_text(encoding="utf-8").replace("NONCE", nonce)
        self.finish(text.replace("ABOUT", about.replace("<", "\\u003c")))

    def post(self, what: str) -> None:
        token = self.request.headers.get("X-Token", "")
        if not hmac.compare_digest(token.encode(), self.server.token.encode()):
            _log.warning("page: refused an order without the token of the page")
            raise HTTPError(403)
        if what != "order":
            raise HTTPError(405)
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        try:
            self.server.take(self.request.body)
            self.set_status(202)
        except (ValueError, RecursionError) as error:
            self.set_status(400)
            self.finish(f"{error}\n")
