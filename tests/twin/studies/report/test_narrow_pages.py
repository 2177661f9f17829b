"""Reports on a phone: nothing scrolls but tables and pictures, text of pictures is legible, intervals stay whole."""

from pathlib import Path

import pytest

from tests.browser import opened_page
from tests.twin.explorations.sliders import slider_file
from tests.twin.program import invoke
from twin.scenario.shipped import shipped_scenarios

pytestmark = [pytest.mark.nightly, pytest.mark.timeout(900)]

LEAST_TEXT_PX = 9.99

MEASURED = r"""() => {
  const width = document.documentElement.clientWidth, broken = [], words = [];
  const interval = /[-+]?\d[\d.]*(?:\s%)?\s(?:to|±)\s[-+]?\d[\d.]*/g;
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node; node = texts.nextNode();) {
    if (node.parentElement.closest("svg, pre")) continue;
    for (const found of node.data.matchAll(interval)) {
      const range = document.createRange();
      range.setStart(node, found.index);
      range.setEnd(node, found.index + found[0].length);
      words.push(found[0]);
      const lines = new Set([...range.getClientRects()].map(box => Math.round(box.top)));
      if (lines.size > 1) broken.push(found[0]);
    }
  }
  const sizes = [...document.querySelectorAll("figure svg")].map(svg => {
    const scale = svg.getBoundingClientRect().width / svg.viewBox.baseVal.width;
    const texts = [...svg.querySelectorAll("g[transform*=scale]")].filter(own => own.querySelector("use"));
    return Math.min(...texts.map(own => 100 * scale * /scale\(([\d.]+)/.exec(own.getAttribute("transform"))[1]));
  });
  const outside = [...document.querySelectorAll("body *")].filter(own =>
    !own.closest("svg, table") && own.getBoundingClientRect().right > width + 1);
  return { sizes, broken, intervals: words.length, scrolled: document.documentElement.scrollWidth - width,
    outside: outside.map(own => own.outerHTML.slice(0, 80)) };
}"""
"""Sizes of text in pictures [px], intervals, and what is wider than the page; glyphs are drawn 100 units high."""


def study(folder: Path, name: str, *options: str) -> Path:
    out = folder / "out"
    given = (*options, "--workers", "0", "--out", out, "-q")
    invoke("study", shipped_scenarios()[name], *given, code=0)
    return out / "report.html"


def exploration(folder: Path) -> Path:
    out = folder / "out"
    given = ("--designs", 5, "--workers", 1, "--seed", 3, "--out", out)
    invoke("explore", slider_file(folder / "cell"), *given, code=0)
    return out / "report.html"


@pytest.mark.parametrize("width", [390, 1200])
@pytest.mark.parametrize("kind", ["cell", "line", "explored"])
def test_a_report_is_read(
    kind: str, width: int, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.getbasetemp() / f"report-{kind}"
    page = folder / "out" / "report.html"
    if not page.exists():
        folder.mkdir()
        if kind == "cell":
            vary = ("--vary", "skills.pick.scale=1,2", "--deadline", "90")
            assert study(folder, "rearrangement", "-n", "40", *vary) == page
        elif kind == "line":
            assert study(folder, "kitting", "-n", "10") == page
        else:
            assert exploration(folder) == page
    size = {"width": width, "height": 844}
    with opened_page(page.as_uri(), viewport=size) as opened:
        found = opened.evaluate(MEASURED)
    assert len(found["sizes"]) >= 3
    assert min(found["sizes"]) >= LEAST_TEXT_PX
    assert found["intervals"] > 0
    assert found["broken"] == []
    assert found["scrolled"] == 0
    assert found["outside"] == []
