"""A result folder is read back as it was written."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mavins.config import Config, to_yaml
from mavins.errors import LogFormatError
from mavins.estimates import Result
from mavins.estimator.fusion import Event
from mavins.evaluation.evidence import FILE, write_evidence
from mavins.evaluation.result_folder import read_innovations, read_result
from mavins.filters.base import RowBlock
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import CORE, Layout
from mavins.results import INNOVATIONS, ResultWriter, write_json, write_text
from mavins.types import Origin

LAYOUT = Layout.of((*CORE, "tau"))
FRAME = TangentFrame.at(Origin(0.8, 0.1, 500.0))


class Measured:
    """As much of a measurement as the writer looks at."""

    def __init__(self, t_us: int, aiding: str) -> None:
        self.t_us, self.stamp_us, self.aiding, self.source = t_us, t_us + 100_000, aiding, "GPS"


def event(t_us: int, aiding: str, rows: int, reason: str = "", nis: float = 1.5) -> Event:
    found = Event(Measured(t_us, aiding), (t_us, 0, "", 0), reason, nis)  # type: ignore[arg-type]
    found.innovation, found.S = np.arange(1.0, rows + 1.0), 0.25 * np.eye(rows)
    return found


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    block = RowBlock.empty(50, LAYOUT.size)
    block.count = 50
    block.t_us[:] = 1_000_000 + 20_000 * np.arange(50)
    block.x[:], block.u[:], block.P[:] = 0.0, 0.0, 0.04 * np.eye(LAYOUT.size)
    block.x[:, 6], block.x[:, 19], block.x[:, 10] = 1.0, 0.18, 0.003
    with ResultWriter(tmp_path / "eskf", LAYOUT) as writer:
        writer.write_rows(block, FRAME)
        writer.write_decision(event(1_200_000, "gnss_velocity", 2))
        writer.write_decision(event(1_300_000, "heading", 1, "gate", 40.0))
        writer.write_decision(event(1_400_000, "gnss_velocity", 2, "gate", 99.0))
        writer.write_decision(event(1_500_000, "gnss_velocity", 0, "too old", math.nan))
    write_text(tmp_path / "eskf" / "config.yaml", to_yaml(Config()))
    write_json(tmp_path / "summary.json", {"filter": "eskf", "log": "flight.tlog"})
    return tmp_path


def test_all_of_it(folder: Path) -> None:
    result = read_result(folder)
    assert isinstance(result, Result)
    assert (result.filter, result.summary["log"], result.config) == (
        "eskf",
        "flight.tlog",
        Config(),
    )
    assert (len(result), result.seconds[0]) == (50, 1.0)
    assert result.lla[0] == pytest.approx([0.8, 0.1, 500.0])
    assert [part[-1, 0] for part in result.state("tau")] == [0.18, 0.2]
    assert result.b_g[-1, 0] == 0.003
    assert np.isnan(result.sd_b_a).all()  # nothing was witnessed
    assert result.sd_p_n[0] == pytest.approx([0.2, 0.2, 0.2])
    assert not result.has("l_b")
    assert result.smoothed is None
    assert list(result.innovations) == ["gnss_velocity", "heading"]
    m = result.innovations["gnss_velocity"]
    assert m.t_us.tolist() == [1_200_000, 1_400_000, 1_500_000]
    assert (m.stamp_us - m.t_us).tolist() == [100_000] * 3
    assert m.accepted.tolist() == [True, False, False]
    assert m.reason.tolist() == ["", "gate", "too old"]
    assert m.innovation.shape == (3, 2)
    assert np.isnan(m.innovation[2]).all()
    assert m.nis[:2].tolist() == [1.5, 99.0]
    assert result.evidence is result.errors is result.judge is None
    assert not result.is_true


@pytest.mark.jit
def test_errors_against_what_was_kept(folder: Path, clean: Result) -> None:
    assert clean.evidence is not None
    truth = clean.evidence.truth
    assert truth is not None
    moved = type(truth)(truth.t_us - 9_500_000, truth.lla, truth.v_l, truth.q_lb, "simulator")
    write_evidence(
        folder / "eskf" / FILE,
        replace(clean.evidence, truth=moved, reference=None),
        np.full((50, 6), 0.25),
    )
    result = read_result(folder)
    assert result.is_true
    assert np.array_equal(result.sd_b_g, np.full((50, 3), 0.25))
    assert result.errors is not None
    assert result.errors.pos.shape == (len(result.errors.t_us), 3)
    assert 20 <= len(result.errors.t_us) <= 50


def test_what_is_no_result_folder(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(LogFormatError, match=r"no summary\.json"):
        read_result(tmp_path / "nowhere")
    with pytest.raises(LogFormatError, match=r"no iekf/estimates\.csv"):
        read_result(folder, "iekf")
    for text in ("[]", "{"):
        (folder / "summary.json").write_text(text)
        with pytest.raises(LogFormatError, match=r"summary\.json"):
            read_result(folder)


def test_damaged_innovations(tmp_path: Path) -> None:
    path = tmp_path / "innovations.csv"
    for text in (
        "t_us,nis\n1,2\n",
        f"{INNOVATIONS}\n1,2,heading\n",
        f"{INNOVATIONS}\nx{',1' * 12}\n",
    ):
        path.write_text(text)
        with pytest.raises(LogFormatError, match="damaged"):
            read_innovations(path)
    path.write_text(f"{INNOVATIONS}\n")
    assert read_innovations(path) == {}
    with pytest.raises(LogFormatError, match="cannot read"):
        read_innovations(tmp_path / "none.csv")
