"""The true motion: position, attitude and all that follows from them, exact at any time.

Position and attitude are B-splines of time; velocity, acceleration and rates are their derivatives,
so a perfect INS that integrates `inertial` comes back to `at`. A cycle stands, moves, returns and
stands; time runs on through cycle after cycle. Vectors are in the tangent frame n at the scenario's
origin, or in b.
Theory: docs/theory/mechanization.md.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal, TypeAlias

import numpy as np
from annotated_types import Len
from pydantic import Field

from mavins.errors import ScenarioError
from mavins.nav.earth import TangentFrame
from mavins.nav.rotations import euler_to_quats, quats_to_dcms, rates_of
from mavins.types import FloatArray, Origin
from sitl.frames import gravity_along, to_local_level
from sitl.plan import Segment, commanded
from sitl.settings import Positive, Settings
from sitl.spline import UniformSpline, quintic, sharpen

POSITION_DEGREE: Final = 7
ATTITUDE_DEGREE: Final = 5
POSITION_SPACING: Final = 0.25
ATTITUDE_SPACING: Final = 0.1
# how many neighbours of a control point its curve feels, and one more where `sharpen` spreads it
REACH: Final = (POSITION_DEGREE - 1) // 2
ATTITUDE_LEAD: Final = ATTITUDE_SPACING * (ATTITUDE_DEGREE + 3) / 2


@dataclass(frozen=True, slots=True)
class Plan(Settings):
    """A multicopter's flight: it stands, flies its segments and stands again where it began.

    `yaw_deg` is the heading at rest, `stand` the seconds at rest before the motion.
    """

    kind: Literal["plan"]
    segments: Annotated[tuple[Segment, ...], Len(1)]
    yaw_deg: float = 0.0
    stand: Positive = 6.0


@dataclass(frozen=True, slots=True)
class Track(Settings):
    """A recorded flight: it stands, gathers speed into the record, flies it and comes back.

    `file` is a CSV of time_s,north_m,east_m,height_m,roll_deg,pitch_deg,yaw_deg at even times, the
    yaw unwrapped. `run_up` and `come_back` are the seconds from rest into the record and back.
    """

    kind: Literal["track"]
    file: str
    run_up: Positive = 12.0
    come_back: Positive = 90.0
    stand: Positive = 6.0


Motion: TypeAlias = Annotated[Plan | Track, Field(discriminator="kind")]


@dataclass(frozen=True, slots=True)
class Kinematics:
    """The true motion at times t (N,), s from the start: p_n, v_n, a_n (N, 3), q_nb (N, 4).

    `w_nb_b` (N, 3) in rad/s is the rate of b relative to n, in b. The sign of q_nb is either.
    """

    t: FloatArray
    p_n: FloatArray
    v_n: FloatArray
    a_n: FloatArray
    q_nb: FloatArray
    w_nb_b: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """A periodic motion in the tangent frame `frame`; `period` in s is a whole number."""

    frame: TangentFrame
    period: float
    position: UniformSpline
    attitude: UniformSpline

    def at(self, t: FloatArray) -> Kinematics:
        """The motion at times t (N,) in s; p, v, a and q, w are exact derivatives of each other."""
        phase = np.mod(t, self.period)
        s, s_dot = self.attitude(phase), self.attitude(phase, 1)
        return Kinematics(
            t=t,
            p_n=self.position(phase),
            v_n=self.position(phase, 1),
            a_n=self.position(phase, 2),
            q_nb=s / np.sqrt(np.einsum("ni,ni->n", s, s))[:, None],
            w_nb_b=rates_of(s, s_dot),
        )

    def inertial(self, k: Kinematics) -> tuple[FloatArray, FloatArray]:
        """What ideal sensors read: (w_ib_b (N, 3) in rad/s, f_b (N, 3) in m/s^2).

        w_ib_b = w_nb_b + C_bn w_ie_n,  f_b = C_bn (a_n - g_n(p) + 2 w_ie_n x v_n).
        """
        w_ie_n = self.frame.w_ie_n
        C_nb = quats_to_dcms(k.q_nb)
        g_n = gravity_along(k.p_n, self.frame.r0_e, self.frame.C_ne)
        f_n = k.a_n - g_n + 2.0 * np.cross(w_ie_n, k.v_n)
        f_b = np.einsum("nij,ni->nj", C_nb, f_n)
        return k.w_nb_b + np.einsum("nij,i->nj", C_nb, w_ie_n), f_b

    def local_level(self, k: Kinematics) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The motion in the local level frame there: lla (N, 3), v_l (N, 3), q_lb (N, 4)."""
        C_ne = self.frame.C_ne
        return to_local_level(self.frame.r0_e + k.p_n @ C_ne, k.v_n, k.q_nb, C_ne)

    def increments(
        self, begin: FloatArray, dt: float, nodes: int = 5
    ) -> tuple[FloatArray, FloatArray]:
        """The integrals of w_ib_b (rad) and f_b (m/s) over [begin, begin + dt], (N, 3) each.

        Gauss-Legendre quadrature; five nodes leave less than 1e-12 over 10 ms.
        """
        x, weight = np.polynomial.legendre.leggauss(nodes)
        t = begin[:, None] + 0.5 * dt * (x + 1.0)
        w, f = self.inertial(self.at(t.ravel()))
        shape = (len(begin), nodes, 3)
        half = 0.5 * dt * weight
        return (
            np.einsum("k,nki->ni", half, w.reshape(shape)),
            np.einsum("k,nki->ni", half, f.reshape(shape)),
        )


