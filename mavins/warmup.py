"""Compile every kernel before the first packet counts: a few seconds of a standing vehicle through the real path."""

from __future__ import annotations

import math
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Final

import numpy as np

from mavins.aiding import Measurement, gnss_position, gnss_velocity, heading, zero_velocity
from mavins.aiding.many import linearize
from mavins.config import Config
from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.passage import Compiled, Rows, passage_of
from mavins.estimator.solution import WIDTH, describe
from mavins.estimator.vibration import Vibration
from mavins.evaluation.errors import errors_against
from mavins.evaluation.live import LiveTruth
from mavins.filters import Filter, FilterState, ImuNoise, RowBlock, make
from mavins.mavlink.codec import (
    attitude,
    attitude_quaternion_cov,
    frame,
    global_position_int,
    gps_raw_int,
    heartbeat,
    highres_imu,
    hil_state_quaternion,
    incomplete_at,
    local_position_ned_cov,
    scan_tlog,
)
from mavins.mavlink.session import Session
from mavins.mavlink.track import Instant, tilt_and_yaw
from mavins.nav.earth import TangentFrame
from mavins.nav.ins import predict, workspace
from mavins.nav.kernels import CACHE, compiles, is_cached, mark_cached
from mavins.nav.layout import X_SIZE
from mavins.nav.so3 import euler_to_quat
from mavins.table_text import csv_lines
from mavins.types import GnssFix, HeadingFix, ImuSample, ImuTable, Origin, TruthSample

_STEP_US = 50_000
_LAT, _LON, _ALT = math.radians(47.0), math.radians(8.0), 400.0


Report = Callable[[str], None]


def compile_all(report: Report, filter_name: str = "eskf") -> None:
    """Have every kernel that is used with a filter ready; says so if that will take a while.

    What is not in the cache yet is compiled by processes of their own, one after the other: the compiler's memory
    goes with them, and this process only loads what they leave.
    """
    cold = compiles() and not is_cached(filter_name)
    started = time.monotonic()
    if cold:
        report("compiling the kernels (first start only, a minute or two) ...")
        if CACHE is not None:
            for stage in _stages_of(filter_name):
                _in_a_process(stage, filter_name, report)
    _results(filter_name, lambda line: None)
    _fly(filter_name, report if cold and CACHE is None else lambda line: None)
    if cold:
        mark_cached(filter_name)
        kept = (
            f"kept in {CACHE}" if CACHE is not None else "not kept: no cache folder can be written"
        )
        report(f"compiled in {time.monotonic() - started:.0f} s, {kept}")


def _stages_of(filter_name: str) -> list[str]:
    """The stages for a filter: parts of the kernel for stretches only where there is one."""
    whole = isinstance(passage_of(_filter(filter_name)), Compiled)
    return [stage for stage in STAGES if whole or stage not in _OF_STRETCHES]


def not_ready(config: Config) -> str:
    """Why a service at work cannot change to this configuration's filter, or nothing: compiling would stop it."""
    if not compiles() or is_cached(config.filter):
        return ""
    return f"{config.filter} is not compiled yet; first run: mavins warmup --filter {config.filter}"


def _in_a_process(stage: str, filter_name: str, report: Report) -> None:
    """Run one stage in a process of its own; if it fails, the flight here compiles what is missing."""
    command = [sys.executable, "-m", "mavins.warmup", stage, filter_name]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            report(line.rstrip())


def _filter(name: str) -> Filter:
    return make(name, ImuNoise(0.01, 0.1, 1e-4, 1e-3), Config().states.layout())


def _standing(filter_name: str) -> tuple[Filter, FilterState, TangentFrame]:
    x, u = np.zeros(X_SIZE), np.array([0.0, 0.0, 0.0, 0.0, 0.0, -9.81])
    x[6] = 1.0
    algorithm = _filter(filter_name)
    state = FilterState(x, 0.01 * np.eye(algorithm.layout.size), u, 0)
    algorithm.adopt(state)
    return algorithm, state, TangentFrame.at(Origin(_LAT, _LON, _ALT))


def _models(filter_name: str, report: Report) -> None:
    """What measurements say of a state."""
    report("  aidings")
    _, state, _ = _standing(filter_name)
    linearize(zero_velocity.RANK, state.x, state.u, np.zeros(3), np.empty(0))


def _gnss(filter_name: str, report: Report) -> None:
    """The larger of them."""
    report("  GNSS")
    _, state, frame_n = _standing(filter_name)
    velocity = gnss_velocity.measure(_fix(0), 0, frame_n, 1.0, 5.0)
    assert velocity is not None
    velocity.linearize(state.x, state.u)
    _position(frame_n).linearize(state.x, state.u)
    heading.measure(HeadingFix(0, 0.0), 0, frame_n, 1.0, 5.0).linearize(state.x, state.u)


def _position(frame_n: TangentFrame) -> Measurement:
    return gnss_position.measure(_fix(0), 0, frame_n, 1.0, 1.0, 5.0)


