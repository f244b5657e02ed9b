"""The estimator: the only path to a filter. Samples and measurements go in as they arrive, estimates come out.

It keeps one time line of IMU rows and measurements. A measurement belongs to its valid time: if that is past, the
filter is taken back to a snapshot before it and everything since is run again, gates included; if it lies ahead
of the newest IMU sample, it waits. The outcome depends on content and order of arrival alone, never on how many IMU
rows were handed over at a time. Theory: docs/theory/time.md.
"""

from __future__ import annotations

import math
from bisect import bisect_right, insort
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mavins.aiding import Measurement, gnss_position, gnss_velocity, heading, zero_velocity
from mavins.estimator.aligner import Aligner, Candidate
from mavins.estimator.buffer import ImuBuffer
from mavins.estimator.fusion import Event, Fusion, Track
from mavins.estimator.gate import gate_threshold
from mavins.estimator.quality import noise_of, objection
from mavins.estimator.settings import Settings
from mavins.estimator.solution import solution_of
from mavins.estimator.standing import HALF_WINDOW_US
from mavins.estimator.statistics import AidingStatistics
from mavins.filters import Filter, FilterState, ImuNoise, RowBlock, make
from mavins.nav.earth import TangentFrame
from mavins.nav.kernels import kernel
from mavins.nav.linalg import is_sane
from mavins.nav.so3 import dcm_to_quat, euler_to_quat, quat_to_dcm
from mavins.types import (
    FloatArray,
    GnssFix,
    HeadingFix,
    Health,
    ImuTable,
    IntArray,
    NavSolution,
    Origin,
)

TICK_US = 200_000
"""Standing, time-outs and health are looked at when the IMU stamps pass a multiple of this."""
SNAPSHOT_US = 40_000
LONGEST_RUN = 25
"""IMU rows that are walked at most without a snapshot."""
ROWS_HELD = 512
"""Output rows are handed over in blocks; `flush` hands over what there is."""
RESETS_TO_DIVERGE = 3
DIVERGE_WITHIN_US = 60_000_000


@dataclass(slots=True)
class _Snapshot:
    state: FilterState
    track: Track


@dataclass(frozen=True, slots=True)
class Outputs:
    """Where results go: rows of estimates and final decisions.

    `grid_us` is the time grid of the rows in us; 0: every IMU sample, negative: none.
    """

    grid_us: int = -1
    rows: Callable[[RowBlock, TangentFrame], None] | None = None
    decision: Callable[[Event], None] | None = None


