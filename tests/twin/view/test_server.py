"""The server of the page answers its own page alone."""

import http.client
import json
from collections.abc import Iterator
from contextlib import closing
from urllib.parse import urlsplit

import pytest

from twin.view.server import ViewServer


@pytest.fixture(scope="module")
def server() -> Iterator[ViewServer]:
    own = ViewServer({"double": lambda given: 2 * float(given["x"])}, 8350, "<cell>")
    yield own
    own.viser.stop()


def asked(
    server: ViewServer, path: str, **headers: str
) -> tuple[int, str, http.client.HTTPMessage]:
    address = urlsplit(server.address)
    connection = http.client.HTTPConnection(address.hostname or "", address.port)
    with closing(connection):
        connection.request("GET", path, headers=headers)
        with connection.getresponse() as answer:
            text = "" if answer.status == 101 else answer.read().decode()
            return answer.status, text, answer.headers


def test_the_page_its_answers_and_its_scene(server: ViewServer) -> None:
    path = urlsplit(server.address).path
    status, text, headers = asked(server, path)
    assert status == 200
    assert "\\u003ccell>" in text
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    assert headers["Referrer-Policy"] == "no-referrer"
    status, text, _ = asked(server, f"{path}double?x=4")
    assert (status, json.loads(text)) == (200, 8.0)
    assert asked(server, f"{path}double?x=no")[0] == 400
    assert asked(server, f"{path}none")[0] == 404
    status, text, _ = asked(server, f"{path}scene/")
    assert status == 200
    assert '<div id="root">' in text


@pytest.mark.parametrize(
    "path", ["/", "/wrong/", "/wrong/double?x=4", "/index.html", "/%2e%2e/x"]
)
def test_nothing_without_the_token(server: ViewServer, path: str) -> None:
    assert asked(server, path)[0] == 403


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "example.org"},
        {"Origin": "http://example.org"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
    ],
    ids=str,
)
def test_no_other_site(server: ViewServer, headers: dict[str, str]) -> None:
    path = urlsplit(server.address).path
    assert asked(server, f"{path}double?x=4", **headers)[0] == 403
    own = {"Origin": server.address.removesuffix(path)}
    assert asked(server, f"{path}double?x=4", **own)[0] == 200


def upgrade(server: ViewServer, path: str, origin: str | None) -> int:
    headers = {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
        "Sec-WebSocket-Version": "13",
        **({} if origin is None else {"Origin": origin}),
    }
    return asked(server, path, **headers)[0]


def test_the_scene_is_for_the_page_alone(server: ViewServer) -> None:
    path = urlsplit(server.address).path
    own = server.address.removesuffix(path)
    assert upgrade(server, f"{path}scene", own) == 101
    assert upgrade(server, f"{path}scene", "http://example.org") == 403
    assert upgrade(server, f"{path}scene", None) == 403
    assert upgrade(server, "/scene", own) == 403
    assert upgrade(server, path, own) == 404


def test_it_listens_on_this_machine_alone(server: ViewServer) -> None:
    assert server.address.startswith("http://127.0.0.1:")
    assert server.viser.get_host() == "127.0.0.1"
