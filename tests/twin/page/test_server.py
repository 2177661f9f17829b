"""What the page's server answers, and whom it does not answer."""

import contextlib
import http.client
import importlib
import json
import re
import socket
import sys
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import hypothesis
import hypothesis.strategies as st
import pytest

import twin
from planning.errors import OutputError, RequestError
from scheduling.graph.plan_files import load_plan
from scheduling.verification.verify import verify_plan
from tests.twin.operations.operated import STACK
from tests.twin.program import python
from twin.follow.log_lines import lines_of_server
from twin.page.panel import Order, Panel, Shown, ShownRobot
from twin.page.server import PageServer

pytestmark = pytest.mark.timeout(300)

LEFT = ShownRobot(
    "left", "standing", "place <b>", "waits for right", 3, 9, False, False
)
SHOWN = Shown(12.5, (LEFT,), 1, 4, {}, (), "will you help?", 2)


ELSEWHERE = "http://127.0.0.1:1/token/"
REFUSALS: list[str] = []


def scene() -> str:
    """Return the address of a 3-D scene that nobody serves."""
    if REFUSALS:
        raise RequestError(REFUSALS.pop())
    return ELSEWHERE


@pytest.fixture(scope="module")
def server() -> Iterator[PageServer]:
    panel = Panel(steps=4)
    panel.show(SHOWN)
    own = PageServer(panel, None, title="</script>cell", scene=scene)
    with own.serving():
        yield own


def asked(
    server: PageServer | int,
    method: str,
    path: str,
    body: str | bytes | None = None,
    **headers: str,
) -> tuple[int, str, http.client.HTTPMessage]:
    """Ask a server, or who is at a port, for something."""
    port = server if isinstance(server, int) else server.port
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=120)
    named = {name.replace("_", "-"): text for name, text in headers.items()}
    connection.request(method, path, body, named)
    answer = connection.getresponse()
    text = answer.read().decode()
    connection.close()
    return answer.status, text, answer.headers


def ordered(server: PageServer, content: Any, **headers: str) -> int:
    given = {"X_Token": server.token, **headers}
    return asked(server, "POST", "/order", json.dumps(content), **given)[0]


def orders(server: PageServer) -> list[Order]:
    found = []
    while not server._panel.orders.empty():
        found.append(server._panel.orders.get_nowait())
    return found


def test_the_page_names_no_other_host_and_may_not_be_framed(server: PageServer) -> None:
    status, text, headers = asked(server, "GET", "/")
    assert status == 200
    assert not re.findall(r"(?:https?:)?//[\w.]+\.\w+", text)
    policy = headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "frame-ancestors 'none'" in policy
    # What a scenario is called ends no script.
    assert "</script>cell" not in text
    assert text.count(server.token) == 1


def test_the_state_is_what_was_shown_last(server: PageServer) -> None:
    content = json.loads(asked(server, "GET", "/state")[1])
    assert content["shown"]["robots"][0]["task"] == "place <b>"
    assert content["shown"]["asked"] == 2
    assert content["forecast"] is None


def test_the_scene_is_elsewhere(server: PageServer) -> None:
    status, _, headers = asked(server, "GET", "/scene")
    assert (status, headers["Location"]) == (302, ELSEWHERE)
    REFUSALS.append("install 'assembly-twin[view]'")
    status, text, headers = asked(server, "GET", "/scene")
    assert (status, text) == (404, "install 'assembly-twin[view]'\n")
    assert headers["Content-Type"].startswith("text/plain")


@pytest.mark.parametrize(
    ("content", "order"),
    [
        ({"action": "hold", "robot": "left"}, Order("hold", "left")),
        ({"action": "go on"}, Order("go on")),
        ({"action": "out", "robot": "left"}, Order("out", "left")),
        ({"action": "yes", "question": 2}, Order("yes", "", 2)),
    ],
)
def test_a_button_is_an_order(server: PageServer, content: Any, order: Order) -> None:
    assert ordered(server, content) == 202
    assert orders(server) == [order]


@pytest.mark.parametrize(
    "content",
    [
        {"action": "fly", "robot": "left"},
        {"action": ["hold"]},
        {"action": "hold", "robot": "nobody"},
        {"action": "hold", "robot": ["left"]},
        {"action": "out"},
        {"action": "yes", "question": 1},
        {"action": "no"},
        [],
        None,
        "hold",
    ],
)
def test_what_makes_no_sense_is_no_order(server: PageServer, content: Any) -> None:
    assert ordered(server, content) == 400
    assert orders(server) == []


@pytest.mark.parametrize("body", [b"", b"{", b"\xff", b"[" * 900, b" " * 100_000])
def test_what_is_no_json_is_no_order(server: PageServer, body: bytes) -> None:
    try:
        status = asked(server, "POST", "/order", body, X_Token=server.token)[0]
        assert status == 400
    except OSError:
        pass  # hung up on what is too long
    assert orders(server) == []
    assert asked(server, "GET", "/state")[0] == 200


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "127.0.0.1"},
        {"Host": "evil.example:80"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
    ],
)
@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("GET", "/"),
        ("GET", "/state"),
        ("GET", "/scene"),
        ("GET", "/events.jsonl"),
        ("POST", "/order"),
    ],
)
def test_pages_of_others_get_nothing(
    server: PageServer, headers: dict[str, str], method: str, path: str
) -> None:
    body = json.dumps({"action": "hold"}) if method == "POST" else None
    given = {"X_Token": server.token, **headers}
    status, text, _ = asked(server, method, path, body, **given)
    assert status == 403
    assert server.token not in text
    assert orders(server) == []


