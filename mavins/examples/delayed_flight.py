"""A recorded multicopter whose GNSS is late by a time that nobody has told the filter, and whose compass is late too.

ArduPilot in its simulator, 254 s: fixes are .18 s old at their stamp, the magnetometer in HIGHRES_IMU .10 s.
Theory: docs/theory/gnss.md, docs/theory/compass.md; page: docs/tutorials/lever-and-delay.md.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from mavins.config import load
from mavins.estimator.estimator import Estimator, Outputs
from mavins.estimator.solution import EULER, LLA, V_L, WIDTH, describe
from mavins.evaluation.errors import errors_against
from mavins.examples.base import Figure
from mavins.filters import RowBlock
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import X_TAU
from mavins.sources import tape_of
from mavins.types import FloatArray, IntArray

NAME: Final = "ap_copter_square_circle.tlog.xz"
SETTING: Final[dict[str, Any]] = {
    "gnss.delay": 0.0,
    "states.gnss_delay": "estimate",
    "states.gnss_delay_sigma": 0.2,
    "sources.heading": "off",
    "magnetometer.enabled": True,
    "magnetometer.delay": 0.10,
    "magnetometer.sigma": 0.05,
    "magnetometer.rotation": (0.0, 0.0, 0.0),
    "magnetometer.hard_iron": (0.0, 0.0, 0.0),
    "magnetometer.declination_deg": 12.65,
    "magnetometer.inclination_deg": -66.04,
}
"""The magnetometer stands by its own figures: .10 s late, known to half of that, on a vehicle that turns at up to
1 rad/s. That is .05; the scatter of its readings while it stands, .0006, is nothing beside it. The field's direction
is that of the World Magnetic Model at the place, February 2025."""
DELAY: Final = 0.18
LEARNT_US: Final = 159_000_000
BOUNDS_US: Final = (70_000_000, 248_000_000)
"""In boot time: when the delay has to be known, and between when the errors count."""
GRID_US: Final = 20_000


def fly(log: Path, say: Callable[[str], None]) -> Sequence[Figure]:
    """The flight through the estimator."""
    config = load(None, SETTING)
    tape, truth = tape_of(log, config)
    assert truth is not None
    times: list[IntArray] = []
    tables: list[FloatArray] = []
    delays: list[FloatArray] = []

    def take(block: RowBlock, frame: TangentFrame) -> None:
        n = block.count
        rows = np.empty((n, WIDTH))
        describe(block.x[:n], block.P[:n], frame.r0_e, frame.C_ne, rows)
        times.append(block.t_us[:n].copy())
        tables.append(rows)
        delays.append(np.column_stack([block.x[:n, X_TAU], np.sqrt(block.P[:n, -1, -1])]))

    tape.play(Estimator(config, "eskf", Outputs(GRID_US, take)))
    t_us, rows, delay = np.concatenate(times), np.concatenate(tables), np.concatenate(delays)
    say(f"{NAME}: the delay of GNSS, from 0 on")
    say(f"{'boot time s':>12}{'delay s':>10}{'sigma':>9}")
    for second in (70, 85, 100, 130, 159, 200, 248):
        k = int(np.searchsorted(t_us, second * 1_000_000))
        say(f"{second:12d}{delay[k, 0]:10.3f}{delay[k, 1]:9.3f}")
    judged = slice(*np.searchsorted(t_us, BOUNDS_US).tolist())
    errors = errors_against(
        t_us[judged], rows[judged, LLA], rows[judged, V_L], rows[judged, EULER], truth.columns()
    )
    learnt = delay[int(np.searchsorted(t_us, LEARNT_US)), 0]
    pos, vel, att = (
        np.sqrt(np.mean(e**2, axis=0)) for e in (errors.pos, errors.vel, np.degrees(errors.att))
    )
    say(f"velocity RMS north, east, down: {vel[0]:.3f} {vel[1]:.3f} {vel[2]:.3f} m/s")
    say("")
    figures = [Figure("flight: delay at 159 s, error", abs(learnt - DELAY), 0.02, "s")]
    for name, value in zip(("north", "east", "height"), pos.tolist(), strict=True):
        figures.append(Figure(f"flight: {name} RMS", value, 0.12, "m"))
    for name, value, limit in zip(
        ("roll", "pitch", "yaw"), att.tolist(), (0.5, 0.5, 2.0), strict=True
    ):
        figures.append(Figure(f"flight: {name} RMS", value, limit, "deg"))
    return figures
