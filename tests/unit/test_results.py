"""The result folder: what is in the files, and that they are whole."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavins.aiding import Measurement
from mavins.errors import OutputError
from mavins.estimator.fusion import Event
from mavins.filters.base import RowBlock
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import CORE, Layout
from mavins.results import (
    ESTIMATES,
    INNOVATIONS,
    ResultWriter,
    check_folder,
    write_json,
    write_text,
)
from mavins.types import Origin

# a flight through the estimator takes minutes where nothing is compiled
pytestmark = pytest.mark.jit

FRAME = TangentFrame.at(Origin(math.radians(47.4), math.radians(8.5), 500.0))


def block(t_us: list[int]) -> RowBlock:
    """Rows of a vehicle 10 m north of the origin, 2 m above it, that heads 30 degrees."""
    rows = RowBlock.empty(max(1, len(t_us)))
    for k, t in enumerate(t_us):
        rows.t_us[k] = t
        rows.x[k] = 0.0
        rows.x[k, 0:3] = (10.0, 0.0, -2.0)
        rows.x[k, 3:6] = (1.0, -2.0, 0.25)
        rows.x[k, 6:10] = (math.cos(math.radians(15)), 0.0, 0.0, math.sin(math.radians(15)))
        rows.P[k] = np.eye(rows.P.shape[1]) * 0.04
    rows.count = len(t_us)
    return rows


def decision(t_us: int, reason: str = "", rows: int = 2, nis: float = 1.5) -> Event:
    measurement = Measurement(
        aiding="gnss_velocity",
        source="GPS_RAW_INT",
        stamp_us=t_us + 100,
        t_us=t_us,
        rank=1,
        z=np.zeros(rows),
        R=np.eye(rows),
        model=None,
        parameters=np.zeros(1),
        gate=5.0,
        quality="",
    )  # type: ignore[arg-type]
    event = Event(measurement, (t_us, 1, "GPS_RAW_INT", 0), reason, nis)
    event.innovation = np.arange(1.0, rows + 1.0)
    event.S = 0.25 * np.eye(rows)
    return event


def read(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def test_estimates(tmp_path: Path) -> None:
    with ResultWriter(tmp_path / "new" / "eskf", Layout.of()) as writer:
        writer.write_rows(block([1_000_000, 1_020_000]), FRAME)
        assert writer.rows == 2
    path = tmp_path / "new" / "eskf" / "estimates.csv"
    assert path.read_text().splitlines()[0] == ESTIMATES
    first, second = read(path)
    assert (first["t_us"], second["t_us"]) == ("1000000", "1020000")
    assert len(first["lat_deg"].partition(".")[2]) == 10
    row = {name: float(value) for name, value in first.items()}
    lat, lon, alt = FRAME.to_lla(np.array([10.0, 0.0, -2.0]))
    assert row["lat_deg"] == pytest.approx(math.degrees(lat), abs=1e-10)
    assert row["lon_deg"] == pytest.approx(math.degrees(lon), abs=1e-10)
    assert row["alt_m"] == pytest.approx(alt, abs=1e-3)
    assert (row["p_n"], row["p_e"], row["p_d"]) == (10.0, 0.0, -2.0)
    assert (row["v_n"], row["v_e"], row["v_d"]) == pytest.approx((1.0, -2.0, 0.25), abs=1e-4)
    assert row["yaw"] == pytest.approx(math.radians(30), abs=1e-5)
    assert row["sd_p_n"] == row["sd_v_d"] == pytest.approx(0.2)


def test_innovations(tmp_path: Path) -> None:
    with ResultWriter(tmp_path, Layout.of()) as writer:
        writer.write_decision(decision(5_000_000))
        writer.write_decision(decision(6_000_000, "gate", 3, 99.5))
        late = decision(7_000_000, "too old", 0, math.nan)
        writer.write_decision(late)
    path = tmp_path / "innovations.csv"
    assert path.read_text().splitlines()[0] == INNOVATIONS
    fused, rejected, late_row = read(path)
    assert fused["aiding"] == "gnss_velocity"
    assert fused["source"] == "GPS_RAW_INT"
    assert (fused["t_us"], fused["stamp_us"]) == ("5000000", "5000100")
    assert (fused["accepted"], fused["reason"], float(fused["nis"])) == ("1", "", 1.5)
    assert [fused[f"innovation_{k}"] for k in range(3)] == ["1", "2", ""]
    assert (rejected["accepted"], rejected["reason"]) == ("0", "gate")
    assert rejected["innovation_2"] == "3"
    assert (late_row["reason"], late_row["nis"], late_row["sigma_0"]) == ("too old", "", "")


def test_a_full_disk_is_said_in_one_line(tmp_path: Path) -> None:
    class Full:
        name = "estimates.csv"

        def write(self, text: str) -> int:
            raise OSError(28, "No space left on device")

    writer = ResultWriter(tmp_path, Layout.of())
    writer._estimates.close()
    writer._estimates.file = Full()  # type: ignore[assignment]
    with pytest.raises(OutputError, match=r"estimates.csv: No space left"):
        writer.write_rows(block([1]), FRAME)


def test_json_has_null_for_what_is_not_finite(tmp_path: Path) -> None:
    content: dict[str, Any] = {
        "a": math.nan,
        "b": [1.0, math.inf, {"c": -math.inf}],
        3: (1, 2),
        "text": "nan",
    }
    write_json(tmp_path / "deep" / "summary.json", content)
    text = (tmp_path / "deep" / "summary.json").read_text()
    assert json.loads(text) == {
        "a": None,
        "b": [1.0, None, {"c": None}],
        "3": [1, 2],
        "text": "nan",
    }
    assert text.endswith("}\n")
    assert list((tmp_path / "deep").iterdir()) == [tmp_path / "deep" / "summary.json"]


def test_places_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    below = tmp_path / "file" / "below"
    for write in (
        lambda: check_folder(below),
        lambda: ResultWriter(below, Layout.of()),
        lambda: write_text(below / "x.json", ""),
    ):
        with pytest.raises(OutputError, match="another"):
            write()
    check_folder(tmp_path / "fresh" / "folder")
    assert list((tmp_path / "fresh" / "folder").iterdir()) == []


def test_further_states_have_columns_of_their_own(tmp_path: Path) -> None:
    layout = Layout.of((*CORE, "l_b", "tau"))
    block = RowBlock.empty(1, layout.size)
    block.count = 1
    block.t_us[0], block.u[:], block.x[:] = 20_000, 0.0, 0.0
    block.x[0, 6] = 1.0
    block.x[0, 16:20] = [0.1, -0.2, 0.3, 0.18]
    block.P[0] = np.diag(np.r_[np.ones(15), 0.01, 0.04, 0.09, 0.0025])
    with ResultWriter(tmp_path, layout) as writer:
        writer.write_rows(block, TangentFrame.at(Origin(0.8, 0.1, 0.0)))
    header, row = csv.reader((tmp_path / "estimates.csv").read_text().splitlines())
    values = dict(zip(header, map(float, row), strict=True))
    assert header[: len(ESTIMATES.split(","))] == ESTIMATES.split(",")
    assert [values[f"l_b_{axis}"] for axis in "xyz"] == [0.1, -0.2, 0.3]
    assert [values[f"sd_l_b_{axis}"] for axis in "xyz"] == [0.1, 0.2, 0.3]
    assert (values["tau"], values["sd_tau"]) == (0.18, 0.05)


def test_biases_and_gravity_have_columns_of_their_own(tmp_path: Path) -> None:
    layout = Layout.of((*CORE, "b_baro", "b_m", "g_n"))
    block = RowBlock.empty(1, layout.size)
    block.count = 1
    block.t_us[0], block.u[:], block.x[:] = 20_000, 0.0, 0.0
    block.x[0, 6] = 1.0
    block.x[0, 20:26] = [1.5, 0.1, -0.2, 0.3, 0.01, -0.02]
    block.P[0] = np.diag(np.r_[np.ones(15), 0.25, 0.01, 0.04, 0.09, 1e-4, 4e-4])
    with ResultWriter(tmp_path, layout) as writer:
        writer.write_rows(block, TangentFrame.at(Origin(0.8, 0.1, 0.0)))
    header, row = csv.reader((tmp_path / "estimates.csv").read_text().splitlines())
    values = dict(zip(header, map(float, row), strict=True))
    assert (values["b_baro"], values["sd_b_baro"]) == (1.5, 0.5)
    assert [values[f"b_m_{axis}"] for axis in "xyz"] == [0.1, -0.2, 0.3]
    assert [values[f"sd_b_m_{axis}"] for axis in "xyz"] == [0.1, 0.2, 0.3]
    assert [values[f"g_{axis}"] for axis in "ne"] == [0.01, -0.02]
    assert [values[f"sd_g_{axis}"] for axis in "ne"] == [0.01, 0.02]
