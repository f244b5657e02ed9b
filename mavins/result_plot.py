"""A run as one matplotlib figure: track, altitude, speed, attitude, errors within +-3 sigma, NIS."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib import pyplot as plt

from mavins.nav.earth import TangentFrame
from mavins.nav.so3 import quat_to_euler
from mavins.types import FloatArray, IntArray, Origin

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from mavins.estimates import Result

_AXES: Final = ("north", "east", "down")
_COLORS: Final = ("tab:blue", "tab:orange", "tab:green")


def plot_result(result: Result) -> Figure:
    """Draw a run over the truth, or over the log's own filter where there is no truth."""
    figure, axes = plt.subplots(3, 2, figsize=(13, 11), constrained_layout=True)
    track, altitude, speed, attitude, errors, nis = axes.ravel()
    known = result.judge
    places = result.lla if len(result) or known is None else known.lla
    if len(places):
        frame = TangentFrame.at(Origin(*places[0].tolist()))
        if known is not None:
            euler = np.array([quat_to_euler(q) for q in known.q_lb])
            columns = (known.t_us, known.lla, known.v_l, euler)
            _draw((track, altitude, speed, attitude), frame, columns, known.source, "black")
        columns = (result.t_us, result.lla, result.v, result.euler)
        name = result.filter
        _draw((track, altitude, speed, attitude), frame, columns, name, "tab:blue")
        track.legend()
    track.set(xlabel="east, m", ylabel="north, m", title="track")
    track.set_aspect("equal", adjustable="datalim")
    _draw_errors(errors, result)
    for aiding, seen in result.innovations.items():
        nis.plot(seen.t_us * 1e-6, seen.nis / seen.rows, ".", markersize=2, label=aiding)
    nis.set(yscale="log", title="NIS per row")
    if result.innovations:
        nis.legend(markerscale=4)
    for panel, label in (
        (altitude, "altitude, m"),
        (speed, "speed, m/s"),
        (attitude, "roll, pitch, yaw, deg"),
        (errors, "m"),
        (nis, ""),
    ):
        panel.set(xlabel="time since boot, s", ylabel=label)
    for panel in axes.ravel():
        panel.grid(alpha=0.3)
    return figure


def _draw(
    panels: tuple[Any, ...],
    frame: TangentFrame,
    columns: tuple[IntArray, FloatArray, FloatArray, FloatArray],
    name: str,
    color: str,
) -> None:
    """Track, altitude, speed and attitude of t_us, lla, v_l and Euler angles."""
    t_us, lla, v_l, euler = columns
    track, altitude, speed, attitude = panels
    p_n = np.array([frame.from_lla(*place) for place in lla.tolist()]).reshape(-1, 3)
    t = t_us * 1e-6
    style = {"label": name, "color": color, "linewidth": 1.0}
    track.plot(p_n[:, 1], p_n[:, 0], **style)
    altitude.plot(t, lla[:, 2], **style)
    speed.plot(t, np.linalg.norm(v_l, axis=1), **style)
    for k, line in enumerate(("-", "--", ":")):
        attitude.plot(t, np.degrees(euler[:, k]), **style | {"linestyle": line})


def _draw_errors(panel: Any, result: Result) -> None:
    """Position errors and +-3 sigma, or the sigmas alone."""
    panel.set_title("position error, +-3 sigma" if result.errors is not None else "+-3 sigma")
    for axis, name in enumerate(_AXES):
        style = {"color": _COLORS[axis], "linewidth": 0.6}
        if result.errors is not None:
            t = result.errors.t_us * 1e-6
            panel.plot(t, result.errors.pos[:, axis], **style, label=name)
        for sign in (-3.0, 3.0):
            panel.plot(result.seconds, sign * result.sd_p_n[:, axis], **style, linestyle=":")
    if result.errors is not None:
        panel.legend()