def _mechanization(filter_name: str, report: Report) -> None:
    """The step of the error-state filters, without a filter around it."""
    report("  mechanization")
    algorithm, state, frame_n = _standing(filter_name)
    layout, zero = algorithm.layout, (0.0, 0.0, 0.0)
    noise = ImuNoise(0.01, 0.1, 1e-4, 1e-3).as_array(layout)
    earth = (frame_n.r0_e, frame_n.C_ne, frame_n.w_ie_n)
    work = workspace(layout.size, layout.has_gravity)
    predict(state.x, state.P, zero, zero, 0.01, noise, 1.0, *earth, work)


def _walk(filter_name: str, report: Report) -> None:
    """A way through IMU samples: the filter's largest kernel."""
    report(f"  steps of {filter_name}")
    algorithm, state, frame_n = _standing(filter_name)
    imu, out = np.tile(state.u, (1, 1)), RowBlock.empty(1, algorithm.layout.size)
    rows = Rows(np.array([_STEP_US]), imu, 0, _STEP_US, 0, out)
    passage_of(algorithm).go(state, frame_n, rows, (), 0)


def _update(filter_name: str, report: Report) -> None:
    """A measurement into the filter."""
    report(f"  updates of {filter_name}")
    algorithm, state, frame_n = _standing(filter_name)
    algorithm.update(state, _position(frame_n), 30.0)


def _estimate(filter_name: str, report: Report) -> None:
    """Four seconds of a standing vehicle into an estimator, without packets."""
    report("  estimator")
    estimator = Estimator(Config(), filter_name)
    for k in range(80):
        sample = _sample(1_000_000 + _STEP_US * k)
        table = ImuTable(np.array([sample.t_us]), sample.accel_b[None], sample.gyro_b[None])
        estimator.feed_imu(table)
        if k % 4 == 0:
            estimator.feed_gnss(_fix(sample.t_us))
        if k % 2 == 0:
            estimator.feed_heading(HeadingFix(sample.t_us, 0.3))
    estimator.finish()


def _describe(block: RowBlock, frame_n: TangentFrame) -> None:
    n = block.count
    rows = np.empty((n, WIDTH))
    describe(block.x[:n], block.P[:n], frame_n.r0_e, frame_n.C_ne, rows)
    csv_lines(block.t_us[:n], rows, np.zeros(WIDTH, dtype=np.int64))


def _fly(filter_name: str, report: Report) -> None:
    """Four seconds of packets: 20 Hz IMU, 5 Hz late fixes, heading, truth; with a rewind and a late sample."""
    config = Config()
    estimator = Estimator(config, filter_name, Outputs(20_000, _describe))
    session = Session(config, lambda sysid: estimator)
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
            fix = _fix(t_us - 23_000)
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
    _tell(estimator)
    estimator.finish()
    scan_tlog(b"")
    incomplete_at(b"")


def _tell(estimator: Estimator) -> None:
    """What is told on request, and of an autopilot that has an estimate of its own."""
    solution, frame_n = estimator.solution(), estimator.frame
    assert solution is not None
    assert frame_n is not None
    local_position_ned_cov(solution)
    attitude_quaternion_cov(solution)
    Vibration().look(estimator)
    now = Instant.of(solution, frame_n, estimator.yaw_from_motion())
    between = now.between(now.moved(now.t_us + 2), now.t_us + 1)
    tilt_and_yaw(euler_to_quat(0.0, 0.0, 0.3), between.q_lb)


def _results(filter_name: str, report: Report) -> None:
    """Rows as they are written, and errors as they are judged."""
    report("  results")
    frame_n = TangentFrame.at(Origin(_LAT, _LON, _ALT))
    rows = RowBlock.empty(1)
    rows.count = 1
    for table in (rows.t_us, rows.x, rows.u, rows.P):
        table[:] = 1
    _describe(rows, frame_n)
    frame_n.local_level(_LAT, _LON)
    frame_n.from_lla(_LAT, _LON, _ALT)
    one, two = np.zeros((1, 3)), np.zeros((2, 3))
    truth_table = (np.arange(2), two, two, np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)))
    errors_against(np.zeros(1, dtype=np.int64), one, one, one, truth_table)


def _fix(t_us: int) -> GnssFix:
    return GnssFix(t_us, _LAT, _LON, _ALT, (0.0, 0.0, 0.0), 3, 12, 0.5, 0.5, 0.1)


def _sample(t_us: int) -> ImuSample:
    return ImuSample(t_us, np.array([0.0, 0.0, -9.81]), np.zeros(3))


STAGES: Final[dict[str, Callable[[str, Report], None]]] = {
    "gnss": _gnss,
    "aidings": _models,
    "mechanization": _mechanization,
    "update": _update,
    "walk": _walk,
    "estimator": _estimate,
    "results": _results,
    "flight": _fly,
}
"""What is compiled by a process each, in this order: each needs less memory than all at once."""

_OF_STRETCHES: Final = ("aidings", "mechanization")

if __name__ == "__main__":
    STAGES[sys.argv[1]](sys.argv[2], lambda line: print(line, flush=True))
