"""Which of a telemetry log's messages are used, where someone chooses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mavins.config import load
from mavins.errors import LogFormatError
from mavins.logs.sensor_log import Choice
from mavins.logs.tlog import TlogWriter, read_tlog
from mavins.mavlink.codec import IMU_KINDS, frame, highres_imu
from mavins.tlog_source import TlogSource, without_others
from mavins.types import ImuSample

T0 = 1_750_000_000_000_000


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "flight.tlog"
    with TlogWriter(path) as writer:
        for k in range(20):
            sample = ImuSample(1_000_000 + 4000 * k, np.array([0.0, 0.0, -9.8]), np.zeros(3))
            writer.write(T0 + 4000 * k, frame(highres_imu(sample), 8, 1, k))
    return path


def test_the_imu_message(log: Path) -> None:
    TlogSource(log, load(), choice=Choice(imu="highres_imu"))
    frames = read_tlog(log)
    assert without_others(frames, 8, "HIGHRES_IMU").msgid.tolist() == [105] * 20
    assert len(without_others(frames, 8, "RAW_IMU")) == 0
    assert len(without_others(frames, 9, "RAW_IMU")) == 20
    with pytest.raises(LogFormatError, match="no IMU message called 'RAW_IMU'; it has HIGHRES_IMU"):
        TlogSource(log, load(), choice=Choice(imu="raw_imu"))
    assert IMU_KINDS[105] == "HIGHRES_IMU"


def test_the_gnss_message(log: Path) -> None:
    assert TlogSource(log, load()).config.sources.gnss == "auto"
    for wanted in ("2", "GPS2_RAW"):
        source = TlogSource(log, load(), choice=Choice(gnss=wanted))
        assert source.config.sources.gnss == "gps2_raw"
    with pytest.raises(LogFormatError, match="no GNSS message called '3'; it has gps_raw_int, "):
        TlogSource(log, load(), choice=Choice(gnss="3"))


def test_there_is_no_reference(log: Path) -> None:
    with pytest.raises(LogFormatError, match="--reference"):
        TlogSource(log, load(), choice=Choice(reference="1"))
