"""The flight as MCAP with Foxglove's schemas: pose, odometry, location, transforms, innovations and a log.

Frames: `map` (east, north, up at the origin), in it `n` (north, east, down), in that `body` (forward, right, down).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from heapq import merge
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from mavins.evaluation.result_folder import Innovations, Result
from mavins.exports.places import attitude_in_n, origin_of, utc_offset_us
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
_Log = tuple[int, Callable[[int], None]]
"""Nanoseconds, and what logs a message at them."""


def write(result: Result, folder: Path) -> None:
    """Write flight.mcap; its times are UTC where the vehicle told it, else they count from boot."""
    import foxglove

    offset_us = utc_offset_us(result) or 0
    context = foxglove.Context()
    with (folder / FILES[0]).open("wb") as file:
        guarded = _Guarded(file)
        with foxglove.open_mcap(guarded, context=context) as writer:
            writer.write_metadata("mavins", _metadata(result))
            sources = (
                _estimates(result, offset_us, context),
                _fixes(result, offset_us, context),
                *(
                    _innovations(name, found, offset_us, context)
                    for name, found in result.innovations.items()
                ),
                _remarks(result, offset_us, context),
            )
            for ns, log in merge(*sources, key=lambda item: item[0]):
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


def _stamp(ns: int) -> Any:
    from foxglove.messages import Timestamp

    return Timestamp(ns // 1_000_000_000, ns % 1_000_000_000)


def _estimates(result: Result, offset_us: int, context: Any) -> Iterator[_Log]:
    """Every estimate as a pose, and some as odometry with their sigmas, as a place on Earth, and as a transform."""
    from foxglove import channels
    from foxglove import messages as m

    pose_channel = channels.PoseInFrameChannel("/estimate/pose", context=context)
    odometry_channel = channels.OdometryChannel("/estimate/odometry", context=context)
    location_channel = channels.LocationFixChannel("/estimate/location", context=context)
    transform_channel = channels.FrameTransformChannel("/tf", context=context)
    known = m.LocationFixPositionCovarianceType.DiagonalKnown
    e = result.estimates
    if not len(e):
        return
    origin_of(result)
    q_nb = attitude_in_n(result)
    p_n, lla = e.stack("p_n", "p_e", "p_d"), e.stack("lat_deg", "lon_deg", "alt_m")
    velocity, velocity_cov = _in_body(result)
    pose_cov = _diagonal(np.hstack([e.sd_p, e.sd_euler]) ** 2)
    location_cov = _diagonal(e.sd_p[:, [1, 0, 2]] ** 2)

    def root(ns: int) -> None:
        turn = m.Quaternion(x=_HALF, y=_HALF, z=0.0, w=0.0)
        frame = m.FrameTransform(
            timestamp=_stamp(ns), parent_frame_id="map", child_frame_id="n", rotation=turn
        )
        transform_channel.log(frame, log_time=ns)

    yield (int(e.t_us[0]) + offset_us) * 1000, root
    finite = np.isfinite(np.hstack([p_n, q_nb, lla])).all(axis=1)
    is_whole = np.diff(e.t_us // _SELDOM_US, prepend=-1) != 0
    for k in np.flatnonzero(finite).tolist():

        def log(ns: int, k: int = k) -> None:
            at = _stamp(ns)
            w, x, y, z = q_nb[k].tolist()
            turn = m.Quaternion(x=x, y=y, z=z, w=w)
            place = _vector(p_n[k])
            pose = m.Pose(position=place, orientation=turn)
            pose_channel.log(m.PoseInFrame(timestamp=at, frame_id="n", pose=pose), log_time=ns)
            if not is_whole[k]:
                return
            odometry_channel.log(
                m.Odometry(
                    timestamp=at,
                    frame_id="n",
                    body_frame_id="body",
                    pose=pose,
                    linear_velocity=_vector(velocity[k]),
                    pose_covariance=pose_cov[k].tolist(),
                    velocity_covariance=velocity_cov[k].tolist(),
                ),
                log_time=ns,
            )
            lat, lon, alt = lla[k].tolist()
            location_channel.log(
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
            transform_channel.log(
                m.FrameTransform(
                    timestamp=at,
                    parent_frame_id="n",
                    child_frame_id="body",
                    translation=place,
                    rotation=turn,
                ),
                log_time=ns,
            )

        yield (int(e.t_us[k]) + offset_us) * 1000, log


def _vector(v: FloatArray) -> Any:
    from foxglove.messages import Vector3

    x, y, z = v.tolist()
    return Vector3(x=x, y=y, z=z)


def _diagonal(variances: FloatArray) -> FloatArray:
    """Diagonal matrices (N, m * m) row by row."""
    n, m = variances.shape
    out = np.zeros((n, m * m))
    out[:, :: m + 1] = np.nan_to_num(variances)
    return out


def _in_body(result: Result) -> tuple[FloatArray, FloatArray]:
    """Velocity (N, 3) along the body's axes, and the covariance (N, 36) of it and of rates that nobody knows."""
    e = result.estimates
    turns = np.array([quat_to_dcm(q) for q in e.stack("q_w", "q_x", "q_y", "q_z")])
    velocity = np.einsum("nij,ni->nj", turns, e.v_l)
    covariance = np.zeros((len(e), 6, 6))
    covariance[:, :3, :3] = np.einsum("nki,nk,nkj->nij", turns, e.sd_v**2, turns)
    return velocity, np.nan_to_num(covariance.reshape(-1, 36))


