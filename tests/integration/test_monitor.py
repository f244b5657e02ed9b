"""The integrity monitor on recorded flights: PX4's and ArduPilot's own estimates, as they are and bent."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavins.config import Config
from mavins.estimator.estimator import Estimator, Outputs
from mavins.filters import RowBlock
from mavins.logs.tlog import read_tlog
from mavins.mavlink.autopilot_settings import MonitorSettings
from mavins.mavlink.codec import Fields, Frames, Payload, fields_of, frame, scan_tlog
from mavins.mavlink.intake import RELEVANT, Intake
from mavins.mavlink.monitor import Monitor
from mavins.nav.earth import TangentFrame

pytestmark = [pytest.mark.slow, pytest.mark.jit]

PX4 = "recordings/px4_quad_mission.tlog.xz"
ARDUPILOT = "recordings/ap_copter_square_circle.tlog.xz"
ATTITUDE, GLOBAL = fields_of("ATTITUDE"), fields_of("GLOBAL_POSITION_INT")

Shared = Callable[[str], Path]
Bend = Callable[[float, list[Any]], None]


class Run:
    """A log through intake and estimator in chunks, and what the monitor said, with the vehicle's time."""

    def __init__(
        self,
        frames: Frames,
        settings: MonitorSettings | None = None,
        config: Config | None = None,
    ) -> None:
        self._columns: list[list[bytes]] = [[], [], []]
        self.said: list[tuple[float, str, bool]] = []
        config = config or Config()
        self.estimator = Estimator(config, config.filter, Outputs(20_000, self._row))
        self.monitor = None if settings is None else Monitor(settings, self.estimator)
        self.intake = Intake(self.estimator, config.sources, self.monitor)
        for start in range(0, len(frames), 100):
            self.intake.take(frames.select(np.arange(start, min(start + 100, len(frames)))))
            if self.monitor is not None:
                t = (self.estimator.t_us or 0) * 1e-6
                self.said += [(t, text, warning) for text, warning in self.monitor.texts()]
        self.estimator.finish()

    def _row(self, block: RowBlock, frame: TangentFrame) -> None:
        for column, array in zip(self._columns, (block.t_us, block.x, block.P), strict=True):
            column.append(array[: block.count].tobytes())

    @property
    def bits(self) -> list[bytes]:
        """Stamps, states and covariances of all rows."""
        return [b"".join(column) for column in self._columns]

    @property
    def summary(self) -> dict[str, Any]:
        found = None if self.monitor is None else self.monitor.summary()
        assert found is not None
        return found


def flight(path: Path, seconds: float) -> Frames:
    """What the first vehicle of a recording sends us, for so long."""
    frames = read_tlog(path)
    sysid = int(frames.sysid[frames.msgid == fields_of("HIGHRES_IMU").msgid][0])
    early = frames.t_us < frames.t_us[0] + round(seconds * 1e6)
    return frames.select((frames.sysid == sysid) & np.isin(frames.msgid, RELEVANT) & early)


def bent(frames: Frames, fields: Fields, bend: Bend) -> Frames:
    """The same packets, one kind of them changed by `bend(boot seconds, values in wire order)`."""
    out = bytearray()
    for i in range(len(frames)):
        packet = frames.packet(i)
        if frames.msgid[i] == fields.msgid:
            values = list(fields.unpacker.unpack(frames.body(i, fields.unpacker.size)))
            bend(values[0] * 1e-3, values)
            payload = Payload(fields.msgid, fields.crc_extra, fields.unpacker.pack(*values))
            packet = frame(payload, int(frames.sysid[i]), int(frames.compid[i]), i)
        out += int(frames.t_us[i]).to_bytes(8, "big") + packet
    return scan_tlog(bytes(out))


def drift(t: float, rate: float, most: float) -> float:
    """Grows at `rate` from 90 s on, up to `most`; over at 110 s."""
    return min(rate * (t - 90.0), most) if 90.0 <= t < 110.0 else 0.0


@pytest.fixture(scope="module")
def px4(shared: Shared) -> Frames:
    return flight(shared(PX4), 125.0)


def test_px4_agrees_with_us_and_watching_changes_no_bit(px4: Frames) -> None:
    watched, alone = Run(px4, MonitorSettings()), Run(px4)
    assert watched.bits == alone.bits
    assert len(watched.bits[0]) > 8 * 5000
    assert watched.said == []
    summary = watched.summary
    assert set(summary) == {"position", "height", "velocity", "tilt", "yaw"}
    for name, item in summary.items():
        assert item["worst_ratio"] < 0.3, (name, item)
        assert item["looks"] > 500, (name, item)


def test_ardupilot_lags_but_agrees(shared: Shared) -> None:
    run = Run(flight(shared(ARDUPILOT), 140.0), MonitorSettings())
    assert run.said == []
    position = run.summary["position"]
    # its position is 0.13 s late: more than a metre at 10 m/s
    assert 0.8 < position["worst_difference"] < 2.0
    assert position["worst_ratio"] < 0.8


def test_a_px4_whose_position_drifts(px4: Frames) -> None:
    def bend(t: float, values: list[Any]) -> None:
        values[1] += round(drift(t, 1.0, 20.0) * 90.0)  # 1 m is 90e-7 deg of latitude

    settings = MonitorSettings()
    run = Run(bent(px4, GLOBAL, bend), settings)
    (begin, text, _), (end, text_after, _) = run.said
    assert text.startswith("mavins: autopilot position differs by ")
    assert text_after.startswith("mavins: autopilot position agrees again")
    latest = 90.0 + run.summary["position"]["worst_limit"] + settings.after
    assert 90.0 + settings.position + settings.after <= begin <= latest + 0.8
    assert 113.0 <= end <= 113.8
    assert run.summary["position"]["warnings"] == 1
    assert run.summary["velocity"]["warnings"] == 0


@pytest.mark.parametrize(
    ("rate", "latest"),
    [
        pytest.param(12.0, 96.0, id="our gate refuses it as a heading"),
        pytest.param(4.0, 108.0, id="our yaw goes along, that of motion does not"),
    ],
)
def test_a_px4_whose_yaw_drifts(px4: Frames, rate: float, latest: float) -> None:
    def bend(t: float, values: list[Any]) -> None:
        values[3] += math.radians(drift(t, rate, 60.0))

    settings = MonitorSettings()
    run = Run(bent(px4, ATTITUDE, bend), settings)
    begin, text, warning = run.said[0]
    assert warning
    assert text.startswith("mavins: autopilot yaw differs by ")
    assert 90.0 + settings.yaw_deg / rate + settings.after <= begin <= latest
    assert run.summary["tilt"]["warnings"] == 0
    if rate > 10.0:
        (_, (end, text_after, _)) = run.said
        assert text_after.startswith("mavins: autopilot yaw agrees again")
        assert 113.0 <= end <= 114.0
