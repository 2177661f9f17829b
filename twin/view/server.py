"""Web server of the page: the scene of viser and the page around it, behind a token.

viser listens on this machine only. Its server is wrapped so that each request must have the token of the page in
its path, one of the names of this server as host, and the page itself as origin; all others are refused.
"""

from __future__ import annotations

import functools
import hmac
import io
import json
import logging
import secrets
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from http import HTTPStatus
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlsplit

from planning.errors import RequestError

try:
    import viser
    import websockets.asyncio.server
    from websockets.datastructures import Headers
    from websockets.http11 import Request, Response
except ImportError:
    raise RequestError(
        "twin view needs the package 'viser': pip install 'assembly-twin[view]'"
    ) from None

HOST = "127.0.0.1"

_SCENE = "scene"
"""Path of the scene below the token."""

_PAGE = Path(__file__).with_name("page.html")
_HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
}
_CONTENT_SECURITY_POLICY = (
    "default-src 'none'; style-src 'nonce-{0}'; script-src 'nonce-{0}'; connect-src 'self';"
    " frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)

_log = logging.getLogger(__name__)

Answer = Callable[[Mapping[str, str]], Any]
"""Function that answers a request with JSON values, given its parameters; ValueError for an invalid one."""


class ViewServer:
    """Serves a scene of viser and the page around it.

    Args:
        answers: function for each path below the token that the page asks.
        port: port of this machine; the next free one where it is taken.
        title: title of the page.

    Attributes:
        viser: the server of the scene.
        address: URL of the page, with its token.
    """

    def __init__(self, answers: Mapping[str, Answer], port: int, title: str) -> None:
        self._answers, self._title = answers, title
        self._token = secrets.token_urlsafe(24)
        # It would announce itself, without the token.
        with _checked_requests(self._answer), redirect_stdout(io.StringIO()):
            self.viser = viser.ViserServer(HOST, port, label=title, verbose=False)
        self._port = self.viser.get_port()
        self.address = f"http://{HOST}:{self._port}/{self._token}/"

    def _answer(self, request: Request) -> Response | None:
        """Return the answer to a request; None for what viser answers, whose path is changed."""
        upgrade = request.headers.get("Upgrade", "").lower() == "websocket"
        address = urlsplit(request.path)
        token, _, path = address.path.removeprefix("/").partition("/")
        if not self._is_own(request, needs_origin=upgrade) or not hmac.compare_digest(
            token.encode(), self._token.encode()
        ):
            origin, host = (request.headers.get(key) for key in ("Origin", "Host"))
            _log.warning("page: refused a request of %.80r for %.80r", origin, host)
            return _text(HTTPStatus.FORBIDDEN, "this is not the address of the page")
        if path.rstrip("/") == _SCENE:
            request.path = "/"
            return None
        if upgrade:
            return _text(HTTPStatus.NOT_FOUND, "no scene here")
        if not path:
            return self._page()
        if path not in self._answers:  # also the icon that browsers ask for
            return _text(HTTPStatus.NOT_FOUND, "no such page")
        try:
            content = self._answers[path](dict(parse_qsl(address.query)))
        except ValueError as error:
            return _text(HTTPStatus.BAD_REQUEST, str(error))
        return _response(HTTPStatus.OK, "application/json", json.dumps(content))

    def _is_own(self, request: Request, *, needs_origin: bool) -> bool:
        """Tell whether a request is for this server, and from its page or no page."""
        hosts = {f"{name}:{self._port}" for name in (HOST, "localhost")}
        origin = request.headers.get("Origin")
        known = origin in {f"http://{name}" for name in hosts}
        return request.headers.get("Host", "").lower() in hosts and (
            known or (origin is None and not needs_origin)
        )

    def _page(self) -> Response:
        nonce = secrets.token_urlsafe(12)
        about = json.dumps({"title": self._title, "scene": f"{_SCENE}/"})
        text = _PAGE.read_text(encoding="utf-8").replace("NONCE", nonce)
        text = text.replace("ABOUT", about.replace("<", "\\u003c"))
        found = _response(HTTPStatus.OK, "text/html", text)
        found.headers["Content-Security-Policy"] = _CONTENT_SECURITY_POLICY.format(
            nonce
        )
        return found


@contextmanager
def _checked_requests(answer: Callable[[Request], Response | None]) -> Iterator[None]:
    """Let a server of viser that is started within ask a function first about each request."""
    serve = websockets.asyncio.server.serve

    @functools.wraps(serve)
    def checked(*args: Any, process_request: Any, **rest: Any) -> Any:
        def process(connection: Any, request: Request) -> Response | None:
            found = answer(request)
            return process_request(connection, request) if found is None else found

        return serve(*args, process_request=process, **rest)

    websockets.asyncio.server.serve = checked  # type: ignore[misc,assignment]
    try:
        yield
    finally:
        websockets.asyncio.server.serve = serve  # type: ignore[misc]


def _text(status: HTTPStatus, words: str) -> Response:
    return _response(status, "text/plain", f"{words}\n")


def _response(status: HTTPStatus, kind: str, text: str) -> Response:
    body = text.encode()
    headers = Headers(_HEADERS)
    headers["Content-Type"] = f"{kind}; charset=utf-8"
    headers["Content-Length"] = str(len(body))
    return Response(status.value, status.phrase, headers, body)
