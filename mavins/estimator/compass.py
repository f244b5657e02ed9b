"""A magnetometer's readings made fit for the filter: turned into b, freed of hard iron, held against the Earth's field.

Only the direction is used: a field near iron or currents changes its strength first, and units do not matter.
Theory: docs/theory/compass.md.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from mavins.errors import ConfigError
from mavins.estimator.aiding_settings import MagnetometerSettings
from mavins.estimator.alignment import level
from mavins.estimator.spacing import shortest_us
from mavins.nav.earth import TangentFrame
from mavins.nav.so3 import euler_to_quat, quat_to_dcm
from mavins.types import FloatArray, MagSample


class Compass:
    """One magnetometer."""

    def __init__(self, settings: MagnetometerSettings) -> None:
        self._settings = s = settings
        self._C_bs = quat_to_dcm(euler_to_quat(*_vector(s.rotation)))
        self._hard_iron = np.array(_vector(s.hard_iron))
        self._taken_us: int | None = None
        self._field_n: tuple[TangentFrame, FloatArray] | None = None

    def direction_b(self, sample: MagSample) -> FloatArray | None:
        """The field's direction (3,) in b; None where there is none, or the last was taken too short a time ago."""
        if self._settings.enabled is not True:
            return None
        if self._taken_us is not None and abs(sample.t_us - self._taken_us) < shortest_us(
            self._settings.max_rate
        ):
            return None
        field_b = self._C_bs @ (sample.field - self._hard_iron)
        strength = float(np.linalg.norm(field_b))
        if not 0.0 < strength < math.inf:
            return None
        self._taken_us = sample.t_us
        direction: FloatArray = field_b / strength
        return direction

    def reference_l(self, lat: float, lon: float, alt: float) -> FloatArray:
        """The Earth's field as a unit vector (3,) in the local level frame at a place."""
        declination, inclination = self._settings.declination_deg, self._settings.inclination_deg
        if declination == "auto" or inclination == "auto":
            model = world_magnetic_model(lat, lon, alt, self._settings.date)
            declination = model[0] if declination == "auto" else declination
            inclination = model[1] if inclination == "auto" else inclination
        d, i = math.radians(declination), math.radians(inclination)
        return np.array([math.cos(i) * math.cos(d), math.cos(i) * math.sin(d), math.sin(i)])

    def reference_n(self, frame: TangentFrame) -> FloatArray:
        """The same in n, at its origin: over 100 km the field turns by less than a degree."""
        if self._field_n is None or self._field_n[0] is not frame:
            origin = frame.origin
            self._field_n = frame, self.reference_l(origin.lat, origin.lon, origin.alt)
        return self._field_n[1]


def _vector(setting: str | tuple[float, float, float]) -> tuple[float, float, float]:
    """What is configured; nothing where it should have been found in a recorded flight."""
    return (0.0, 0.0, 0.0) if isinstance(setting, str) else setting


@cache
def world_magnetic_model(lat: float, lon: float, alt: float, date: float) -> tuple[float, float]:
    """(declination, inclination) in deg; ConfigError where the package with the model is not installed."""
    try:
        from pygeomag import GeoMag
    except ImportError as error:
        raise ConfigError(
            "magnetometer: the World Magnetic Model needs a package: pip install 'mavins[mag]'; or "
            "set magnetometer.declination_deg and magnetometer.inclination_deg"
        ) from error
    field = GeoMag(base_year=int(date)).calculate(
        math.degrees(lat), math.degrees(lon), alt * 1e-3, date
    )
    return float(field.d), float(field.i)


def levelled(
    direction_b: FloatArray, accel_b: FloatArray, push_l: FloatArray, reference_l: FloatArray
) -> tuple[float, float]:
    """(yaw, dip) in rad: the yaw at which the levelled field points to where the reference does, and its dip there.

    `accel_b` (3,) is the mean specific force, `push_l` (3,) the acceleration minus gravity. Levelling needs the yaw
    where the vehicle accelerates, so it is done several times over.
    """
    north = math.atan2(reference_l[1], reference_l[0])
    yaw, dip = 0.0, 0.0
    for _ in range(8):
        field_l = quat_to_dcm(level(accel_b, push_l, yaw)) @ direction_b
        yaw = math.remainder(yaw + north - math.atan2(field_l[1], field_l[0]), 2.0 * math.pi)
        dip = math.asin(min(1.0, max(-1.0, float(field_l[2]))))
    return yaw, dip
