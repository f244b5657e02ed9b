"""The Earth: WGS-84 ellipsoid, geodetic and Cartesian coordinates, the tangent NED frame n, gravity and rotation.

Frame n is fixed to the Earth: its origin is a point on or above the ellipsoid, its axes are north, east and
down there. LLA -> ECEF -> n is exact at any distance. Angles in rad, lengths in m. Heights are taken as
given: the altitude above mean sea level stands in for the ellipsoidal height everywhere.
Sources: NIMA TR8350.2 (WGS-84; Somigliana eq. 4-1, gravity with height eq. 4-3); Bowring 1976.
Theory: docs/theory/earth.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavins.nav.kernels import kernel
from mavins.types import FloatArray, Origin

SEMI_MAJOR: Final = 6378137.0
FLATTENING: Final = 1.0 / 298.257223563
SEMI_MINOR: Final = SEMI_MAJOR * (1.0 - FLATTENING)
E2: Final = FLATTENING * (2.0 - FLATTENING)
EP2: Final = E2 / (1.0 - E2)
EARTH_RATE: Final = 7.292115e-5
GM: Final = 3.986004418e14
GRAVITY_EQUATOR: Final = 9.7803253359
GRAVITY_POLE: Final = 9.8321849378
SOMIGLIANA_K: Final = SEMI_MINOR * GRAVITY_POLE / (SEMI_MAJOR * GRAVITY_EQUATOR) - 1.0
GRAVITY_M: Final = EARTH_RATE**2 * SEMI_MAJOR**2 * SEMI_MINOR / GM


@kernel
def lla_to_ecef(lat: float, lon: float, alt: float) -> FloatArray:
    """The (3,) ECEF position in m of a geodetic position (rad, rad, m)."""
    sin_lat, cos_lat = math.sin(lat), math.cos(lat)
    N = SEMI_MAJOR / math.sqrt(1.0 - E2 * sin_lat * sin_lat)
    r = np.empty(3)
    r[0] = (N + alt) * cos_lat * math.cos(lon)
    r[1] = (N + alt) * cos_lat * math.sin(lon)
    r[2] = (N * (1.0 - E2) + alt) * sin_lat
    return r


@kernel
def geodetic_direction(x: float, y: float, z: float) -> tuple[float, float, float]:
    """(sin lat, cos lat, alt) of the ECEF position (x, y, z).

    Two rounds of Bowring's formula: exact to rounding below 100 km of height.
    """
    d = math.sqrt(x * x + y * y)
    sin_lat, cos_lat = 0.0, 1.0
    tan_beta_n = z * SEMI_MAJOR
    tan_beta_d = d * SEMI_MINOR
    for _ in range(2):
        n = math.sqrt(tan_beta_n * tan_beta_n + tan_beta_d * tan_beta_d)
        sin_beta, cos_beta = tan_beta_n / n, tan_beta_d / n
        sin_lat = z + EP2 * SEMI_MINOR * sin_beta * sin_beta * sin_beta
        cos_lat = d - E2 * SEMI_MAJOR * cos_beta * cos_beta * cos_beta
        n = math.sqrt(sin_lat * sin_lat + cos_lat * cos_lat)
        sin_lat /= n
        cos_lat /= n
        tan_beta_n = (1.0 - FLATTENING) * sin_lat
        tan_beta_d = cos_lat
    # valid at the poles too, where d / cos(lat) is not
    alt = d * cos_lat + z * sin_lat - SEMI_MAJOR * math.sqrt(1.0 - E2 * sin_lat * sin_lat)
    return sin_lat, cos_lat, alt


@kernel
def ecef_to_lla(r_e: FloatArray) -> FloatArray:
    """[lat, lon, alt] in rad, rad, m of an ECEF position."""
    sin_lat, cos_lat, alt = geodetic_direction(r_e[0], r_e[1], r_e[2])
    lla = np.empty(3)
    lla[0] = math.atan2(sin_lat, cos_lat)
    lla[1] = math.atan2(r_e[1], r_e[0])
    lla[2] = alt
    return lla


@kernel
def dcm_ne(lat: float, lon: float) -> FloatArray:
    """C_ne (3, 3): takes ECEF to the NED axes at (lat, lon)."""
    sin_lat, cos_lat = math.sin(lat), math.cos(lat)
    sin_lon, cos_lon = math.sin(lon), math.cos(lon)
    C = np.empty((3, 3))
    C[0, 0] = -sin_lat * cos_lon
    C[0, 1] = -sin_lat * sin_lon
    C[0, 2] = cos_lat
    C[1, 0] = -sin_lon
    C[1, 1] = cos_lon
    C[1, 2] = 0.0
    C[2, 0] = -cos_lat * cos_lon
    C[2, 1] = -cos_lat * sin_lon
    C[2, 2] = -sin_lat
    return C


@kernel
def normal_gravity(sin_lat: float, alt: float) -> float:
    """Normal gravity in m/s^2 at a geodetic latitude and height (Somigliana; height to second order)."""
    s2 = sin_lat * sin_lat
    g0 = GRAVITY_EQUATOR * (1.0 + SOMIGLIANA_K * s2) / math.sqrt(1.0 - E2 * s2)
    h = alt / SEMI_MAJOR
    return g0 * (
        1.0 - 2.0 * (1.0 + FLATTENING + GRAVITY_M - 2.0 * FLATTENING * s2) * h + 3.0 * h * h
    )


@kernel
def ecef_of(p_n: FloatArray, r0_e: FloatArray, C_ne: FloatArray) -> FloatArray:
    """The ECEF position (3,) in m of a point p_n (3,) of frame n: r0_e + C_en p_n."""
    r = np.empty(3)
    for i in range(3):
        r[i] = r0_e[i] + C_ne[0, i] * p_n[0] + C_ne[1, i] * p_n[1] + C_ne[2, i] * p_n[2]
    return r


@kernel
def gravity_up(x: float, y: float, z: float) -> tuple[float, float, float]:
    """Normal gravity in m/s^2 at the ECEF position (x, y, z), times the plumb line's upward direction, in e."""
    sin_lat, cos_lat, alt = geodetic_direction(x, y, z)
    g = normal_gravity(sin_lat, alt)
    d = math.sqrt(x * x + y * y)
    # at a pole the horizontal part vanishes with cos(lat)
    k = g * cos_lat / d if d > 0.0 else 0.0
    return (k * x, k * y, g * sin_lat)


