"""The estimator: the only path to a filter. Samples and measurements go in as they arrive, estimates come out.

It makes measurements out of fixes, aligns, watches over health and resets, and leaves the order of time to the
time line. The outcome depends on content and order of arrival alone, never on how many IMU rows were handed over
at a time.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from mavins.aiding import (
    Measurement,
    baro,
    gnss_position,
    gnss_velocity,
    heading,
    magnetometer,
    zero_rate,
    zero_velocity,
)
from mavins.aiding.detectors import gnss_speed
from mavins.estimator.aligner import Aligner, Candidate
from mavins.estimator.barometer import Barometer
from mavins.estimator.compass import Compass
from mavins.estimator.fusion import Event, Fusion, Track
from mavins.estimator.gate import gate_threshold
from mavins.estimator.history import History
from mavins.estimator.imu_rows import TICK_US, run_end, to_body, turn_of
from mavins.estimator.latency import delay_parameters
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
from mavins.estimator.timeline import Timeline
from mavins.estimator.yaw_watch import YawWatch
from mavins.filters import Filter, FilterState, RowBlock, make
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import X_TAU
from mavins.nav.linalg import is_sane
from mavins.nav.so3 import dcm_to_quat, quat_to_dcm
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
)

RESETS_TO_DIVERGE = 3
DIVERGE_WITHIN_US = 60_000_000
_NOTHING = np.empty(0)
YAW_SILENT_US = 5_000_000
YAW_SIGMA = math.radians(8.0)
"""Without a heading for this long and with a larger sigma, the status says that yaw is not observable."""


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
        self._first_delay = 0.0
        self._compass = Compass(settings.magnetometer)
        self._barometer = Barometer(settings.baro)
        self._aligner = Aligner(settings, self._compass)
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
        old, new = self.frame, TangentFrame.at(origin)
        self.frame = new
        if self._line.state is not None:
            _carry_over(self._line.state, old, new)
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
        if old.magnetometer != new.magnetometer:
            self._compass = Compass(new.magnetometer)
        self._barometer.settings = new.baro
        self._aligner.reconfigure(new, self._compass)
        if delay_told(old, new):
            self._first_delay = math.nan
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
        t_us, imu = to_body(table, self._imu_delay_us, self._rotation)
        max_gap_us = round(self.settings.estimator.max_gap * 1e6)
        start, n = 0, len(t_us)
        while start < n:
            newest = self.t_us
            first = int(t_us[start])
            if newest is not None and first <= newest:
                self._late_sample(first, imu[start])
                start += 1
                continue
            end = run_end(t_us, start, -1 if newest is None else newest, max_gap_us)
            if newest is not None and first - newest > max_gap_us:
                self._lost(f"IMU gap of {(first - newest) * 1e-6:.1f} s", Health.ALIGNING)
            self._take_rows(t_us[start:end], imu[start:end], newest)
            start = end

    def feed_gnss(self, fix: GnssFix) -> None:
        """Take a GNSS fix."""
        t_us, delay = self._valid_time(fix)
        quality = objection(fix, self.settings.gnss)
        speed = gnss_speed(fix)
        if not quality and not math.isnan(speed):
            self._aligner.standing.see_speed(speed)
        settings = self.settings.gnss
        noise = noise_of(fix, settings)
        if not quality:
            self._barometer.see_fix(t_us, fix.alt, noise.v)
        self._aligner.see_fix(fix, t_us)
        if not self.running or self.frame is None:
            return
        self._take(
            gnss_position.measure(
                fix, t_us, self.frame, noise.h, noise.v, settings.gate, quality, delay[:1]
            )
        )
        velocity = gnss_velocity.measure(
            fix, t_us, self.frame, noise.speed, settings.gate, quality, delay
        )
        if velocity is not None:
            self._take(velocity)

    def _valid_time(self, fix: GnssFix) -> tuple[int, FloatArray]:
        """When a fix was valid; where the delay is estimated, also what its measurements need (latency.py).

        What one fix's delay is said to differ from another's stays; the estimate is of what they have in common.
        """
        state = self._line.state
        if state is None or self.frame is None or "tau" not in self.filter.layout.blocks:
            return fix.t_us - round(fix.delay * 1e6), _NOTHING
        if math.isnan(self._first_delay):
            self._first_delay = fix.delay
            sigma = self.settings.states.gnss_delay_sigma
            begin_delay(state, self.filter.layout, fix.delay, sigma)
            self._decide(self._line.change_frame(self.frame))
        delay = float(state.x[X_TAU]) + fix.delay - self._first_delay
        t_us = fix.t_us - round(delay * 1e6)
        return t_us, delay_parameters(state, self.frame, self._line.buffer, t_us)

    def feed_heading(self, fix: HeadingFix) -> None:
        """Take a heading."""
        t_us = fix.t_us - round(fix.delay * 1e6)
        if not self.running or self.frame is None:
            self._aligner.see_heading(fix, t_us)
            return
        sigma = self.heading_sigma(fix)
        self._take(heading.measure(fix, t_us, self.frame, sigma, self.settings.heading.gate))

    def heading_sigma(self, fix: HeadingFix) -> float:
        """The 1-sigma noise (rad) taken for a heading."""
        return fix.sigma if fix.sigma is not None else math.radians(self.settings.heading.sigma_deg)

    def feed_mag(self, sample: MagSample) -> None:
        """Take a reading of a magnetometer."""
        direction_b = self._compass.direction_b(sample)
        if direction_b is None:
            return
        settings = self.settings.magnetometer
        t_us = sample.t_us - round(settings.delay * 1e6)
        if not self.running or self.frame is None:
            self._aligner.see_field(direction_b, t_us)
            return
        field_n = self._compass.reference_n(self.frame)
        self._take(
            magnetometer.measure(
                sample.source,
                sample.t_us,
                t_us,
                direction_b,
                field_n,
                settings.sigma,
                settings.gate,
            )
        )

    def feed_baro(self, sample: BaroSample) -> None:
        """Take a barometric altitude."""
        level = self._barometer.altitude(sample)
        if level is None or not self.running or self.frame is None:
            return
        settings = self.settings.baro
        t_us = sample.t_us - round(settings.delay * 1e6)
        self._take(
            baro.measure(
                sample.t_us, t_us, level[0], self.frame, level[1], settings.gate, sample.source
            )
        )

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

    def _take_rows(self, t_us: IntArray, imu: FloatArray, newest: int | None) -> None:
        """Append rows, of which only the last may have passed a tick, and move the estimate through them."""
        self.imu_rows += len(t_us)
        self._line.append(t_us, imu)
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

    def _take(self, measurement: Measurement) -> None:
        """Fuse a measurement where it belongs."""
        refused = self._line.take(measurement)
        if refused is not None:
            self._decide([refused])
        self._check_sanity()

    # ---- decisions and health ----------------------------------------------------------------------------------

    def _tick(self, now_us: int) -> None:
        """What is looked at a few times a second."""
        self._aligner.tick(self._line.buffer, now_us)
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
        settings, standing = self.settings.zero_velocity, self._aligner.standing
        if not settings.enabled or not standing.standing or self.frame is None:
            return
        # valid a window ago: the samples since then have confirmed that nothing moved
        t_us, gate = now_us - HALF_WINDOW_US, settings.gate
        self._take(zero_velocity.measure(now_us, t_us, settings.sigma, gate))
        self._take(
            zero_rate.measure(now_us, t_us, standing.gyro_b, self.frame, settings.rate_sigma, gate)
        )

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
        state = self._line.state
        if state is None:
            return
        track = self._line.fusion.track
        gnss_us = max(track.accepted_us[0], track.accepted_us[1])
        silent = (now_us - gnss_us) * 1e-6
        lately = [t for t in track.reset_times_us if now_us - t < DIVERGE_WITHIN_US]
        # looked at here, not after every call: it must not depend on how many rows a call brought
        if complaint := self.filter.complaint(state):
            self._lost(complaint, Health.DIVERGED)
        elif len(lately) >= RESETS_TO_DIVERGE:
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
            self.reason = _yaw_remark(state, track, now_us)

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
        self._aligner = Aligner(self.settings, self._compass)
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
        x, P = self._aligner.start(candidate, self.frame, self.filter.layout, self.heading_sigma)
        self._first_delay = fix.delay
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


def _yaw_remark(state: FilterState, track: Track, now_us: int) -> str:
    """A word where the heading is on its own: no heading for some seconds, and its sigma has grown."""
    sigma = math.sqrt(float(state.P[8, 8]))
    silent_us = now_us - track.accepted_us[heading.RANK]
    if silent_us <= YAW_SILENT_US or sigma <= YAW_SIGMA:
        return ""
    return f"yaw not observable (sigma {math.degrees(sigma):.0f} deg): no heading, no acceleration"


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
