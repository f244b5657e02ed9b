"""Figures are thinned without losing a peak, and hold nothing empty."""

from __future__ import annotations

import base64
import dataclasses
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from mavins.estimates import Result
from mavins.evaluation.findings import Finding, findings
from mavins.report import sections_of
from mavins.report.drawing import BLUE, POINTS, Figure, Panel, Series, band, dots, level, line, thin
from mavins.report.plotly_figures import plotly_figure


def test_peaks_stay() -> None:
    n = 500_000
    x = np.arange(n, dtype=np.float64)
    y = np.sin(x * 1e-4)
    y[123_456], y[400_001] = 50.0, -70.0
    y[7] = np.nan
    few_x, few_y = thin(x, y)
    assert len(few_x) <= POINTS
    assert (np.nanmax(few_y), np.nanmin(few_y)) == (50.0, -70.0)
    assert (few_x[0], few_x[-1]) == (0.0, n - 1.0)
    assert (np.diff(few_x) > 0).all()
    assert thin(x[:100], y[:100])[0] is not None
    assert len(thin(x[:100], y[:100])[0]) == 100


def test_a_band_is_never_narrower_than_it_is() -> None:
    x = np.arange(100_000.0)
    high = 1.0 + (x == 5000)
    found = band("3 sigma", x, -high, high)
    assert len(found.x) <= POINTS // 2
    assert found.upper is not None
    assert (found.y.min(), found.upper.max()) == (-2.0, 2.0)


def test_what_is_empty_is_not_drawn() -> None:
    x = np.arange(3.0)
    empty = Panel("a", (line("a", x, np.full(3, np.nan), BLUE), level("setting", x, 1.0)))
    full = Panel("b", (dots("b", x, x, BLUE), line("none", x[:0], x[:0], BLUE)))
    found = Figure("k", "t", (empty, full)).filled()
    assert found is not None
    assert [p.label for p in found.panels] == ["b"]
    assert [s.name for s in found.panels[0].series] == ["b"]
    assert Figure("k", "t", (empty,)).filled() is None
    negative = Panel("c", (line("c", x, -x, BLUE),), log=True)
    assert Figure("k", "t", (negative,)).filled() is None


def test_as_plotly_takes_it() -> None:
    x = np.array([1.0, 2.0, np.nan])
    series = (
        Series("b", x, -x, BLUE, "band", x),
        Series("a", x, x, BLUE),
        Series("a", x, x, BLUE, "crosses"),
    )
    figure = Figure("k", "t", (Panel("up, m", series), Panel("down, m", series, log=True)))
    found = plotly_figure(figure, (0.0, 9.0))
    assert [t["name"] for t in found["data"]] == ["b", "b", "a", "a"] * 2
    assert [t["showlegend"] for t in found["data"]] == [False, True, True, False] + [False] * 4
    assert {t["yaxis"] for t in found["data"]} == {"y", "y2"}
    packed = found["data"][2]["x"]
    assert packed["dtype"] == "f8"
    assert np.array_equal(
        np.frombuffer(base64.b64decode(packed["bdata"]), "<f8"), x, equal_nan=True
    )
    layout = found["layout"]
    assert layout["xaxis"]["range"] == [0.0, 9.0]
    assert layout["yaxis2"]["type"] == "log"
    assert layout["yaxis"]["title"]["text"] == "up, m"
    assert layout["yaxis2"]["domain"][1] < layout["yaxis"]["domain"][0]
    assert (found["time"], found["key"]) == (True, "k")


def keys(result: Result) -> list[str]:
    return [figure.key for _, figures in sections_of(result) for figure in figures]


def test_the_figures_of_a_flight(clean: Result) -> None:
    assert keys(clean) == [
        "track",
        "motion",
        "attitude",
        "error_position",
        "error_velocity",
        "error_attitude",
        "gyro_bias",
        "accel_bias",
        "gnss_position",
        "gnss_velocity",
        "heading",
        "nis",
        "whiteness",
        "gnss_quality",
        "spectrum",
        "vibration",
        "rates",
        "intervals",
    ]
    for _, figures in sections_of(clean):
        for figure in figures:
            assert figure.title
            assert re.search(r", |lag", figure.x_label)
            for panel in figure.panels:
                assert panel.label
                assert panel.series


def test_without_evidence_the_estimate_is_shown(clean: Result) -> None:
    bare = dataclasses.replace(clean, evidence=None, errors=None)
    found = keys(bare)
    assert "error_position" in found
    assert "spectrum" not in found


def test_refused_measurements_are_marked_with_their_reason(clean: Result) -> None:
    m = clean.innovations["heading"]
    accepted = np.arange(len(m)) % 10 > 0
    spoilt = dataclasses.replace(m, accepted=accepted, reason=np.where(accepted, "", "gate"))
    result = dataclasses.replace(clean, innovations={"heading": spoilt})
    (figure,) = (f for _, group in sections_of(result) for f in group if f.key == "heading")
    for panel in figure.panels:
        (crosses,) = (s for s in panel.series if s.style == "crosses")
        assert crosses.name == "refused: gate"
        assert len(crosses.x) == (~accepted).sum()


class Page(HTMLParser):
    """What a page would fetch, and where its anchors are."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.fetched += [str(given[key]) for key in ("src", "data", "srcset") if key in given]
        if tag == "link":
            self.fetched.append(str(given.get("href")))
        self.ids += [str(given["id"])] if "id" in given else []
        self.links += [str(given["href"])] if tag == "a" else []


def test_the_page_holds_all_and_fetches_nothing(clean: Result) -> None:
    pytest.importorskip("plotly")
    from mavins.report.page import page_of

    told = [*findings(clean), Finding("wrong", "5 < 6 & <b>", "do <i>", "track")]
    text = page_of("</script><b>x", clean, told, sections_of(clean))
    page = Page(text)
    assert page.fetched == []
    assert set(page.links) <= {f"#{name}" for name in page.ids}
    assert {f"plot-{key}" for key in keys(clean)} <= set(page.ids)
    assert "5 &lt; 6 &amp; &lt;b&gt;" in text
    assert "<b>x" not in text
    assert "Error against simulator" in text
    held = re.search(r'id="figures">(.*?)</script>', text, re.DOTALL)
    assert held is not None
    assert [f["key"] for f in json.loads(held[1])] == keys(clean)
    assert len(text) < 15e6


@pytest.mark.slow
def test_pngs(clean: Result, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    from mavins.report.pngs import write_png

    for _, figures in sections_of(clean):
        for figure in figures[:2]:
            path = tmp_path / f"{figure.key}.png"
            write_png(path, figure)
            assert path.read_bytes().startswith(b"\x89PNG")
            assert path.stat().st_size > 5_000