@kernel
def gravity_at(
    p0: float, p1: float, p2: float, r0_e: FloatArray, C_ne: FloatArray
) -> tuple[float, float, float]:
    """`gravity_n` on a tuple's worth of floats, for the hot kernels."""
    x = r0_e[0] + C_ne[0, 0] * p0 + C_ne[1, 0] * p1 + C_ne[2, 0] * p2
    y = r0_e[1] + C_ne[0, 1] * p0 + C_ne[1, 1] * p1 + C_ne[2, 1] * p2
    z = r0_e[2] + C_ne[0, 2] * p0 + C_ne[1, 2] * p1 + C_ne[2, 2] * p2
    u0, u1, u2 = gravity_up(x, y, z)
    return (
        -(C_ne[0, 0] * u0 + C_ne[0, 1] * u1 + C_ne[0, 2] * u2),
        -(C_ne[1, 0] * u0 + C_ne[1, 1] * u1 + C_ne[1, 2] * u2),
        -(C_ne[2, 0] * u0 + C_ne[2, 1] * u1 + C_ne[2, 2] * u2),
    )


@kernel
def replace_by_gravity(
    a: FloatArray, b: FloatArray, c: FloatArray, r0_e: FloatArray, C_ne: FloatArray
) -> None:
    """Places p_n = (a, b, c), each (K,), <- g_n there, in place: several at a time, as `gravity_at` cannot."""
    x0, y0, z0 = r0_e[0], r0_e[1], r0_e[2]
    n0, n1, n2 = C_ne[0, 0], C_ne[0, 1], C_ne[0, 2]
    e0, e1, e2 = C_ne[1, 0], C_ne[1, 1], C_ne[1, 2]
    d0, d1, d2 = C_ne[2, 0], C_ne[2, 1], C_ne[2, 2]
    for k in range(len(a)):
        x = x0 + n0 * a[k] + e0 * b[k] + d0 * c[k]
        y = y0 + n1 * a[k] + e1 * b[k] + d1 * c[k]
        z = z0 + n2 * a[k] + e2 * b[k] + d2 * c[k]
        u0, u1, u2 = gravity_up(x, y, z)
        a[k] = -(n0 * u0 + n1 * u1 + n2 * u2)
        b[k] = -(e0 * u0 + e1 * u1 + e2 * u2)
        c[k] = -(d0 * u0 + d1 * u1 + d2 * u2)