def _fixes(result: Result, offset_us: int, context: Any) -> Iterator[_Log]:
    """GNSS fixes, with the receiver's claims as their covariance."""
    from foxglove import channels
    from foxglove import messages as m

    if result.evidence is None:
        return
    gnss = result.evidence.gnss
    channel = channels.LocationFixChannel("/gnss/location", context=context)
    kinds = m.LocationFixPositionCovarianceType
    claims = gnss.sigmas[:, [0, 0, 1]]
    claimed = [bool(row.all()) for row in np.isfinite(claims)]
    covariance = _diagonal(claims**2)
    for k in np.flatnonzero(gnss.fix_type >= 2).tolist():

        def log(ns: int, k: int = k) -> None:
            lat, lon, alt = gnss.lla[k].tolist()
            fix = m.LocationFix(
                timestamp=_stamp(ns),
                frame_id="antenna",
                latitude=float(np.degrees(lat)),
                longitude=float(np.degrees(lon)),
                altitude=alt,
                position_covariance=covariance[k].tolist(),
                position_covariance_type=kinds.DiagonalKnown if claimed[k] else kinds.Unknown,
            )
            channel.log(fix, log_time=ns)

        yield (int(gnss.t_us[k]) + offset_us) * 1000, log


def _innovations(aiding: str, found: Innovations, offset_us: int, context: Any) -> Iterator[_Log]:
    """An aiding's decisions, by the instants at which the measurements were valid."""
    import foxglove

    schema = foxglove.Schema(
        name="mavins.Innovation",
        encoding="jsonschema",
        data=json.dumps(INNOVATION).encode(),
    )
    channel = foxglove.Channel(
        f"/innovations/{aiding}", schema=schema, message_encoding="json", context=context
    )
    for k in np.argsort(found.t_us, kind="stable").tolist():

        def log(ns: int, k: int = k) -> None:
            nis = float(found.nis[k])
            said = {
                "timestamp": {"sec": ns // 1_000_000_000, "nsec": ns % 1_000_000_000},
                "source": str(found.source[k]),
                "accepted": bool(found.accepted[k]),
                "reason": str(found.reason[k]),
                "nis": nis if np.isfinite(nis) else None,
                "innovation": _finite(found.innovation[k]),
                "sigma": _finite(found.sigma[k]),
            }
            channel.log(json.dumps(said), log_time=ns)

        yield (int(found.t_us[k]) + offset_us) * 1000, log


def _finite(row: FloatArray) -> list[float]:
    values: list[float] = row[np.isfinite(row)].tolist()
    return values


def _remarks(result: Result, offset_us: int, context: Any) -> Iterator[_Log]:
    """Every measurement that was not fused as a warning, and how it ended."""
    from foxglove import channels
    from foxglove import messages as m

    channel = channels.LogChannel("/log", context=context)
    remarks = [
        (t_us, m.LogLevel.Warning, f"{aiding}: {reason}")
        for aiding, found in result.innovations.items()
        for t_us, accepted, reason in zip(
            found.t_us.tolist(), found.accepted.tolist(), found.reason.tolist(), strict=True
        )
        if not accepted
    ]
    if len(result.estimates):
        reason = result.summary.get("reason")
        end = f"{result.summary.get('health')}" + (f": {reason}" if reason else "")
        remarks.append((int(result.estimates.t_us[-1]), m.LogLevel.Info, end))
    for t_us, level, text in sorted(remarks, key=lambda remark: remark[0]):

        def log(ns: int, level: Any = level, text: str = text) -> None:
            channel.log(
                m.Log(timestamp=_stamp(ns), level=level, message=text, name="mavins"), log_time=ns
            )

        yield (t_us + offset_us) * 1000, log