class Estimator:
    """One vehicle's estimator."""

    def __init__(
        self, settings: Settings, filter_name: str = "eskf", outputs: Outputs | None = None
    ) -> None:
        self.settings = settings
        self._outputs = outputs or Outputs()
        self._noise = ImuNoise(
            settings.imu.gyro_noise,
            settings.imu.accel_noise,
            settings.imu.gyro_bias_walk,
            settings.imu.accel_bias_walk,
        )
        self.filter: Filter = make(filter_name, self._noise)
        self._buffer_us = round(settings.estimator.buffer * 1e6)
        self._imu_delay_us = round(settings.imu.delay * 1e6)
        self._max_gap_us = round(settings.estimator.max_gap * 1e6)
        self._rotation = _rotation(settings.imu.rotation)
        self._rows = RowBlock.empty(ROWS_HELD)
        self.frame: TangentFrame | None = None
        self._wanted_origin: Origin | None = None
        self.statistics: dict[str, AidingStatistics] = {}
        self.dropped: Counter[str] = Counter()
        self.imu_rows = 0
        self.realignments = 0
        self._resets_before = 0
        self._sequence = 0
        self._state: FilterState | None = None
        self._buffer = ImuBuffer()
        self._events: list[Event] = []
        self._snapshots: list[_Snapshot] = []
        self._fusion = Fusion(self.filter, settings.gnss.reset_after)
        self._aligner = Aligner(settings)
        self.health = Health.WAITING
        self.reason = "waiting for IMU and GNSS"

    # ---- what is known -----------------------------------------------------------------------------------------

    @property
    def running(self) -> bool:
        """True while there is an estimate."""
        return self._state is not None

    @property
    def reset_counter(self) -> int:
        """Rises by one at every jump of the estimate."""
        return self._resets_before + self._fusion.track.resets

    @property
    def t_us(self) -> int | None:
        """The newest IMU stamp, or None."""
        return self._buffer.newest_us if len(self._buffer) else None

    def solution(self) -> NavSolution | None:
        """The estimate at the newest IMU stamp, or None before `running`."""
        if self._state is None or self.frame is None:
            return None
        return solution_of(self._state, self.frame, self.health, self.reset_counter)

    # ---- what comes in -----------------------------------------------------------------------------------------

    def set_origin(self, origin: Origin) -> None:
        """Put the origin of n here; a running estimate is carried over to the new frame."""
        self._wanted_origin = origin
        if self.frame is None:
            return
        self.flush()
        old, new = self.frame, TangentFrame.at(origin)
        self._finish_decisions(None)
        self.frame = new
        if self._state is not None:
            _carry_over(self._state, old, new)
            self._events.clear()
            self._snapshots = [_Snapshot(self._state.copy(), self._fusion.track)]
            self._resets_before += 1

    def restart(self, reason: str) -> None:
        """Forget all samples and the estimate (the vehicle has rebooted); the origin stays."""
        self._finish_decisions(None)
        if self._state is not None:
            self._resets_before += 1
        self._start_over(reason, Health.WAITING)

    def feed_imu(self, table: ImuTable) -> None:
        """Take IMU samples in the order of their arrival."""
        t_us, imu = _to_body(table, self._imu_delay_us, self._rotation)
        start, n = 0, len(t_us)
        while start < n:
            newest = self._buffer.newest_us if len(self._buffer) else None
            if newest is not None and t_us[start] <= newest:
                self._late_sample(int(t_us[start]), imu[start])
                start += 1
                continue
            end = run_end(t_us, start, -1 if newest is None else newest, self._max_gap_us)
            if newest is not None and t_us[start] - newest > self._max_gap_us:
                self._lost(f"IMU gap of {(t_us[start] - newest) * 1e-6:.1f} s", Health.ALIGNING)
            self._take_rows(t_us[start:end], imu[start:end], newest)
            start = end

    def feed_gnss(self, fix: GnssFix) -> None:
        """Take a GNSS fix."""
        t_us = fix.t_us - round(fix.delay * 1e6)
        quality = objection(fix, self.settings.gnss)
        if not quality and fix.v_l is not None and not math.isnan(fix.v_l[0]):
            self._aligner.standing.see_speed(math.hypot(fix.v_l[0], fix.v_l[1]))
        self._aligner.see_fix(fix, t_us)
        if self._state is None or self.frame is None:
            return
        settings = self.settings.gnss
        noise = noise_of(fix, settings)
        self._take(
            gnss_position.measure(fix, t_us, self.frame, noise.h, noise.v, settings.gate, quality)
        )
        velocity = gnss_velocity.measure(fix, t_us, self.frame, noise.speed, settings.gate, quality)
        if velocity is not None:
            self._take(velocity)

    def feed_heading(self, fix: HeadingFix) -> None:
        """Take a heading."""
        t_us = fix.t_us - round(fix.delay * 1e6)
        self._aligner.see_heading(fix, t_us)
        if self._state is None or self.frame is None:
            return
        sigma = self.heading_sigma(fix)
        self._take(heading.measure(fix, t_us, self.frame, sigma, self.settings.heading.gate))

    def heading_sigma(self, fix: HeadingFix) -> float:
        """The 1-sigma noise (rad) taken for a heading."""
        return fix.sigma if fix.sigma is not None else math.radians(self.settings.heading.sigma_deg)

    def finish(self) -> None:
        """No more input: hand over the rows that are held and the decisions that are still open."""
        self.flush()
        self._finish_decisions(None)

    # ---- the time line -----------------------------------------------------------------------------------------

    def _start_over(self, reason: str, health: Health) -> None:
        self._state = None
        self._buffer = ImuBuffer()
        self._events = []
        self._snapshots = []
        self._fusion = Fusion(self.filter, self.settings.gnss.reset_after)
        self._aligner = Aligner(self.settings)
        self.health = health
        self.reason = reason

    def _take_rows(self, t_us: IntArray, imu: FloatArray, newest: int | None) -> None:
        """Append rows, of which only the last may have passed a tick, and move the estimate through them."""
        self.imu_rows += len(t_us)
        self._buffer.append(t_us, imu)
        if self._state is not None:
            self._run(self._buffer.end - len(t_us), self._outputs.grid_us)
        last = int(t_us[-1])
        before = newest if len(t_us) == 1 else int(t_us[-2])
        if before is not None and last // TICK_US != before // TICK_US:
            self._tick(last)

    def _late_sample(self, t_us: int, reading: FloatArray) -> None:
        """A sample older than the newest: a repetition is dropped, another is put in its place."""
        if self._buffer.contains(t_us):
            self.dropped["IMU repeated"] += 1
        elif t_us < max(self._buffer.oldest_us, self._buffer.newest_us - self._buffer_us):
            self.dropped["IMU too old"] += 1
        else:
            self.imu_rows += 1
            self._buffer.insert(t_us, reading)
            if self._state is not None:
                self._rewind(t_us)

    def _take(self, measurement: Measurement) -> None:
        """Put a measurement on the time line and fuse it where it belongs."""
        self._sequence += 1
        order = (measurement.t_us, measurement.rank, measurement.source, self._sequence)
        event = Event(measurement, order)
        if self._state is None or not self._snapshots:
            return
        oldest = max(self._snapshots[0].state.t_us, self._buffer.newest_us - self._buffer_us)
        if measurement.t_us <= oldest:
            event.reason = "too old"
        elif measurement.t_us > self._buffer.newest_us + self._buffer_us:
            event.reason = "too far ahead"
        if event.reason:
            self._decide(event)
            return
        insort(self._events, event, key=lambda e: e.order)
        if measurement.t_us <= self._buffer.newest_us:
            self._rewind(measurement.t_us)

    def _rewind(self, t_us: int) -> None:
        """Run again everything from just before t_us."""
        i = bisect_right(self._snapshots, t_us - 1, key=lambda s: s.state.t_us) - 1
        if i < 0:
            return
        if self._state is None or self._state.t_us >= t_us:
            del self._snapshots[i + 1 :]
            self._state = self._snapshots[i].state.copy()
            self._fusion.track = self._snapshots[i].track
        self._run(self._buffer.row_after(self._state.t_us), -1)

    def _run(self, first: int, grid_us: int) -> None:
        """Move the state to the newest row, fusing the events on the way; `first` is the first row not walked."""
        state, frame = self._state, self.frame
        assert state is not None
        assert frame is not None
        buffer, rows = self._buffer, self._rows
        newest = buffer.newest_us
        i = bisect_right(self._events, state.t_us, key=lambda e: e.order[0])
        while True:
            event = self._events[i] if i < len(self._events) else None
            until = newest if event is None else min(newest, event.order[0])
            last = buffer.row_after(until)
            end = min(last, first + LONGEST_RUN)
            if end > first:
                previous = (
                    int(buffer.times(first - 1, first)[0]) if first > buffer.first else state.t_us
                )
                self.filter.walk(
                    state,
                    frame,
                    buffer.times(first, end),
                    buffer.readings(first, end),
                    previous,
                    grid_us,
                    rows,
                )
                first = end
                if rows.count > ROWS_HELD - LONGEST_RUN:
                    self.flush()
            if end < last:
                self._snapshot()
                continue
            if event is None or event.order[0] > newest:
                break
            if event.order[0] > state.t_us:
                # all events up to here are in: a place to come back to
                self._snapshot()
                self.filter.advance(state, frame, event.order[0], buffer.reading_at(event.order[0]))
            self._fusion.fuse(state, event)
            i += 1
        self._snapshot()
        self._check_sanity()

    def _snapshot(self) -> None:
        state = self._state
        assert state is not None
        if self._snapshots and state.t_us - self._snapshots[-1].state.t_us < SNAPSHOT_US:
            return
        self._snapshots.append(_Snapshot(state.copy(), self._fusion.track))

    def flush(self) -> None:
        """Hand over the output rows that are held."""
        if self._rows.count and self._outputs.rows is not None and self.frame is not None:
            self._outputs.rows(self._rows, self.frame)
        self._rows.count = 0

    # ---- decisions and health ----------------------------------------------------------------------------------

    def _tick(self, now_us: int) -> None:
        """What is looked at a few times a second."""
        standing = self._aligner.standing
        if self._state is None or not standing.moved:
            standing.tick(self._buffer, now_us)
        if self._state is None:
            self._try_to_align(now_us)
        else:
            self._zero_velocity(now_us)
            self._judge_health(now_us)
        self._prune(now_us)

    def _zero_velocity(self, now_us: int) -> None:
        settings = self.settings.zero_velocity
        if settings.enabled and self._aligner.standing.standing:
            # valid a window ago: the samples since then have confirmed that nothing moved
            self._take(
                zero_velocity.measure(
                    now_us, now_us - HALF_WINDOW_US, settings.sigma, settings.gate
                )
            )

    def _judge_health(self, now_us: int) -> None:
        state = self._state
        if state is None:
            return
        track = self._fusion.track
        gnss_us = max(track.accepted_us[0], track.accepted_us[1])
        silent = (now_us - gnss_us) * 1e-6
        lately = [t for t in track.reset_times_us if now_us - t < DIVERGE_WITHIN_US]
        if len(lately) >= RESETS_TO_DIVERGE:
            self._lost(f"{len(lately)} resets within a minute", Health.DIVERGED)
        elif (
            math.sqrt(max(state.P[0, 0], state.P[1, 1]))
            > self.settings.estimator.max_position_sigma
        ):
            self._lost("position sigma beyond its limit", Health.DIVERGED)
        elif silent > self.settings.estimator.dead_reckoning_after:
            self.health = Health.DEAD_RECKONING
            self.reason = f"no GNSS accepted for {silent:.0f} s"
        else:
            self.health = Health.RUNNING
            self.reason = self._yaw_remark(now_us)

    def _yaw_remark(self, now_us: int) -> str:
        assert self._state is not None
        heading_us = self._fusion.track.accepted_us[heading.RANK]
        sigma = math.sqrt(float(self._state.P[8, 8]))
        if now_us - heading_us > 5_000_000 and sigma > math.radians(8.0):
            return f"yaw not observable (sigma {math.degrees(sigma):.0f} deg): no heading, no acceleration"
        return ""

    def _check_sanity(self) -> None:
        state = self._state
        if state is not None and not is_sane(state.x, state.P):
            self._lost("the estimate is not finite", Health.DIVERGED)

    def _lost(self, reason: str, health: Health) -> None:
        """Give the estimate up and align anew; the origin stays."""
        had_estimate = self._state is not None
        resets = self.reset_counter
        self._finish_decisions(None)
        self._start_over(reason, health)
        self._resets_before = resets + 1 if had_estimate else resets
        self.realignments += had_estimate

    def _decide(self, event: Event) -> None:
        m = event.measurement
        statistics = self.statistics.setdefault(m.aiding, AidingStatistics())
        statistics.add(event, gate_threshold(m.gate, max(1, len(m.z))))
        if self._outputs.decision is not None:
            self._outputs.decision(event)

    def _finish_decisions(self, before_us: int | None) -> None:
        """Count and write the decisions on measurements before this time (None: all that were taken up)."""
        keep = 0
        for event in self._events:
            if before_us is not None and event.order[0] >= before_us:
                break
            keep += 1
            if len(event.innovation):
                self._decide(event)
        del self._events[:keep]

    def _prune(self, now_us: int) -> None:
        """Forget what no rewind can reach any more."""
        horizon = now_us - self._buffer_us
        i = bisect_right(self._snapshots, horizon, key=lambda s: s.state.t_us) - 1
        if i > 0:
            del self._snapshots[:i]
        reachable = min(horizon, self._snapshots[0].state.t_us) if self._snapshots else horizon
        self._finish_decisions(reachable)
        window_us = round(self.settings.alignment.window * 1e6)
        self._buffer.drop_before(reachable - window_us)

    # ---- alignment ---------------------------------------------------------------------------------------------

    def _try_to_align(self, now_us: int) -> None:
        candidate = self._aligner.candidate(self._buffer, now_us, self._buffer_us)
        if isinstance(candidate, str):
            if self.health != Health.DIVERGED or self._aligner.gate.good:
                waiting = not self._aligner.gate.good
                self.health = Health.WAITING if waiting else Health.ALIGNING
                self.reason = candidate
            return
        self._begin(candidate)

    def _begin(self, candidate: Candidate) -> None:
        """Start at the valid time of the newest good fix and walk to now."""
        fix = candidate.fix
        if self.frame is None:
            self.frame = TangentFrame.at(self._wanted_origin or Origin(fix.lat, fix.lon, fix.alt))
        x, P = self._aligner.start(
            candidate, self.frame, self.filter.layout.size, self.heading_sigma
        )
        first = self._buffer.row_after(candidate.t_us)
        self._state = FilterState(x, P, self._buffer.reading_at(candidate.t_us), candidate.t_us)
        self._fusion.track = Track(accepted_us=(candidate.t_us,) * 3)
        self._snapshots = [_Snapshot(self._state.copy(), self._fusion.track)]
        self.health = Health.RUNNING
        self.reason = ""
        self._run(first, -1)


