"""Compile every kernel before the first packet counts: a few seconds of a standing vehicle through the real path."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import numpy as np

from mavins.config import Config
from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.solution import WIDTH, describe
from mavins.evaluation.errors import errors_against
from mavins.evaluation.live import LiveTruth
from mavins.filters.base import RowBlock
from mavins.mavlink.codec import (
    attitude,
    frame,
    global_position_int,
    gps_raw_int,
    heartbeat,
    highres_imu,
    hil_state_quaternion,
    scan_tlog,
)
from mavins.mavlink.session import Session
from mavins.nav.earth import TangentFrame
from mavins.nav.kernels import CACHE, is_cached, mark_cached
from mavins.table_text import csv_lines
from mavins.types import GnssFix, ImuSample, TruthSample

_STEP_US = 50_000
_LAT, _LON, _ALT = math.radians(47.0), math.radians(8.0), 400.0


def compile_all(report: Callable[[str], None]) -> None:
    """Compile what is not in the cache yet; says so if that will take a while."""
    cold = not is_cached()
    started = time.monotonic()
    if cold:
        report("compiling the kernels (first start only, up to half a minute) ...")
    _fly(report if cold else lambda line: None)
    if cold:
        mark_cached()
        kept = (
            f"kept in {CACHE}" if CACHE is not None else "not kept: no cache folder can be written"
        )
        report(f"compiled in {time.monotonic() - started:.0f} s, {kept}")


def _describe(block: RowBlock, frame_n: TangentFrame) -> None:
    n = block.count
    rows = np.empty((n, WIDTH))
    describe(block.x[:n], block.P[:n], frame_n.r0_e, frame_n.C_ne, rows)
    csv_lines(block.t_us[:n], rows, np.zeros(WIDTH, dtype=np.int64))


def _fly(report: Callable[[str], None]) -> None:
    """Four seconds of packets: 20 Hz IMU, 5 Hz late fixes, heading, truth; with a rewind and a late sample."""
    config = Config()
    estimator = Estimator(config, config.filter, Outputs(20_000, _describe))
    session = Session(config.mavlink, config.streams, config.sources, lambda sysid: estimator)
    truth = LiveTruth()
    session.add_peer("warm-up")
    stage = ""
    for k in range(80):
        t_us = 1_000_000 + _STEP_US * k
        payloads = [highres_imu(_sample(t_us))] if k % 37 else []
        if k % 37 == 1 and k > 1:
            payloads.append(highres_imu(_sample(t_us - _STEP_US)))
        if k % 20 == 0:
            payloads.append(heartbeat(2, 0))
        if k % 4 == 0:
            fix = GnssFix(t_us - 23_000, _LAT, _LON, _ALT, (0.0, 0.0, 0.0), 3, 12, 0.5, 0.5, 0.1)
            payloads.append(gps_raw_int(fix))
            payloads.append(
                global_position_int(fix.t_us, _LAT, _LON, _ALT, 0.0, (0.0, 0.0, 0.0), None)
            )
        if k % 2 == 0:
            payloads.append(attitude(t_us, 0.0, 0.0, 0.3, (0.0, 0.0, 0.0)))
            sample = TruthSample(t_us, _LAT, _LON, _ALT, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
            payloads.append(hil_state_quaternion(sample, (0.0, 0.0, -9.8), (0.0, 0.0, 0.0)))
        for n, payload in enumerate(payloads):
            data = frame(payload, 1, 1, n)
            frames = session.receive(data, "warm-up", t_us)
            truth.take(frames, 1, estimator.solution())
        session.datagrams()
        now = f"filter {estimator.health.name.lower()}"
        if now != stage:
            stage = now
            report(f"  {stage}")
    estimator.finish()
    scan_tlog(b"")
    one, two = np.zeros((1, 3)), np.zeros((2, 3))
    truth_table = (np.arange(2), two, two, np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)))
    errors_against(np.zeros(1, dtype=np.int64), one, one, one, truth_table)


def _sample(t_us: int) -> ImuSample:
    return ImuSample(t_us, np.array([0.0, 0.0, -9.81]), np.zeros(3))
