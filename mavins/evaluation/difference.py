"""How far one result is from another: on the instants that both have, in units and in sigmas of the first."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from mavins.errors import LogFormatError
from mavins.estimates import Result
from mavins.nav.earth import TangentFrame
from mavins.nav.so3 import wrap_pi
from mavins.types import FloatArray, IntArray, Origin


@dataclass(frozen=True, slots=True)
class Quantity:
    """What is compared: its state, the columns of that, and the unit it is shown in."""

    name: str
    state: str
    columns: tuple[str, ...]
    unit: str
    scale: float = 1.0
    is_angle: bool = False


_DEGREES: Final = 180.0 / np.pi
QUANTITIES: Final = (
    Quantity("position", "p_n", ("p_n", "p_e", "p_d"), "m"),
    Quantity("velocity", "v", ("v_n", "v_e", "v_d"), "m/s"),
    Quantity("attitude", "euler", ("roll", "pitch", "yaw"), "deg", _DEGREES, is_angle=True),
    Quantity("gyro bias", "b_g", ("b_g_x", "b_g_y", "b_g_z"), "deg/s", _DEGREES),
    Quantity("accelerometer bias", "b_a", ("b_a_x", "b_a_y", "b_a_z"), "m/s²"),
    Quantity("lever arm", "l_b", ("l_b_x", "l_b_y", "l_b_z"), "m"),
    Quantity("delay", "tau", ("tau",), "s"),
    Quantity("barometer bias", "b_baro", ("b_baro",), "m"),
    Quantity("magnetometer bias", "b_m", ("b_m_x", "b_m_y", "b_m_z"), "of the field"),
    Quantity("gravity", "g_n", ("g_n", "g_e"), "deg", _DEGREES),
)


@dataclass(frozen=True, slots=True)
class Moved:
    """How far one component moved: RMS and the largest difference in `unit`, at `at_s`, and both in sigmas of A.

    `widened` is the largest share by which a sigma of B differs from that of A. nan: A tells no sigma.
    """

    quantity: str
    component: str
    unit: str
    rms: float
    largest: float
    at_s: float
    rms_sigmas: float
    largest_sigmas: float
    widened: float

    @property
    def sigmas(self) -> float:
        """What a tolerance is held against; a difference without a sigma counts in full where there is any."""
        if np.isnan(self.largest_sigmas):
            return 0.0 if self.largest == 0.0 else float("inf")
        return max(self.largest_sigmas, self.widened)


@dataclass(frozen=True, slots=True)
class Difference:
    """All of it. `decisions` is (accepted, rejected) by aiding of A and B; `settings` and `figures` hold what differs:
    dotted name -> the values of A and B."""

    common: int
    only_a: int
    only_b: int
    moved: tuple[Moved, ...]
    decisions: dict[str, tuple[tuple[int, int], tuple[int, int]]]
    settings: dict[str, tuple[Any, Any]]
    figures: dict[str, tuple[Any, Any]]

    @property
    def sigmas(self) -> float:
        """The farthest that anything moved, in sigmas of A."""
        return max((moved.sigmas for moved in self.moved), default=0.0)

    def is_within(self, tolerance: float) -> bool:
        """True where both have the same instants, and nothing moved by more than so many sigmas."""
        return not self.only_a and not self.only_b and self.sigmas <= tolerance


def difference(a: Result, b: Result) -> Difference:
    """B minus A. Raises LogFormatError where no instant is in both."""
    # a reboot starts the stamps anew: the first row of each
    common, at_a, at_b = np.intersect1d(a.t_us, b.t_us, return_indices=True)
    if not len(common):
        raise LogFormatError(
            "A and B have no instant in common: are they of one log, at one --rate?"
        )
    return Difference(
        len(common),
        len(a) - len(common),
        len(b) - len(common),
        tuple(_moved(a, b, at_a, at_b)),
        _decisions(a, b),
        _differing(_flat(asdict(a.config)), _flat(asdict(b.config))),
        _differing(_figures(a.summary), _figures(b.summary)),
    )


def _moved(a: Result, b: Result, at_a: IntArray, at_b: IntArray) -> Iterator[Moved]:
    seconds = a.seconds[at_a]
    for quantity in QUANTITIES:
        if not (a.has(quantity.state) and b.has(quantity.state)):
            continue
        values_a, sigmas_a = (part[at_a] for part in a.state(quantity.state))
        values_b, sigmas_b = (part[at_b] for part in b.state(quantity.state))
        if quantity.state == "p_n":
            values_b = _in_frame_of(a, b, values_b, at_b)
        delta = values_b - values_a
        if quantity.is_angle:
            delta = np.vectorize(wrap_pi)(delta)
        for k, column in enumerate(quantity.columns):
            yield _component(quantity, column, seconds, delta[:, k], sigmas_a[:, k], sigmas_b[:, k])


def _component(
    quantity: Quantity,
    column: str,
    seconds: FloatArray,
    delta: FloatArray,
    sigma_a: FloatArray,
    sigma_b: FloatArray,
) -> Moved:
    known = np.isfinite(delta)
    if not known.any():
        return Moved(quantity.name, column, quantity.unit, *([np.nan] * 6))
    delta, seconds = delta[known], seconds[known]
    at = int(np.argmax(abs(delta)))
    has_sigma = sigma_a[known] > 0.0
    scaled = delta[has_sigma] / sigma_a[known][has_sigma]
    widened = abs(sigma_b[known][has_sigma] / sigma_a[known][has_sigma] - 1.0)
    return Moved(
        quantity.name,
        column,
        quantity.unit,
        _rms(delta) * quantity.scale,
        float(abs(delta[at])) * quantity.scale,
        float(seconds[at]),
        _rms(scaled),
        float(abs(scaled).max()) if len(scaled) else np.nan,
        float(np.nanmax(widened)) if np.isfinite(widened).any() else np.nan,
    )


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _in_frame_of(a: Result, b: Result, p_n: FloatArray, at_b: IntArray) -> FloatArray:
    """Positions of B in the frame n of A."""
    origin = a.summary.get("origin")
    if origin == b.summary.get("origin") or not isinstance(origin, dict):
        return p_n
    lat, lon = np.radians([origin["lat_deg"], origin["lon_deg"]]).tolist()
    frame = TangentFrame.at(Origin(lat, lon, origin["alt_m"]))
    return np.array([frame.from_lla(*row) for row in b.lla[at_b].tolist()])


def _decisions(a: Result, b: Result) -> dict[str, tuple[tuple[int, int], tuple[int, int]]]:
    names = dict.fromkeys((*a.innovations, *b.innovations))
    return {name: (_counts(a, name), _counts(b, name)) for name in names}


def _counts(result: Result, aiding: str) -> tuple[int, int]:
    found = result.innovations.get(aiding)
    if found is None:
        return 0, 0
    accepted = int(found.accepted.sum())
    return accepted, len(found) - accepted


def _figures(summary: Mapping[str, Any]) -> dict[str, Any]:
    """What summary.json tells of the estimate; not of the machine that it was made on."""
    kept = ("mavins", "filter", "imu_samples", "health", "reason", "resets", "realignments", "rows")
    judged = {
        key: summary[key]["rms"] for key in ("truth", "reference", "smoothed") if _has(summary, key)
    }
    return _flat({key: summary.get(key) for key in kept} | judged)


def _has(summary: Mapping[str, Any], key: str) -> bool:
    return isinstance(summary.get(key), dict) and "rms" in summary[key]


def _flat(content: dict[str, Any], head: str = "") -> dict[str, Any]:
    """Dotted names of all values."""
    flat: dict[str, Any] = {}
    for key, value in content.items():
        if isinstance(value, dict):
            flat |= _flat(value, f"{head}{key}.")
        else:
            flat[f"{head}{key}"] = value
    return flat


def _differing(a: dict[str, Any], b: dict[str, Any]) -> dict[str, tuple[Any, Any]]:
    names = dict.fromkeys((*a, *b))
    return {name: (a.get(name), b.get(name)) for name in names if a.get(name) != b.get(name)}
