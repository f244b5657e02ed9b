"""The flight as MCAP with Foxglove's schemas: pose, odometry, location, transforms, innovations and a log.

Frames: `map` (east, north, up at the origin), in it `n` (north, east, down), in that `body` (forward, right, down).
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from functools import partial
from heapq import merge
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from mavins.estimates import Estimates, Innovations, Result
from mavins.exports.places import attitude_in_n, in_degrees, utc_offset_us
from mavins.nav.so3 import quat_to_dcm
from mavins.types import FloatArray

FILES: Final = ("flight.mcap",)
NEEDS: Final = ("foxglove",)
INNOVATION: Final = {
    "title": "mavins.Innovation",
    "description": "The final decision on a measurement",
    "type": "object",
    "properties": {
        "timestamp": {
            "title": "time",
            "type": "object",
            "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
        },
        "source": {"type": "string", "description": "the message it came from"},
        "accepted": {"type": "boolean"},
        "reason": {"type": "string", "description": "why it was not accepted"},
        "nis": {"type": ["number", "null"], "description": "normalized innovation squared"},
        "innovation": {
            "type": "array",
            "items": {"type": "number"},
            "description": "measured minus predicted, in SI units",
        },
        "sigma": {
            "type": "array",
            "items": {"type": "number"},
            "description": "what the innovation was expected to be, 1-sigma",
        },
    },
}
"""The JSON schema of /innovations/<aiding>."""
_HALF: Final = float(np.sqrt(0.5))
_SELDOM_US: Final = 100_000
"""Poses come with every estimate; what says the same and more comes no more often than this."""
_Log = tuple[int, Callable[[int], object]]
"""Nanoseconds, and what logs a message at them."""


def write(result: Result, folder: Path) -> None:
    """Write flight.mcap; its times are UTC where the vehicle told it, else they count from boot."""
    import foxglove

    context = foxglove.Context()
    with (folder / FILES[0]).open("wb") as file:
        guarded = _Guarded(file)
        with foxglove.open_mcap(guarded, context=context) as writer:
            writer.write_metadata("mavins", _metadata(result))
            for ns, log in _Messages(result, context).in_order():
                log(ns)
                guarded.check()
        guarded.check()


class _Guarded:
    """A file that remembers why it could not be written: the writer is not Python, and keeps that to itself."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._error: OSError | None = None

    def seek(self, offset: int, whence: int = 0) -> int:
        return self._file.seek(offset, whence)

    def write(self, data: bytes | bytearray) -> int:
        try:
            return self._file.write(data)
        except OSError as error:
            self._error = error
            raise

    def flush(self) -> None:
        try:
            self._file.flush()
        except OSError as error:
            self._error = error
            raise

    def check(self) -> None:
        """OSError where something could not be written."""
        if self._error is not None:
            raise self._error


def _metadata(result: Result) -> dict[str, str]:
    words = {key: str(result.summary.get(key, "")) for key in ("mavins", "log", "filter")}
    told = utc_offset_us(result) is not None
    return words | {"time": "UTC" if told else "since boot"}


