"""A comparison of filters as one figure: track, altitude, speed, roll, pitch, yaw against the truth."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mavins.estimator.solution import EULER, LLA, V_L
from mavins.evaluation.pictures import plt
from mavins.nav.earth import TangentFrame
from mavins.nav.so3 import quat_to_euler
from mavins.types import FloatArray, IntArray, Origin

if TYPE_CHECKING:
    from mavins.evaluation.compare import Run
    from mavins.logs.truth import Truth

_PANELS = ("altitude, m", "speed, m/s", "roll, deg", "pitch, deg", "yaw, deg")


def draw_runs(path: Path, runs: Mapping[str, Run], truth: Truth | None) -> None:
    """Draw one run of each filter over the truth into a PNG."""
    figure, axes = plt.subplots(3, 2, figsize=(14, 12), constrained_layout=True)
    track, *panels = axes.ravel()
    frame = _frame_of(runs, truth)
    if truth is not None and frame is not None:
        euler = np.array([quat_to_euler(q) for q in truth.q_lb])
        _draw(track, panels, frame, truth.t_us, truth.lla, truth.v_l, euler, "truth", "black", 2.0)
    for run in list(runs.values())[:1]:
        if frame is not None:
            t_us, places = run.fixes
            p_n = np.array([frame.from_lla(*place) for place in places.tolist()]).reshape(-1, 3)
            dots = {"marker": ".", "linestyle": "", "markersize": 2, "color": "tab:gray"}
            track.plot(p_n[:, 1], p_n[:, 0], label="GNSS", **dots)
            panels[0].plot(t_us * 1e-6, places[:, 2], label="GNSS", **dots)
    for name, run in runs.items():
        if frame is not None and len(run.t_us):
            rows = run.rows
            parts = (rows[:, LLA], rows[:, V_L], rows[:, EULER])
            _draw(track, panels, frame, run.t_us, *parts, name, None, 1.0)
    track.set(xlabel="east, m", ylabel="north, m", title="track")
    track.set_aspect("equal", adjustable="datalim")
    for panel, label in zip(panels, _PANELS, strict=True):
        panel.set(xlabel="time since boot, s", ylabel=label)
    for panel in (track, *panels):
        panel.grid(alpha=0.3)
    track.legend()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _frame_of(runs: Mapping[str, Run], truth: Truth | None) -> TangentFrame | None:
    """A frame at the first place that is known."""
    places = [truth.lla] if truth is not None else [r.rows[:, LLA] for r in runs.values()]
    first = next((lla[0] for lla in places if len(lla)), None)
    return None if first is None else TangentFrame.at(Origin(*first.tolist()))


def _draw(
    track: Any,
    panels: list[Any],
    frame: TangentFrame,
    t_us: IntArray,
    lla: FloatArray,
    v_l: FloatArray,
    euler: FloatArray,
    name: str,
    color: str | None,
    width: float,
) -> None:
    p_n = np.array([frame.from_lla(*place) for place in lla.tolist()])
    style: dict[str, Any] = {"label": name, "linewidth": width}
    if color:
        style["color"] = color
    track.plot(p_n[:, 1], p_n[:, 0], **style)
    t = t_us * 1e-6
    yaw = np.degrees(np.unwrap(euler[:, 2]))
    series = (
        lla[:, 2],
        np.linalg.norm(v_l, axis=1),
        np.degrees(euler[:, 0]),
        np.degrees(euler[:, 1]),
        (yaw + 180.0) % 360.0 - 180.0,
    )
    for panel, values in zip(panels, series, strict=True):
        panel.plot(t, values, **style)
