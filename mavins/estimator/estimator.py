"""The estimator: the only path to a filter. Samples and measurements go in as they arrive, estimates come out.

It makes measurements out of fixes, aligns, watches over health and resets, and leaves the order of time to the
time line. The outcome depends on content and order of arrival alone, never on how many IMU rows were handed over
at a time.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from mavins.aiding import Measurement, zero_rate, zero_velocity
from mavins.aiding.detectors import gnss_speed
from mavins.estimator.aligner import Aligner, Candidate
from mavins.estimator.feed import Between
from mavins.estimator.fusion import Event, Fusion, Track
from mavins.estimator.gate import gate_threshold
from mavins.estimator.health import judged
from mavins.estimator.history import History
from mavins.estimator.imu_rows import TICK_US, run_end, to_body, turn_of
from mavins.estimator.measuring import Measuring
from mavins.estimator.pseudo import gravity_tilt_at, nonholonomic_at
from mavins.estimator.quality import noise_of, objection
from mavins.estimator.reconfigure import (
    applicable,
    begin_delay,
    delay_told,
    imu_noise,
    needs_filter,
)
from mavins.estimator.settings import Settings
from mavins.estimator.solution import solution_of
from mavins.estimator.standing import HALF_WINDOW_US
from mavins.estimator.statistics import AidingStatistics
from mavins.estimator.still import Still, still_detector
from mavins.estimator.timeline import Arrivals, Timeline
from mavins.estimator.yaw_watch import YawWatch
from mavins.filters import Filter, FilterState, RowBlock, make
from mavins.nav.earth import TangentFrame
from mavins.nav.linalg import is_sane
from mavins.types import (
    BaroSample,
    FloatArray,
    GnssFix,
    HeadingFix,
    Health,
    ImuTable,
    IntArray,
    MagSample,
    NavSolution,
    Origin,
    Reading,
)


@dataclass(frozen=True, slots=True)
class Outputs:
    """Where results go: rows of estimates and final decisions.

    `grid_us` is the time grid of the rows in us; 0: every IMU sample, negative: none. `history` takes what a smoother
    needs.
    """

    grid_us: int = -1
    rows: Callable[[RowBlock, TangentFrame], None] | None = None
    decision: Callable[[Event], None] | None = None
    history: History | None = None


class Estimator:
    """One vehicle's estimator."""

    def __init__(
        self, settings: Settings, filter_name: str = "eskf", outputs: Outputs | None = None
    ) -> None:
        self.settings = settings
        self._outputs = outputs or Outputs()
        self._filter_name = filter_name
        self.filter: Filter = self._make_filter()
        self._buffer_us = round(settings.estimator.buffer * 1e6)
        self._imu_delay_us = round(settings.imu.delay * 1e6)
        self._rotation = turn_of(settings.imu.rotation)
        self._wanted_origin: Origin | None = None
        self.frame: TangentFrame | None = None
        self.statistics: dict[str, AidingStatistics] = {}
        self.dropped: Counter[str] = Counter()
        self.imu_rows = 0
        self.realignments = 0
        self.loss = ""
        self._resets_before = 0
        self._measuring = Measuring(settings, self.filter.layout.blocks)
        self._aligner = Aligner(settings, self._measuring.compass)
        self._still = still_detector(settings.zero_velocity)
        self._yaw_watch = YawWatch()
        self._line = self._new_line()
        self.health = Health.WAITING
        self.reason = "waiting for IMU and GNSS"

    # ---- what is known -----------------------------------------------------------------------------------------

    @property
    def running(self) -> bool:
        """True while there is an estimate."""
        return self._line.state is not None

    @property
    def reset_counter(self) -> int:
        """Rises by one at every jump of the estimate."""
        return self._resets_before + self._line.fusion.track.resets

    @property
    def t_us(self) -> int | None:
        """The newest IMU stamp, or None."""
        return self._line.buffer.newest_us if len(self._line.buffer) else None

    @property
    def standing(self) -> bool | None:
        """True until the first motion, False at a speed, else None: a hover looks as a landed vehicle does."""
        standing, state = self._aligner.standing, self._line.state
        if standing.standing:
            return True
        if state is None or not standing.moved:
            return None
        limit = self.settings.zero_velocity.speed_limit
        return False if float(np.linalg.norm(state.x[3:6])) > limit else None

    def yaw_from_motion(self) -> tuple[float, float] | None:
        """(yaw in l, sigma) in rad that IMU and GNSS velocities show without any heading; None where they do not."""
        buffer = self._line.buffer
        seen = self._aligner.motion.at(buffer, buffer.newest_us) if len(buffer) else None
        return (seen.yaw, seen.sigma) if seen is not None and seen.trusted else None

    def imu_after(self, t_us: int) -> tuple[IntArray, FloatArray]:
        """The IMU rows of the last second that are newer than t_us: stamps (N,) and [gyro_b, accel_b] (N, 6), views."""
        buffer = self._line.buffer
        first = buffer.row_after(t_us)
        return buffer.times(first, buffer.end), buffer.readings(first, buffer.end)

    def solution(self) -> NavSolution | None:
        """The estimate at the newest IMU stamp, or None before `running`."""
        state = self._line.state
        if state is None or self.frame is None:
            return None
        layout = self.filter.layout
        return solution_of(state, layout, self.frame, self.health, self.reset_counter)

    # ---- what comes in -----------------------------------------------------------------------------------------

    def set_origin(self, origin: Origin) -> None:
        """Put the origin of n here; a running estimate is carried over to the new frame."""
        self._wanted_origin = origin
        if self.frame is None:
            return
        new = self.frame = TangentFrame.at(origin)
        if self.running:
            self._resets_before += 1
            self._decide(self._line.change_frame(new))

    def reconfigure(self, settings: Settings, filter_name: str = "") -> None:
        """Go on with other settings, and another filter if one is named; what only a start can change stays as it is.

        A filter that has to be made anew takes state and covariance over; decisions that are open end here.
        """
        old, new = self.settings, applicable(self.settings, settings)
        replaced = filter_name not in ("", self._filter_name)
        self.settings = new
        self._filter_name = filter_name or self._filter_name
        self._measuring.reconfigure(new, delay_told(old, new))
        self._aligner.reconfigure(new, self._measuring.compass)
        if old.zero_velocity != new.zero_velocity:
            self._still = still_detector(new.zero_velocity)
        if replaced or needs_filter(old, new):
            self.filter = self._make_filter()
            self._decide(self._line.change_filter(Fusion(self.filter, new.gnss.reset_after)))

    def restart(self, reason: str) -> None:
        """Forget all samples and the estimate (the vehicle has rebooted); the origin stays."""
        self._lost(reason, Health.WAITING)

    def calibrate(self, reason: str) -> bool:
        """Learn the gyro's biases and the attitude anew, where the vehicle stands; False in motion."""
        if self.running and not self._aligner.standing.standing:
            return False
        self.restart(reason)
        return True

    def feed_imu(self, table: ImuTable) -> None:
        """Take IMU samples in the order of their arrival."""
        self.feed_run(table, ())

    def feed_run(self, table: ImuTable, between: Sequence[Between]) -> None:
        """Take IMU samples and readings by turns, in the order of their arrival.

        `between` are readings, each with the number of samples that came before it. The outcome is that of feeding
        them one after the other.
        """
        t_us, imu = to_body(table, self._imu_delay_us, self._rotation)
        max_gap_us = round(self.settings.estimator.max_gap * 1e6)
        start, n, k = 0, len(t_us), 0
        while start < n:
            newest, first = self.t_us, int(t_us[start])
            if newest is not None and not newest < first <= newest + max_gap_us:
                # what came before such a sample must be in first
                while k < len(between) and between[k][0] <= start:
                    self._take_reading(between[k][1])
                    k += 1
                newest = self.t_us
            if newest is not None and first <= newest:
                self._late_sample(first, imu[start])
                start += 1
                continue
            end = run_end(t_us, start, -1 if newest is None else newest, max_gap_us)
            if newest is not None and first - newest > max_gap_us:
                self._lost(f"IMU gap of {(first - newest) * 1e-6:.1f} s", Health.ALIGNING)
            came = k
            while k < len(between) and between[k][0] < end:
                k += 1
            arrivals = self._arrivals(between[came:k], start) if k > came else ()
            self._take_rows(t_us[start:end], imu[start:end], newest, arrivals)
            start = end
        for _, reading in between[k:]:
            self._take_reading(reading)

    def _arrivals(self, between: Sequence[Between], start: int) -> Arrivals:
        """Readings as measurements, with the number of rows from `start` on that came before each."""
        made = ((max(0, rows - start), self._measurement(reading)) for rows, reading in between)
        return [(rows, m) for rows, m in made if m is not None]

    def feed_gnss(self, fix: GnssFix) -> None:
        """Take a GNSS fix."""
        measuring, settings = self._measuring, self.settings.gnss
        self._begin_delay(fix)
        state, frame = self._line.state, self.frame
        t_us, delay = measuring.fix_time(fix, state, frame, self._line.buffer)
        quality, noise = objection(fix, settings), noise_of(fix, settings)
        if not quality:
            speed = gnss_speed(fix)
            if not math.isnan(speed):
                self._aligner.standing.see_speed(speed, t_us)
            measuring.barometer.see_fix(t_us, fix.alt, noise.v)
        self._aligner.see_fix(fix, t_us)
        if state is not None and frame is not None:
            self._take(*measuring.of_fix(fix, t_us, frame, noise, quality, delay))

    def _begin_delay(self, fix: GnssFix) -> None:
        """Estimate the delay anew, from this fix's on, where another one has been told."""
        state, frame = self._line.state, self.frame
        if state is None or frame is None or not self._measuring.begins_delay(fix):
            return
        sigma = self.settings.states.gnss_delay_sigma
        begin_delay(state, self.filter.layout, fix.delay, sigma)
        self._decide(self._line.change_frame(frame))

    def feed_heading(self, fix: HeadingFix) -> None:
        """Take a heading."""
        self._take_reading(fix)

    def feed_mag(self, sample: MagSample) -> None:
        """Take a reading of a magnetometer."""
        self._take_reading(sample)

    def feed_baro(self, sample: BaroSample) -> None:
        """Take a barometric altitude."""
        self._take_reading(sample)

    def flush(self) -> None:
        """Hand over the output rows that are held."""
        self._line.flush()

    def finish(self) -> None:
        """No more input: hand over the rows that are held and the decisions that are still open."""
        self._line.flush()
        self._decide(self._line.end())

    # ---- on the time line --------------------------------------------------------------------------------------

    def _make_filter(self) -> Filter:
        s = self.settings
        return make(self._filter_name, imu_noise(s), s.states.layout(), s.filters)

    def _new_line(self) -> Timeline:
        fusion = Fusion(self.filter, self.settings.gnss.reset_after)
        outputs = self._outputs
        return Timeline(
            self.filter,
            fusion,
            self._buffer_us,
            outputs.grid_us,
            outputs.rows,
            outputs.history,
        )

    def _take_rows(
        self, t_us: IntArray, imu: FloatArray, newest: int | None, arrivals: Arrivals
    ) -> None:
        """Append rows, of which only the last may have passed a tick, and move the estimate through them."""
        self.imu_rows += len(t_us)
        refused = self._line.append(t_us, imu, arrivals)
        if refused:
            self._decide(refused)
        self._check_sanity()
        last = int(t_us[-1])
        before = newest if len(t_us) == 1 else int(t_us[-2])
        if before is not None and last // TICK_US != before // TICK_US:
            self._tick(last)

    def _late_sample(self, t_us: int, reading: FloatArray) -> None:
        """A sample older than the newest: a repetition is dropped, another is put in its place."""
        reason = self._line.insert(t_us, reading)
        if reason:
            self.dropped[reason] += 1
        else:
            self.imu_rows += 1
            self._check_sanity()

    def _take_reading(self, reading: Reading) -> None:
        measurement = self._measurement(reading)
        if measurement is not None:
            self._take(measurement)

    def _measurement(self, reading: Reading) -> Measurement | None:
        """What a reading says to the filter; before there is an estimate it goes to the aligner."""
        if self.running and self.frame is not None:
            return self._measuring.of(reading, self.frame)
        match reading:
            case HeadingFix():
                self._aligner.see_heading(reading, self._measuring.heading_time(reading))
            case MagSample():
                direction_b = self._measuring.compass.direction_b(reading)
                if direction_b is not None:
                    self._aligner.see_field(direction_b, self._measuring.field_time(reading))
            case BaroSample():
                self._measuring.barometer.altitude(reading)
        return None

    def _take(self, *measurements: Measurement) -> None:
        """Fuse measurements where they belong."""
        refused = self._line.take(measurements)
        if refused:
            self._decide(refused)
        self._check_sanity()

    # ---- decisions and health ----------------------------------------------------------------------------------

    def _tick(self, now_us: int) -> None:
        """What is looked at a few times a second."""
        asked = not self.running or self._yaw_watch.doubts
        self._aligner.tick(self._line.buffer, now_us, asked)
        if not self.running:
            self._try_to_align(now_us)
        else:
            self._zero_velocity(now_us)
            self._habits(now_us)
            self._judge_health(now_us)
            self._watch_yaw(now_us)
        window_us = round(self.settings.alignment.window * 1e6)
        self._decide(self._line.prune(now_us, window_us))

    def _zero_velocity(self, now_us: int) -> None:
        settings, frame = self.settings.zero_velocity, self.frame
        if not settings.enabled or frame is None:
            return
        measurements = []
        for t_us, gyro_b in self._stills(now_us):
            gate, noise = settings.gate, settings.rate_sigma
            measurements.append(zero_velocity.measure(now_us, t_us, settings.sigma, gate))
            if settings.rate:
                measurements.append(zero_rate.measure(now_us, t_us, gyro_b, frame, noise, gate))
        if measurements:
            self._take(*measurements)

    def _stills(self, now_us: int) -> list[Still]:
        """The instants since the last tick at which the vehicle stood."""
        standing = self._aligner.standing
        if self._still is not None:
            assert self.frame is not None
            return self._still.tick(self._line.buffer, now_us, self.frame, standing)
        # valid a window ago: the samples since then have confirmed that nothing moved
        return [Still(now_us - HALF_WINDOW_US, standing.gyro_b)] if standing.standing else []

    def _habits(self, now_us: int) -> None:
        """What is known of the motion without a sensor for it, where it is switched on."""
        frame, buffer = self.frame, self._line.buffer
        assert frame is not None
        for measurement in (
            gravity_tilt_at(now_us, buffer, frame, self.settings.gravity_tilt),
            nonholonomic_at(now_us, self.settings.nonholonomic),
        ):
            if measurement is not None and self.running:
                self._take(measurement)

    def _judge_health(self, now_us: int) -> None:
        # looked at here, not after every call: it must not depend on how many rows a call brought
        state = self._line.state
        if state is None:
            return
        track = self._line.fusion.track
        complaint = self.filter.complaint(state)
        health, reason = judged(state, track, now_us, self.settings.estimator, complaint)
        if health == Health.DIVERGED:
            self._lost(reason, health)
        else:
            self.health, self.reason = health, reason

    def _watch_yaw(self, now_us: int) -> None:
        """Start anew, on the way, where motion shows another yaw than the filter's and GNSS agrees with it."""
        state, frame, track = self._line.state, self.frame, self._line.fusion.track
        if state is None or frame is None or not self._yaw_watch.doubts:
            return
        buffer, aligner = self._line.buffer, self._aligner
        candidate = aligner.from_motion(buffer, now_us, self._buffer_us)
        seen = aligner.motion.at(buffer, state.t_us)
        if candidate is None or seen is None:
            return
        event = self._yaw_watch.contradiction(self.filter, state, frame, seen)
        if event is None:
            return
        resets = (*track.reset_times_us[-7:], now_us)
        self._begin(candidate, Track(resets=track.resets + 1, reset_times_us=resets))
        self._yaw_watch.calm()
        self.reason = event.reason
        self._decide([event])

    def _check_sanity(self) -> None:
        state = self._line.state
        if state is None:
            return
        if not is_sane(state.x, state.P):
            self._lost("the estimate is not finite", Health.DIVERGED)

    def _lost(self, reason: str, health: Health) -> None:
        """Give the samples and the estimate up and begin anew; the origin stays."""
        had_estimate = self.running
        self._resets_before = self.reset_counter + had_estimate
        self.realignments += had_estimate
        self.loss = reason if had_estimate else self.loss
        self.finish()
        self._aligner = Aligner(self.settings, self._measuring.compass)
        self._yaw_watch.calm()
        self._line = self._new_line()
        self.health = health
        self.reason = reason

    def _decide(self, events: Iterable[Event]) -> None:
        """Count and write final decisions."""
        for event in events:
            m = event.measurement
            self._yaw_watch.see(event)
            statistics = self.statistics.get(m.aiding)
            if statistics is None:
                statistics = self.statistics[m.aiding] = AidingStatistics()
            statistics.add(event, gate_threshold(m.gate, len(m.z)))
            if self._outputs.decision is not None:
                self._outputs.decision(event)

    # ---- alignment ---------------------------------------------------------------------------------------------

    def _try_to_align(self, now_us: int) -> None:
        candidate = self._aligner.candidate(self._line.buffer, now_us, self._buffer_us)
        if isinstance(candidate, str):
            if self.health != Health.DIVERGED or self._aligner.gate.good:
                waiting = not self._aligner.gate.good
                self.health = Health.WAITING if waiting else Health.ALIGNING
                self.reason = candidate
            return
        self._begin(candidate, Track())

    def _begin(self, candidate: Candidate, track: Track) -> None:
        """Start at the valid time of the newest good fix and walk to now; `track` says what was before."""
        fix = candidate.fix
        if self.frame is None:
            self.frame = TangentFrame.at(self._wanted_origin or Origin(fix.lat, fix.lon, fix.alt))
        x, P = self._aligner.start(
            candidate, self.frame, self.filter.layout, self._measuring.heading_sigma
        )
        self._measuring.start(fix)
        reading = self._line.buffer.reading_at(candidate.t_us)
        state = FilterState(x, P, reading, candidate.t_us)
        self.filter.adopt(state)
        if complaint := self.filter.complaint(state):
            self.reason = complaint
            return
        self.health = Health.RUNNING
        self.reason = ""
        self._line.begin(
            state,
            self.frame,
            track._replace(accepted_us=(candidate.t_us,) * 3),
        )
        self._check_sanity()