class _Messages:
    """What a result has to say, by instants."""

    def __init__(self, result: Result, context: Any) -> None:
        from foxglove import channels, messages

        self._result = result
        self._context = context
        self._channels, self._messages = channels, messages
        self._offset_us = utc_offset_us(result) or 0

    def in_order(self) -> Iterator[_Log]:
        """Everything, in the order of time."""
        aidings = (self._innovations(*item) for item in self._result.innovations.items())
        sources = (self._estimates(), self._fixes(), *aidings, self._remarks())
        return merge(*sources, key=lambda item: item[0])

    def _ns(self, t_us: int) -> int:
        return (int(t_us) + self._offset_us) * 1000

    def _stamp(self, ns: int) -> Any:
        return self._messages.Timestamp(ns // 1_000_000_000, ns % 1_000_000_000)

    def _vector(self, v: FloatArray) -> Any:
        x, y, z = v.tolist()
        return self._messages.Vector3(x=x, y=y, z=z)

    def _estimates(self) -> Iterator[_Log]:
        """Every estimate as a pose; some as odometry with sigmas, as a place on Earth, and as a transform."""
        m, c, context, e = self._messages, self._channels, self._context, self._result
        poses = c.PoseInFrameChannel("/estimate/pose", context=context)
        odometry = c.OdometryChannel("/estimate/odometry", context=context)
        locations = c.LocationFixChannel("/estimate/location", context=context)
        transforms = c.FrameTransformChannel("/tf", context=context)
        if not len(e):
            return
        known = m.LocationFixPositionCovarianceType.DiagonalKnown
        q_nb = attitude_in_n(self._result)
        p_n, lla = e.p_n, in_degrees(e.lla)
        velocity, velocity_cov = _in_body(e)
        pose_cov = _diagonal(np.hstack([e.sd_p_n, e.sd_euler]) ** 2)
        location_cov = _diagonal(e.sd_p_n[:, [1, 0, 2]] ** 2)

        def root(ns: int) -> None:
            turn = m.Quaternion(x=_HALF, y=_HALF, z=0.0, w=0.0)
            frames = {"parent_frame_id": "map", "child_frame_id": "n"}
            transforms.log(
                m.FrameTransform(timestamp=self._stamp(ns), rotation=turn, **frames), log_time=ns
            )

        def log_pose(ns: int, k: int) -> Any:
            w, x, y, z = q_nb[k].tolist()
            turn = m.Quaternion(x=x, y=y, z=z, w=w)
            pose = m.Pose(position=self._vector(p_n[k]), orientation=turn)
            message = m.PoseInFrame(timestamp=self._stamp(ns), frame_id="n", pose=pose)
            poses.log(message, log_time=ns)
            return pose

        def log_all(ns: int, k: int) -> None:
            pose, at = log_pose(ns, k), self._stamp(ns)
            odometry.log(
                m.Odometry(
                    timestamp=at,
                    frame_id="n",
                    body_frame_id="body",
                    pose=pose,
                    linear_velocity=self._vector(velocity[k]),
                    pose_covariance=pose_cov[k].tolist(),
                    velocity_covariance=velocity_cov[k].tolist(),
                ),
                log_time=ns,
            )
            lat, lon, alt = lla[k].tolist()
            locations.log(
                m.LocationFix(
                    timestamp=at,
                    frame_id="body",
                    latitude=lat,
                    longitude=lon,
                    altitude=alt,
                    position_covariance=location_cov[k].tolist(),
                    position_covariance_type=known,
                ),
                log_time=ns,
            )
            w, x, y, z = q_nb[k].tolist()
            transforms.log(
                m.FrameTransform(
                    timestamp=at,
                    parent_frame_id="n",
                    child_frame_id="body",
                    translation=self._vector(p_n[k]),
                    rotation=m.Quaternion(x=x, y=y, z=z, w=w),
                ),
                log_time=ns,
            )

        yield self._ns(e.t_us[0]), root
        finite = np.isfinite(np.hstack([p_n, q_nb, lla])).all(axis=1)
        whole = np.diff(e.t_us // _SELDOM_US, prepend=-1) != 0
        at = np.flatnonzero(finite)
        for k in at[np.argsort(e.t_us[at], kind="stable")].tolist():
            yield self._ns(e.t_us[k]), partial(log_all if whole[k] else log_pose, k=k)

    def _fixes(self) -> Iterator[_Log]:
        """GNSS fixes, with the receiver's claims as their covariance."""
        if self._result.evidence is None:
            return
        m, gnss = self._messages, self._result.evidence.gnss
        channel = self._channels.LocationFixChannel("/gnss/location", context=self._context)
        kinds = m.LocationFixPositionCovarianceType
        claims = gnss.sigmas[:, [0, 0, 1]]
        claimed = [bool(row.all()) for row in np.isfinite(claims)]
        covariance = _diagonal(claims**2)

        def log(ns: int, k: int) -> None:
            lat, lon, alt = gnss.lla[k].tolist()
            fix = m.LocationFix(
                timestamp=self._stamp(ns),
                frame_id="antenna",
                latitude=float(np.degrees(lat)),
                longitude=float(np.degrees(lon)),
                altitude=alt,
                position_covariance=covariance[k].tolist(),
                position_covariance_type=kinds.DiagonalKnown if claimed[k] else kinds.Unknown,
            )
            channel.log(fix, log_time=ns)

        for k in np.flatnonzero(gnss.fix_type >= 2).tolist():
            yield self._ns(gnss.t_us[k]), partial(log, k=k)

    def _innovations(self, aiding: str, found: Innovations) -> Iterator[_Log]:
        """An aiding's decisions, by the instants at which the measurements were valid."""
        import foxglove

        schema = foxglove.Schema(
            name="mavins.Innovation", encoding="jsonschema", data=json.dumps(INNOVATION).encode()
        )
        channel = foxglove.Channel(
            f"/innovations/{aiding}",
            schema=schema,
            message_encoding="json",
            context=self._context,
        )

        def log(ns: int, k: int) -> None:
            nis = float(found.nis[k])
            said = {
                "timestamp": {"sec": ns // 1_000_000_000, "nsec": ns % 1_000_000_000},
                "source": str(found.source[k]),
                "accepted": bool(found.accepted[k]),
                "reason": str(found.reason[k]),
                "nis": nis if math.isfinite(nis) else None,
                "innovation": list(filter(math.isfinite, found.innovation[k].tolist())),
                "sigma": list(filter(math.isfinite, found.sigma[k].tolist())),
            }
            channel.log(json.dumps(said), log_time=ns)

        for k in np.argsort(found.t_us, kind="stable").tolist():
            yield self._ns(found.t_us[k]), partial(log, k=k)

    def _remarks(self) -> Iterator[_Log]:
        """Every measurement that was not fused as a warning, and how it ended."""
        m, result = self._messages, self._result
        channel = self._channels.LogChannel("/log", context=self._context)
        remarks = [
            (t_us, m.LogLevel.Warning, f"{aiding}: {reason}")
            for aiding, found in result.innovations.items()
            for t_us, accepted, reason in zip(
                found.t_us.tolist(), found.accepted.tolist(), found.reason.tolist(), strict=True
            )
            if not accepted
        ]
        if len(result):
            reason = result.summary.get("reason")
            end = f"{result.summary.get('health')}" + (f": {reason}" if reason else "")
            remarks.append((int(result.t_us[-1]), m.LogLevel.Info, end))

        def log(ns: int, level: Any, text: str) -> None:
            said = m.Log(timestamp=self._stamp(ns), level=level, message=text, name="mavins")
            channel.log(said, log_time=ns)

        for t_us, level, text in sorted(remarks, key=lambda remark: remark[0]):
            yield self._ns(t_us), partial(log, level=level, text=text)


def _diagonal(variances: FloatArray) -> FloatArray:
    """Diagonal matrices (N, m * m) row by row."""
    n, m = variances.shape
    out = np.zeros((n, m * m))
    out[:, :: m + 1] = np.nan_to_num(variances)
    return out


def _in_body(e: Estimates) -> tuple[FloatArray, FloatArray]:
    """Velocity (N, 3) along the body's axes, and the covariance (N, 36) of it and of rates that nobody knows."""
    turns = np.array([quat_to_dcm(q) for q in e.quaternions])
    velocity = np.einsum("nij,ni->nj", turns, e.v)
    covariance = np.zeros((len(e), 6, 6))
    covariance[:, :3, :3] = np.einsum("nki,nk,nkj->nij", turns, e.sd_v**2, turns)
    return velocity, np.nan_to_num(covariance.reshape(-1, 36))