def test_an_order_needs_the_token_of_the_page(server: PageServer) -> None:
    own = {"Origin": server.address.rstrip("/")}
    assert ordered(server, {"action": "hold"}, X_Token="", **own) == 403
    assert ordered(server, {"action": "hold"}, X_Token="\u00e9", **own) == 403
    assert ordered(server, {"action": "hold"}, X_Token=server.token[:-1], **own) == 403
    assert asked(server, "GET", "/order", X_Token=server.token)[0] == 405
    assert ordered(server, {"action": "hold"}, **own) == 202


def test_it_listens_on_this_machine_only(server: PageServer) -> None:
    assert server._socket.getsockname()[0] == "127.0.0.1"
    with socket.socket() as other, pytest.raises(OSError, match="in use"):
        other.bind(("127.0.0.1", server.port))


def test_a_port_that_is_taken_is_named(server: PageServer) -> None:
    with pytest.raises(RequestError, match=f"no page at port {server.port}"):
        PageServer(Panel(steps=1), None, server.port)


def test_without_its_package_a_page_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "tornado.web", None)
    monkeypatch.delitem(sys.modules, "twin.page.server")
    with pytest.raises(RequestError, match=r"pip install 'assembly-twin\[page\]'"):
        importlib.import_module("twin.page.server")


def test_nobody_else_needs_that_package() -> None:
    python("import sys, twin; twin.operate; assert 'tornado' not in sys.modules")


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text() | st.integers(-1, 3),
    lambda own: st.lists(own) | st.dictionaries(st.text(), own),
    max_leaves=4,
)
NEARLY = st.fixed_dictionaries(
    {},
    optional={
        "action": st.sampled_from(["hold", "go on", "out", "yes", "no"]) | JSON,
        "robot": st.sampled_from(["left", "right", ""]) | JSON,
        "question": JSON,
    },
)


@hypothesis.given(st.binary(max_size=1000) | (NEARLY | JSON).map(json.dumps))
def test_whatever_comes_is_an_order_or_refused_with_words(given: bytes | str) -> None:
    panel = Panel(steps=4)
    panel.show(SHOWN)
    server = PageServer(panel, None)
    with contextlib.closing(server._socket):
        try:
            server.take(given if isinstance(given, bytes) else given.encode())
        except ValueError as error:
            words = str(error)
        if panel.orders.empty():
            assert words
            return
        order = panel.orders.get_nowait()
        assert order in {
            *(Order(act, name) for act in ("hold", "go on") for name in ("", "left")),
            Order("out", "left"),
            *(Order(act, name, 2) for act in ("yes", "no") for name in ("", "left")),
        }


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("http://127.0.0.1:{}/events.jsonl", "404"),
        ("http://127.0.0.1:{}/nothing", "404"),
        ("http://127.0.0.1:{}", "text/html"),
        ("http://127.0.0.1:1/events.jsonl", "refused"),
        ("http://127.0.0.1:port/events.jsonl", "port"),
        ("http://", "cannot be read"),
    ],
)
def test_a_log_that_nobody_passes_on_is_refused(
    server: PageServer, address: str, words: str
) -> None:
    with pytest.raises(OutputError, match=words):
        list(lines_of_server(address.format(server.port)))


def test_a_page_is_for_robots_that_drivers_move(tmp_path: Path) -> None:
    (tmp_path / "stack.yaml").write_text(STACK)
    with pytest.raises(RequestError, match="a page is for robots that drivers move"):
        twin.operate(tmp_path / "stack.yaml", page=0)


def test_a_cell_is_operated_with_a_page_beside_it(tmp_path: Path) -> None:
    (tmp_path / "stack.yaml").write_text(STACK)
    (tmp_path / "drivers.yaml").write_text("pace: 20\n")
    seen: list[dict[str, Any]] = []
    followed: list[str] = []

    def follow(address: str) -> None:
        log = lines_of_server(f"{address}events.jsonl")
        followed.extend(line for line in log if line is not None)

    def beside(address: str) -> None:
        said = partial(asked, int(address.rstrip("/").rsplit(":", 1)[1]))
        (token,) = re.findall(r'"token": "([^"]+)"', said("GET", "/")[1])
        for action in ("hold", "go on"):
            while True:
                state = json.loads(said("GET", "/state")[1])
                if state["shown"] and state["shown"]["t_s"] > 0:
                    modes = {own["mode"] for own in state["shown"]["robots"]}
                    if action == "hold" or modes == {"held"}:
                        break
                time.sleep(0.02)
            said("POST", "/order", json.dumps({"action": action}), X_Token=token)
        while state["forecast"] is None:
            state = json.loads(said("GET", "/state")[1])
            time.sleep(0.02)
        seen.append(state)

    threads: list[threading.Thread] = []

    def opened(address: str) -> None:
        for own in (beside, follow):
            threads.append(threading.Thread(target=own, args=[address], daemon=True))
            threads[-1].start()

    done = twin.operate(
        tmp_path / "stack.yaml",
        drivers=tmp_path / "drivers.yaml",
        page=0,
        opened=opened,
        out=tmp_path / "run",
        recording=False,
        audit=False,
    )
    for thread in threads:
        thread.join()
    assert followed == (tmp_path / "run" / "events.jsonl").read_text().splitlines()
    assert done.outcome == "completed"
    assert not verify_plan(load_plan(tmp_path / "run")).problems
    kinds = [e.kind for e in done.history]
    assert kinds.count("ordered") == 2
    assert kinds.count("stopped") == kinds.count("resumed") == 2
    (state,) = seen
    # What holds it up afterwards makes it only later.
    planned = twin.operate(
        tmp_path / "stack.yaml", out=tmp_path / "twin", recording=False, audit=False
    )
    first, last = planned.summary["makespan_s"], done.summary["makespan_s"]
    assert 0.95 * first <= state["forecast"]["p50_s"] <= 1.05 * last
