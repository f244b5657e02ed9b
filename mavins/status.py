"""What the live status shows, as frozen data, and its way into one line of JSON and back.

The service fills a `StatusSnapshot` about once a second; `mavins.cli.status` shows it, and
`mavins demo` reads it back from the JSON lines of a service in another process. SI and radians, but
for the latitude and longitude, which people read.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any, TypeAlias

Vector: TypeAlias = tuple[float, float, float]
Pair: TypeAlias = tuple[float, float]


@dataclass(frozen=True, slots=True)
class AidingStatus:
    """How one aiding fares: `rejected` counts by reason; the innovation statistics judge R.

    `nis_mean` is the mean normalized innovation squared, `nis_expected` its degrees of freedom;
    `sigma_ratio`, the root of their ratio, is above 1 where the measurements scatter more than
    their sigmas say. None: no sample yet.
    """

    fused: int = 0
    rejected: Mapping[str, int] = field(default_factory=dict)
    nis_mean: float | None = None
    nis_expected: float | None = None
    sigma_ratio: float | None = None


@dataclass(frozen=True, slots=True)
class EstimateStatus:
    """The estimate and its 1-sigma: p in n, v in l, attitude = (roll, pitch, yaw) in l.

    The lever arm and the delay of GNSS, the biases of barometer (m) and magnetometer (shares of the Earth's field) and
    the turn of gravity (rad, about north and east) are None where they are not estimated.
    """

    lat_deg: float
    lon_deg: float
    alt: float
    p_n: Vector
    sd_p: Vector
    v_l: Vector
    sd_v: Vector
    attitude: Vector
    sd_attitude: Vector
    lever_arm: Vector | None = None
    sd_lever_arm: Vector | None = None
    delay: float | None = None
    sd_delay: float | None = None
    baro_bias: float | None = None
    sd_baro_bias: float | None = None
    mag_bias: Vector | None = None
    sd_mag_bias: Vector | None = None
    gravity: Pair | None = None
    sd_gravity: Pair | None = None


@dataclass(frozen=True, slots=True)
class TruthError:
    """Estimate minus the simulator's truth at one instant; `att` is (roll, pitch, yaw), wrapped."""

    pos: Vector
    vel: Vector
    att: Vector


@dataclass(frozen=True, slots=True)
class MonitorStatus:
    """How far a quantity of the autopilot's own estimate is from ours, in `unit` (m, m/s, rad).

    `worst_ratio` is the largest difference over limit so far; `beyond` is for how long (s) the limit has been exceeded.
    """

    difference: float
    limit: float
    unit: str
    worst_ratio: float
    beyond: float = 0.0
    warning: bool = False

    @property
    def ratio(self) -> float:
        """Difference over limit."""
        return self.difference / self.limit


@dataclass(frozen=True, slots=True)
class VehicleStatus:
    """One vehicle: `health` is a `Health` name in lower case, `rates` are Hz by sensor.

    `monitor` compares the autopilot's own estimate by quantity, and is None where that is not done; `clock_offset` is
    our time minus the autopilot's, `round_trip` the way there and back, in s (None: not known).
    """

    sysid: int
    health: str
    reason: str
    t_us: int
    estimate: EstimateStatus | None = None
    rates: Mapping[str, float] = field(default_factory=dict)
    aidings: Mapping[str, AidingStatus] = field(default_factory=dict)
    reset_counter: int = 0
    error: TruthError | None = None
    monitor: Mapping[str, MonitorStatus] | None = None
    clock_offset: float | None = None
    round_trip: float | None = None


@dataclass(frozen=True, slots=True)
class StatusSnapshot:
    """The service at one instant: `uptime` in s; `dropped` counts what was not used, by reason.

    `remarks` say what is wrong with what autopilots send, and what to do about it; `pid` is the service's process.
    """

    uptime: float
    peers: int
    packets_in: int
    packets_out: int
    dropped: Mapping[str, int] = field(default_factory=dict)
    vehicles: tuple[VehicleStatus, ...] = ()
    remarks: tuple[str, ...] = ()
    pid: int | None = None


def to_json(snapshot: StatusSnapshot) -> str:
    """One line of JSON; a number that is not finite becomes null."""
    return json.dumps(finite(asdict(snapshot)), allow_nan=False, separators=(",", ":"))


def from_json(line: str) -> StatusSnapshot:
    """The snapshot that `to_json` wrote; a null among numbers is NaN again. ValueError: not one."""
    try:
        data = json.loads(line)
        vehicles = tuple(_vehicle(item) for item in data.pop("vehicles"))
        remarks = tuple(data.pop("remarks"))
        return StatusSnapshot(**data, vehicles=vehicles, remarks=remarks)
    except (TypeError, KeyError, AttributeError) as error:
        raise ValueError(f"not a status line: {error}") from None


def _vehicle(data: dict[str, Any]) -> VehicleStatus:
    estimate, error, aidings = data.pop("estimate"), data.pop("error"), data.pop("aidings")
    monitor = data.pop("monitor", None)
    return VehicleStatus(
        **data,
        estimate=EstimateStatus(**_numbers(_known(estimate))) if estimate else None,
        error=TruthError(**_numbers(error)) if error else None,
        aidings={name: AidingStatus(**aiding) for name, aiding in aidings.items()},
        monitor={name: MonitorStatus(**item) for name, item in monitor.items()}
        if monitor
        else None,
    )


def _known(estimate: Mapping[str, Any]) -> dict[str, Any]:
    """Without what is not estimated: there a null means absence, elsewhere NaN."""
    optional = {f.name for f in fields(EstimateStatus) if f.default is None}
    return {k: v for k, v in estimate.items() if k not in optional or v is not None}


def _numbers(data: Mapping[str, Any]) -> dict[str, Any]:
    return {name: _number(value) for name, value in data.items()}


def _number(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(_number(item) for item in value)
    return math.nan if value is None else value


def finite(value: Any) -> Any:
    """The same for JSON: a number that is not finite becomes None, tuples lists, keys strings."""
    if isinstance(value, dict):
        return {str(key): finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
