"""What a replay hands on at once and what is read from its folder are the same, to the digits of the files."""

from __future__ import annotations

import json
import re
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mavins
from mavins.estimates import Estimates, Result
from mavins.evaluation.findings import findings
from mavins.exports import REGISTRY, is_installed, write_exports
from mavins.replay import ReplayOptions, replay
from mavins.report import sections_of
from mavins.results import as_shown
from mavins.status import finite
from sitl.command import main as fly

# a flight through the estimator takes minutes where nothing is compiled
pytestmark = [pytest.mark.jit, pytest.mark.slow]

NUMBER = re.compile(rb"-?\d+(?:\.\d+)?")
TEXTS = ("tum", "kml", "gpx")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("result")


@pytest.fixture(scope="module")
def made(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Result:
    """What a replay hands on; the files are in `folder`."""
    log = tmp_path_factory.mktemp("log") / "flight.tlog"
    fly(["--record", str(log), "--duration", "20", "--speed", "max"])
    kept: list[Result] = []
    options = ReplayOptions(smooth=True, exports=TEXTS)
    replay(log, folder, mavins.Config(), options, finish=lambda result, _: kept.append(result))
    return kept[0]


@pytest.fixture(scope="module")
def found(made: Result, folder: Path) -> Result:
    return mavins.read_result(folder)


def same_arrays(one: Any, other: Any, **tolerance: float) -> None:
    for field in fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, np.ndarray) and a.dtype.kind == "f":
            np.testing.assert_allclose(a, b, **tolerance)
        elif isinstance(a, np.ndarray):
            np.testing.assert_array_equal(a, b)


def test_estimates(made: Result, found: Result) -> None:
    assert made.smoothed is not None
    assert found.smoothed is not None
    pairs: list[tuple[Estimates, Estimates]] = [(made, found), (made.smoothed, found.smoothed)]
    for one, other in pairs:
        assert one.layout.blocks == other.layout.blocks
        assert one.t_us.tolist() == other.t_us.tolist()
        (shown, decimals), (again, _) = as_shown(one.table), as_shown(other.table)
        assert (abs(shown - again) <= 0.501 * 10.0**-decimals).all()
    np.testing.assert_allclose(made.sd_b_g, found.sd_b_g, rtol=1e-6)
    np.testing.assert_allclose(made.sd_b_a, found.sd_b_a, rtol=1e-6)


def test_innovations(made: Result, found: Result) -> None:
    assert list(made.innovations) == list(found.innovations)
    assert len(made.innovations) >= 3
    for name, one in made.innovations.items():
        assert one.rows == found.innovations[name].rows
        same_arrays(one, found.innovations[name], rtol=1e-8)


def test_evidence_errors_and_words(made: Result, found: Result) -> None:
    for part in ("gnss", "imu", "spectrum", "truth"):
        same_arrays(getattr(made.evidence, part), getattr(found.evidence, part), rtol=0.0)
    assert made.is_true
    assert found.is_true
    same_arrays(made.errors, found.errors, rtol=0.0, atol=6e-5)
    assert json.loads(json.dumps(finite(made.summary))) == found.summary
    assert (made.config, made.filter) == (found.config, found.filter)


def test_findings_and_figures(made: Result, found: Result) -> None:
    assert findings(made) == findings(found)
    for (title, figures), (other, again) in zip(sections_of(made), sections_of(found), strict=True):
        assert title == other
        assert [figure.key for figure in figures] == [figure.key for figure in again]


def test_exports(made: Result, found: Result, folder: Path, tmp_path: Path) -> None:
    names = (*TEXTS, "parquet") if is_installed("parquet") else TEXTS
    at_once = folder / made.filter
    write_exports(made, names[len(TEXTS) :], at_once)
    write_exports(found, names, tmp_path)
    for file in (file for name in TEXTS for file in REGISTRY[name].FILES):
        one, other = (at_once / file).read_bytes(), (tmp_path / file).read_bytes()
        assert NUMBER.sub(b"", one) == NUMBER.sub(b"", other)
        for a, b in zip(NUMBER.findall(one), NUMBER.findall(other), strict=True):
            digits = len(a.partition(b".")[2])
            assert abs(float(a) - float(b)) <= 1.01 * 10.0**-digits
    if "parquet" in names:
        import pyarrow.parquet as pq

        # to the digits of estimates.csv, however it came about
        tables = [pq.read_table(path / "estimates.parquet") for path in (at_once, tmp_path)]
        assert tables[0].equals(tables[1])
        with (at_once / "estimates.csv").open() as file:
            header, first = file.readline().strip().split(","), file.readline().split(",")
        assert tables[0].column_names == header
        assert list(tables[0].slice(0, 1).to_pylist()[0].values()) == list(map(float, first))