@functools.lru_cache(maxsize=16)
def build(motion: Plan | Track, origin: Origin) -> Trajectory:
    """The trajectory of a motion from `origin`; ScenarioError where it cannot be flown."""
    if isinstance(motion, Plan):
        return _of_plan(motion, origin)
    return _of_track(motion, origin)


def _of_plan(plan: Plan, origin: Origin) -> Trajectory:
    """Smooth the commanded poses, and tilt the vehicle so that its thrust accelerates it so."""
    h = POSITION_SPACING
    poses = commanded(plan.segments, h)
    poses, period = _at_rest_around(poses, h, plan.stand, REACH)
    pose = UniformSpline.through(poses, h, POSITION_DEGREE, 2)
    t = _attitude_times(period)
    yaw = pose(t)[:, 3] + math.radians(plan.yaw_deg)
    frame = TangentFrame.at(origin)
    gravity = gravity_along(np.zeros((1, 3)), frame.r0_e, frame.C_ne)[0, 2]
    euler = tilt(pose(t, 2)[:, :3], yaw, gravity)
    position = UniformSpline.through(poses[:, :3].copy(), h, POSITION_DEGREE, 2)
    return _with_attitude(frame, period, position, euler)


def _of_track(track: Track, origin: Origin) -> Trajectory:
    """Lead from rest into the record, and from its end back to rest, by quintics of time."""
    t, poses = read_track(Path(track.file))
    h = float(t[1] - t[0])
    first, last = poses[0], poses[-1]
    v_first, v_last = (poses[1] - poses[0]) / h, (poses[-1] - poses[-2]) / h
    still = np.zeros(6)
    rest = first - 0.5 * track.run_up * v_first
    rest[3:] = [0.0, first[4], first[5]]
    home = rest.copy()
    home[5] += 2.0 * math.pi * np.round((last[5] - rest[5]) / (2.0 * math.pi))
    up = quintic(math.ceil(track.run_up / h), h, (rest, still), (first, v_first))
    back = quintic(math.ceil(track.come_back / h), h, (last, v_last), (home, still))
    way = np.concatenate([rest[None, :], up, poses, back, home[None, :]])
    # from the place of rest, where the numbers are then 0 to the last bit
    path, period = _at_rest_around(way - rest, h, track.stand, REACH + 1)
    curve = UniformSpline.through(sharpen(path, POSITION_DEGREE), h, POSITION_DEGREE, 0)
    t = _attitude_times(period)
    controls = sharpen(path[:, :3], POSITION_DEGREE)
    position = UniformSpline.through(controls, h, POSITION_DEGREE, 2)
    return _with_attitude(TangentFrame.at(origin), period, position, curve(t)[:, 3:] + rest[3:])


def _attitude_times(period: float) -> FloatArray:
    return ATTITUDE_SPACING * np.arange(period / ATTITUDE_SPACING + 0.5, dtype=np.float64)


def _with_attitude(
    frame: TangentFrame, period: float, position: UniformSpline, euler: FloatArray
) -> Trajectory:
    quats = sharpen(euler_to_quats(euler), ATTITUDE_DEGREE)
    attitude = UniformSpline.through(quats, ATTITUDE_SPACING, ATTITUDE_DEGREE, 1)
    return Trajectory(frame, period, position, attitude)


def _at_rest_around(
    poses: FloatArray, h: float, stand: float, reach: int
) -> tuple[FloatArray, float]:
    """The poses with rest around them, so that the curve stands `stand` s, and the whole period."""
    lead = reach * h + ATTITUDE_LEAD
    before = math.ceil((stand + lead) / h)
    period = math.ceil((before + len(poses)) * h + lead)
    after = round(period / h) + 1 - before - len(poses)
    ends = poses[:1].repeat(before, 0), poses[-1:].repeat(after, 0)
    return np.concatenate([ends[0], poses, ends[1]]), float(period)


def tilt(a_n: FloatArray, yaw: FloatArray, gravity: float) -> FloatArray:
    """[roll, pitch, yaw] (N, 3) of a multicopter whose thrust, along -z_b, gives a_n (N, 3).

    -f_n / |f_n| = z_b = Rz(yaw) [sin(pitch) cos(roll), -sin(roll), cos(pitch) cos(roll)] with
    f_n = a_n - g_n.
    """
    z = np.array([0.0, 0.0, gravity]) - a_n
    z = z / np.linalg.norm(z, axis=1)[:, None]
    ahead = np.cos(yaw) * z[:, 0] + np.sin(yaw) * z[:, 1]
    right = np.cos(yaw) * z[:, 1] - np.sin(yaw) * z[:, 0]
    return np.column_stack([np.arcsin(-right), np.arctan2(ahead, z[:, 2]), yaw])


def read_track(file: Path) -> tuple[FloatArray, FloatArray]:
    """Times (M,) and [north, east, down, roll, pitch, yaw] (M, 6) in m and rad of a track's CSV."""
    try:
        rows = np.loadtxt(file, delimiter=",", skiprows=1, ndmin=2)
    except (OSError, ValueError) as error:
        raise ScenarioError(f"motion.file: cannot read the track {file}: {error}") from error
    steps = np.diff(rows[:, 0])
    if rows.shape[0] < 3 or rows.shape[1] != 7 or np.ptp(steps) > 1e-6 or 1.0 % steps[0] > 1e-6:
        raise ScenarioError(
            f"motion.file: {file} must have rows of time_s,north_m,east_m,height_m,"
            "roll_deg,pitch_deg,yaw_deg at even times, a whole number of them each second"
        )
    poses = rows[:, 1:] * [1.0, 1.0, -1.0, *[math.pi / 180.0] * 3]
    return rows[:, 0], poses
