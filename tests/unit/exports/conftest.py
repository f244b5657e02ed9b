"""A small result folder, written by what writes real ones."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavins.aiding import Measurement
from mavins.config import Config, to_yaml
from mavins.estimates import Result
from mavins.estimator.fusion import Event
from mavins.evaluation.evidence import FILE, write_evidence
from mavins.evaluation.result_folder import read_result
from mavins.evaluation.witness import Witness
from mavins.filters.base import RowBlock
from mavins.nav.earth import TangentFrame
from mavins.results import ResultWriter, write_json, write_text
from mavins.types import GnssFix, Origin

ORIGIN = Origin(math.radians(47.4), math.radians(8.5), 500.0)
FRAME = TangentFrame.at(ORIGIN)
FIRST_US = 10_000_000
UTC_OFFSET_US = 1_790_000_000_000_000
N = 300
GAP_AT = 200
"""The row before which nothing was estimated for 5 s."""


class Nothing:
    """A feed that forgets."""

    def feed_gnss(self, fix: GnssFix) -> None:
        pass


def rows() -> RowBlock:
    """6 s at 50 Hz, north-east, climbing and turning, far from the origin; with a gap of 5 s."""
    block = RowBlock.empty(N, Config().states.layout().size)
    block.count = N
    for k in range(N):
        t = 0.02 * k
        block.t_us[k] = FIRST_US + 20_000 * k + (5_000_000 if k >= GAP_AT else 0)
        block.x[k] = 0.0
        block.x[k, 0:3] = (20_000.0 + 10.0 * t, 5.0 * t, -1.0 - t)
        block.x[k, 3:6] = (10.0, 5.0, -1.0)
        yaw, pitch = 0.4 + 0.1 * t, 0.3
        cy, sy, cp, sp = (
            math.cos(yaw / 2),
            math.sin(yaw / 2),
            math.cos(pitch / 2),
            math.sin(pitch / 2),
        )
        block.x[k, 6:10] = (cy * cp, -sy * sp, cy * sp, sy * cp)
        block.P[k] = np.eye(block.P.shape[1]) * 0.04
    return block


def decision(k: int, accepted: bool) -> Event:
    measurement = Measurement(
        aiding="gnss_velocity",
        source="GPS_RAW_INT",
        stamp_us=FIRST_US + 200_000 * k,
        t_us=FIRST_US + 200_000 * k,
        rank=1,
        z=np.zeros(2),
        R=np.eye(2),
        model=None,
        parameters=np.zeros(1),
        gate=5.0,
        quality="",
    )  # type: ignore[arg-type]
    reason, nis = ("", 1.5) if accepted else ("gate", 40.0)
    event = Event(measurement, (measurement.t_us, 1, "GPS_RAW_INT", 0), reason, nis)
    event.innovation, event.S = np.array([0.1 * k, -0.2]), np.diag([0.09, 0.16])
    return event


@pytest.fixture
def make_result(tmp_path: Path) -> Callable[..., Result]:
    """Write a result folder and read it; `summary` adds to summary.json."""

    def make(name: str = "result", block: RowBlock | None = None, **summary: Any) -> Result:
        out = tmp_path / name
        with ResultWriter(out / "eskf", Config().states.layout()) as writer:
            writer.write_rows(rows() if block is None else block, FRAME)
            for k in range(5):
                writer.write_decision(decision(k, accepted=k != 3))
        write_text(out / "eskf" / "config.yaml", to_yaml(Config()))
        witness = Witness(Nothing())  # type: ignore[arg-type]
        for k in range(30):
            fix = GnssFix(
                FIRST_US + 200_000 * k,
                ORIGIN.lat + 1e-6 * k,
                ORIGIN.lon,
                510.0,
                None,
                3 if k else 0,
                9,
                0.5,
                0.8,
                0.2,
            )
            witness.feed_gnss(fix)
        write_evidence(out / "eskf" / FILE, witness.evidence(), np.empty((0, 6)))
        told = {
            "mavins": "0",
            "log": "flight.tlog",
            "filter": "eskf",
            "health": "running",
            "reason": "",
            "origin": {"lat_deg": 47.4, "lon_deg": 8.5, "alt_m": 500.0},
            "utc_offset_us": UTC_OFFSET_US,
        }
        write_json(out / "summary.json", told | summary)
        return read_result(out)

    return make