@kernel
def gravity_n(p_n: FloatArray, r0_e: FloatArray, C_ne: FloatArray) -> FloatArray:
    """g_n(p): normal gravity in m/s^2 at p_n (3,), along the local plumb line, in the axes of n."""
    return np.array(gravity_at(p_n[0], p_n[1], p_n[2], r0_e, C_ne))


@kernel
def write_gravity_gradient(G: FloatArray, g0: float, g1: float, g2: float) -> None:
    """G <- d g_n / d p_n in 1/s^2, in place: -g/R across the plumb line, +2 g/R along it (spherical, right to 1 %)."""
    g_sq = g0 * g0 + g1 * g1 + g2 * g2
    g = math.sqrt(g_sq)
    k = g / SEMI_MAJOR
    c = 3.0 * k / g_sq
    G[0, 0] = c * g0 * g0 - k
    G[0, 1] = G[1, 0] = c * g0 * g1
    G[0, 2] = G[2, 0] = c * g0 * g2
    G[1, 1] = c * g1 * g1 - k
    G[1, 2] = G[2, 1] = c * g1 * g2
    G[2, 2] = c * g2 * g2 - k


@kernel
def dcm_ln(lat: float, lon: float, C_ne: FloatArray) -> FloatArray:
    """C_ln (3, 3): takes n, whose axes are `C_ne`, to the local level frame at (lat, lon): C_le C_en."""
    C_le = dcm_ne(lat, lon)
    C = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            C[i, j] = C_le[i, 0] * C_ne[j, 0] + C_le[i, 1] * C_ne[j, 1] + C_le[i, 2] * C_ne[j, 2]
    return C


@kernel
def point_n(lat: float, lon: float, alt: float, r0_e: FloatArray, C_ne: FloatArray) -> FloatArray:
    """p_n (3,) in m of a geodetic position: C_ne (r_e - r0_e)."""
    r = lla_to_ecef(lat, lon, alt)
    p = np.empty(3)
    for i in range(3):
        p[i] = (
            C_ne[i, 0] * (r[0] - r0_e[0])
            + C_ne[i, 1] * (r[1] - r0_e[1])
            + C_ne[i, 2] * (r[2] - r0_e[2])
        )
    return p


@dataclass(frozen=True, slots=True)
class TangentFrame:
    """Frame n: its origin, the origin's ECEF position `r0_e` (3,), `C_ne` (3, 3) and the Earth rate `w_ie_n` (3,).

    `parameters` (12,) is r0_e, then C_ne row by row, as aiding models take them.
    """

    origin: Origin
    r0_e: FloatArray
    C_ne: FloatArray
    w_ie_n: FloatArray
    parameters: FloatArray

    @classmethod
    def at(cls, origin: Origin) -> TangentFrame:
        """The tangent frame at an origin."""
        C_ne = dcm_ne(origin.lat, origin.lon)
        w_ie_n = EARTH_RATE * np.ascontiguousarray(C_ne[:, 2])
        r0_e = lla_to_ecef(origin.lat, origin.lon, origin.alt)
        return cls(origin, r0_e, C_ne, w_ie_n, np.concatenate([r0_e, C_ne.ravel()]))

    def from_lla(self, lat: float, lon: float, alt: float) -> FloatArray:
        """p_n (3,) in m of a geodetic position; exact at any distance."""
        return point_n(lat, lon, alt, self.r0_e, self.C_ne)

    def to_lla(self, p_n: FloatArray) -> FloatArray:
        """[lat, lon, alt] in rad, rad, m of a point p_n (3,)."""
        return ecef_to_lla(ecef_of(p_n, self.r0_e, self.C_ne))

    def local_level(self, lat: float, lon: float) -> FloatArray:
        """C_ln (3, 3): takes n to the local level frame at (lat, lon)."""
        return dcm_ln(lat, lon, self.C_ne)
