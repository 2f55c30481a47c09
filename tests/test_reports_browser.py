"""The HTML report in a browser: nothing fetched, nothing complained about, nothing cut off."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from headless import Browser, find_browser
from trials import pairs

from dbo_cli.reports.accumulators import FigureData
from dbo_cli.reports.figures import plots_of_log
from dbo_cli.reports.renderers import to_html
from dbo_cli.reports.report import Report, ReportOptions, evaluate

PROGRAM = find_browser()
pytestmark = pytest.mark.skipif(
    PROGRAM is None, reason="no Chromium or Chrome is installed"
)

# the right edge of everything shown, and the leftmost and rightmost place of anything
# that sticks out
OVERFLOW = """
(() => { const width = document.documentElement.clientWidth;
  const out = [...document.querySelectorAll('body *')].filter(element => {
    const box = element.getBoundingClientRect();
    return box.width && getComputedStyle(element).clipPath === 'none' && !element.closest('thead')
      && (box.right > width + 0.5 || box.left < -0.5); });
  return [document.documentElement.scrollWidth, width, out.map(element => element.outerHTML.slice(0, 120))];
})()
"""
CLIPPED_TEXT = """
[...document.querySelectorAll('figure svg')].flatMap(svg => { const frame = svg.getBoundingClientRect();
  return [...svg.querySelectorAll('text')].filter(text => { const box = text.getBoundingClientRect();
    return box.left < frame.left - 1 || box.right > frame.right + 1 || box.top < frame.top - 1
      || box.bottom > frame.bottom + 1; }).map(text => text.textContent); })
"""
COLORS = "[getComputedStyle(document.body).backgroundColor, getComputedStyle(document.body).color]"


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Path:
    """Write a report of two logs, one short, one long with a long name, with every kind of figure."""
    options = ReportOptions(remove_offset=True, segment="cycles")
    logs, plots = [], []
    for name, samples in (
        ("short.csv", 800),
        ("recordings/2024-05-02/" + "long_name_" * 12 + ".csv", 40_000),
    ):
        time = np.arange(samples) / 100.0
        desired = 20.0 * np.sin(2.0 * np.pi * time / 20.0)
        figure_data = FigureData("V")
        block = pairs(
            range(1, samples + 1),
            desired,
            0.9 * desired - 12345.678,
            time,
            desired / 20.0,
        )
        logs.append(evaluate(name, [block], options, figure_data=figure_data))
        plots.append(figure_data)
    report = Report.of(logs, options, "um")
    drawn = [
        plots_of_log(report, log, data)
        for log, data in zip(report.logs, plots, strict=True)
    ]
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(to_html(report, drawn, program="dbo"), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def browser():
    assert PROGRAM is not None
    with Browser(PROGRAM) as running:
        yield running


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 1101, 820, 400])
def test_page(browser, page, width, scheme):
    browser.open(page, width, scheme)
    scroll_width, client_width, sticking_out = browser.evaluate(OVERFLOW)
    assert (client_width, scroll_width, sticking_out) == (width, width, [])
    assert browser.evaluate(CLIPPED_TEXT) == []
    background, ink = browser.evaluate(COLORS)
    assert (background, ink) == {
        "light": ("rgb(255, 255, 255)", "rgb(27, 29, 34)"),
        "dark": ("rgb(20, 22, 26)", "rgb(232, 234, 238)"),
    }[scheme]
    fetched = [
        event["params"]["request"]["url"]
        for event in browser.events
        if event.get("method") == "Network.requestWillBeSent"
    ]
    assert [url for url in fetched if not url.startswith(("file:", "data:"))] == []
    complaints = {
        "Log.entryAdded",
        "Runtime.consoleAPICalled",
        "Runtime.exceptionThrown",
    }
    assert [
        event for event in browser.events if event.get("method") in complaints
    ] == []


CHIEF = """
(() => { const sentence = document.querySelector('.headline'), box = sentence.getBoundingClientRect();
  const ratio = document.querySelector('tbody tr:nth-child(2) td:last-child').getBoundingClientRect();
  return [sentence.textContent, box.left >= 0 && box.right <= innerWidth && box.bottom <= innerHeight,
    ratio.width > 0 && ratio.right <= innerWidth]; })()
"""


@pytest.mark.parametrize("width", [1280, 400])
def test_the_sentence_stands_first_and_the_ratio_is_in_sight(browser, page, width):
    browser.open(page, width, "light")
    sentence, inside, ratio_inside = browser.evaluate(CHIEF)
    long_name = "recordings/2024-05-02/" + "long_name_" * 12 + ".csv"
    assert sentence == f"{long_name}: 1.4 µm RMSE, 2.6 times more than short.csv."
    assert inside and ratio_inside


def test_the_glossary_is_one_click_away(browser, page):
    browser.open(page, 1280, "light")
    shown = "document.querySelector('details').getBoundingClientRect().height"
    closed = browser.evaluate(shown)
    browser.evaluate("document.querySelector('summary').click()")
    assert closed < 60 < 300 < browser.evaluate(shown)


def test_print_is_light_and_opens_the_glossary(browser, page):
    browser.open(page, 1280, "dark")
    browser.call(
        "Emulation.setEmulatedMedia",
        media="print",
        features=[{"name": "prefers-color-scheme", "value": "dark"}],
    )
    assert browser.evaluate(COLORS) == ["rgb(255, 255, 255)", "rgb(27, 29, 34)"]
    assert (
        browser.evaluate(
            "document.querySelector('details').getBoundingClientRect().height"
        )
        > 200
    )
    browser.call("Emulation.setEmulatedMedia", media="")
