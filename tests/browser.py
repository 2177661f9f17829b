"""A browser for tests of pages: Chromium of the system, driven by playwright; skipped where either is missing."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

playwright = pytest.importorskip("playwright.sync_api")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
if CHROMIUM is None:
    pytest.skip("there is no Chromium", allow_module_level=True)

RENDERS_IN_SOFTWARE = (
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
)
WAIT_MS = 120_000
playwright.expect.set_options(timeout=WAIT_MS)


@contextmanager
def opened_page(address: str, **options: Any) -> Iterator[Any]:
    """Yield the page of an address, on which no script may fail."""
    with playwright.sync_playwright() as own:
        browser = own.chromium.launch(
            executable_path=CHROMIUM, args=list(RENDERS_IN_SOFTWARE)
        )
        page = browser.new_page(**options)
        page.set_default_timeout(WAIT_MS)
        wrong: list[str] = []
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.goto(address)
        yield page
        assert wrong == []
        browser.close()