def _rotation(angles: tuple[float, float, float]) -> FloatArray | None:
    return None if angles == (0.0, 0.0, 0.0) else quat_to_dcm(euler_to_quat(*angles))


@kernel
def run_end(t_us: IntArray, start: int, newest_us: int, max_gap_us: int) -> int:
    """Where the run of stamps t_us (N,) from `start` ends: after the first one past a tick, before disorder or a gap.

    `newest_us` is the stamp before the run, -1 for none.
    """
    last = t_us[start]
    if newest_us >= 0 and last // TICK_US != newest_us // TICK_US:
        return start + 1
    end = start + 1
    while end < len(t_us):
        t = t_us[end]
        if t <= last or t - last > max_gap_us:
            break
        end += 1
        if t // TICK_US != last // TICK_US:
            break
        last = t
    return end


@kernel
def _rotate_rows(C: FloatArray, imu: FloatArray) -> FloatArray:
    """Rows (N, 6) of two vectors each, turned by C (3, 3); a loop, so that a row does not depend on its neighbours."""
    out = np.zeros(imu.shape)
    for k in range(imu.shape[0]):
        for i in range(3):
            for j in range(3):
                out[k, i] += C[i, j] * imu[k, j]
                out[k, 3 + i] += C[i, j] * imu[k, 3 + j]
    return out


def _to_body(
    table: ImuTable, delay_us: int, rotation: FloatArray | None
) -> tuple[IntArray, FloatArray]:
    """Valid times (N,) and readings [gyro_b, accel_b] (N, 6) of a table."""
    imu = np.empty((len(table), 6))
    imu[:, :3] = table.gyro_b
    imu[:, 3:] = table.accel_b
    t_us = table.t_us - delay_us if delay_us else table.t_us
    return t_us, imu if rotation is None else _rotate_rows(rotation, imu)


def _carry_over(state: FilterState, old: TangentFrame, new: TangentFrame) -> None:
    """Express a state of one tangent frame in another."""
    C = new.C_ne @ old.C_ne.T
    lla = old.to_lla(state.x[:3])
    state.x[:3] = new.from_lla(*lla)
    state.x[3:6] = C @ state.x[3:6]
    q = dcm_to_quat(C @ quat_to_dcm(state.x[6:10]))
    state.x[6:10] = q
    T = np.eye(state.P.shape[0])
    T[0:3, 0:3] = C
    T[3:6, 3:6] = C
    state.P[:, :] = T @ state.P @ T.T
