"""The page in a browser, on a phone's width and a desk's: somebody holds a robot, lets it go and answers."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.browser import CHROMIUM, playwright
from tests.twin.operations.operated import stack
from tests.twin.page.beside import ASKS, Beside, failing_first_pick, robot
from twin.page.server import PageServer

pytestmark = pytest.mark.timeout(300)

ALONE = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
PACE, NARROW, WIDE, FINGER = 20.0, 390, 1200, 44


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as own:
        browser = own.chromium.launch(executable_path=CHROMIUM, args=list(ALONE))
        yield browser
        browser.close()


def opened(
    browser: Any, address: str, width: int, scheme: str
) -> tuple[Any, list[str]]:
    """Return the page at a width, and what goes wrong on it."""
    page = browser.new_page(
        viewport={"width": width, "height": 800}, color_scheme=scheme
    )
    wrong: list[str] = []
    page.on("console", lambda said: wrong.append(said.text))
    page.on("pageerror", lambda error: wrong.append(str(error)))
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(address)
    playwright.expect(page.get_by_role("heading", name="right")).to_be_visible()
    assert all(url.startswith((address, "data:")) for url in asked)
    return page, wrong


def require_room(page: Any, width: int) -> None:
    """Nothing is beyond the edge, and every button is as large as a finger."""
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    for button in page.get_by_role("button").all():
        box = button.bounding_box()
        assert min(box["width"], box["height"]) >= FINGER
        assert 0 <= box["x"] <= box["x"] + box["width"] <= width


@pytest.mark.nightly
def test_a_robot_is_held_and_a_question_answered_at_both_widths(
    browser: Any, tmp_path: Path
) -> None:
    expect = playwright.expect
    arms = {"left": failing_first_pick(PACE)}
    run = Beside(stack(tmp_path), PACE, arms, ASKS)
    server = PageServer(run.panel, None, title="stack")
    with server.serving():
        run.begin()
        phone, wrong = opened(browser, server.address, NARROW, "dark")
        require_room(phone, NARROW)
        # Without a mouse; the focus stays where it is.
        hold = phone.get_by_role("button", name="Hold right", exact=True)
        hold.focus()
        phone.keyboard.press("Enter")
        right = phone.get_by_role("article", name="right")
        expect(right).to_contain_text("held")
        expect(hold).to_be_focused()
        expect(hold).to_be_disabled()
        held = robot(
            run.until(lambda s: robot(s, "right").mode == "held"), "right"
        ).done
        desk, also_wrong = opened(browser, server.address, WIDE, "light")
        expect(desk.get_by_text("will you see to step")).to_have_count(2)
        require_room(desk, WIDE)
        require_room(phone, NARROW)
        assert run.panel.shown is not None
        assert robot(run.panel.shown, "right").done == held
        desk.get_by_role("button", name="Robot out: right").click()
        desk.get_by_role("button", name="Leave it in").press("Enter")
        phone.get_by_role("button", name="Go on: right").click()
        expect(right).not_to_contain_text("held")
        desk.get_by_role("button", name="Yes").click()
        expect(phone.get_by_role("button", name="Yes")).to_be_hidden()
        expect(desk.get_by_role("status")).to_have_text(
            re.compile("over: completed"), timeout=200_000
        )
        expect(desk.get_by_text("4 of 4")).to_be_visible()
        done = run.done()
    assert done.record.outcome == "completed"
    assert done.out == frozenset()
    orders = [
        (e.robot, e.detail.partition(":")[0]) for e in run.events if e.kind == "ordered"
    ]
    assert orders == [("right", "hold"), ("right", "go on"), ("", "yes")]
    assert wrong == also_wrong == []
    phone.close()
    desk.close()


def test_a_page_that_is_not_answered_any_more_says_so(
    browser: Any, tmp_path: Path
) -> None:
    run = Beside(stack(tmp_path), PACE)
    server = PageServer(run.panel, None)
    with server.serving():
        run.begin()
        page, _ = opened(browser, server.address, WIDE, "light")
    playwright.expect(page.get_by_text("no longer answers")).to_be_visible()
    page.get_by_role("button", name="Hold all").click()
    playwright.expect(page.get_by_text("has not arrived")).to_be_visible()
    page.close()
    run.done()
