"""The live status in four modes: a panel on a terminal, plain lines, JSON lines, or nothing.

A renderer is given a snapshot whenever there is one and shows at most one a second (the panel:
four); it keeps the pace by the snapshot's own `uptime`, so that a test needs no clock.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Final, Protocol, TextIO

from mavins.status import (
    AidingStatus,
    EstimateStatus,
    StatusSnapshot,
    TruthError,
    Vector,
    VehicleStatus,
    to_json,
)

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.live import Live
    from rich.text import Text

MODES: Final = ("auto", "rich", "plain", "json", "off")

_LINE_PERIOD: Final = 0.95
"""Just under a second: a caller that means one a second may be a little early."""

_PANEL_PERIOD: Final = 0.24


class StatusRenderer(Protocol):
    """Shows snapshots, one after the other, until closed."""

    def update(self, snapshot: StatusSnapshot) -> None:
        """Show this snapshot, if it is time for one."""

    def close(self) -> None:
        """Leave the terminal as it was found."""


def make_renderer(mode: str = "auto", stream: TextIO | None = None) -> StatusRenderer:
    """The renderer of a mode; `auto` is `rich` where `stream` is a terminal, else `plain`."""
    out = sys.stdout if stream is None else stream
    if mode == "auto":
        mode = "rich" if out.isatty() else "plain"
    if mode == "rich":
        return _Panel(out)
    if mode == "off":
        return _Nothing()
    return _Lines(out, as_json=mode == "json")


class _Nothing:
    def update(self, snapshot: StatusSnapshot) -> None:
        pass

    def close(self) -> None:
        pass


class _Pace:
    """Lets a snapshot through when the last one shown is a period old."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._last = -math.inf

    def due(self, snapshot: StatusSnapshot) -> bool:
        if snapshot.uptime - self._last < self._period:
            return False
        self._last = snapshot.uptime
        return True


class _Lines:
    def __init__(self, out: TextIO, as_json: bool) -> None:
        self._out = out
        self._text = to_json if as_json else to_plain
        self._pace = _Pace(_LINE_PERIOD)

    def update(self, snapshot: StatusSnapshot) -> None:
        if self._pace.due(snapshot):
            print(self._text(snapshot), file=self._out, flush=True)

    def close(self) -> None:
        pass


class _Panel:
    def __init__(self, out: TextIO) -> None:
        self._out = out
        self._pace = _Pace(_PANEL_PERIOD)
        self._live: Live | None = None

    def update(self, snapshot: StatusSnapshot) -> None:
        if not self._pace.due(snapshot):
            return
        panel = to_panel(snapshot)
        if self._live is None:
            from rich.console import Console
            from rich.live import Live

            self._live = Live(console=Console(file=self._out), auto_refresh=False)
            self._live.start()
        self._live.update(panel, refresh=True)

    def close(self) -> None:
        if self._live is not None:
            self._live.stop()
            self._live = None


def to_plain(snapshot: StatusSnapshot) -> str:
    """One line (one for each vehicle, where there are several)."""
    head = f"{snapshot.uptime:6.0f} s"
    if not snapshot.vehicles:
        return f"{head}  waiting for a vehicle's IMU; {_traffic(snapshot)}"
    return "\n".join(f"{head}  {_plain_vehicle(vehicle)}" for vehicle in snapshot.vehicles)


def _plain_biases(estimate: EstimateStatus) -> list[str]:
    """What is estimated of barometer, magnetometer and gravity."""
    parts = []
    if estimate.baro_bias is not None:
        parts.append(f"baro bias {estimate.baro_bias:.2f} m (±{estimate.sd_baro_bias:.2f})")
    if estimate.mag_bias is not None and estimate.sd_mag_bias is not None:
        sigma = _join(estimate.sd_mag_bias, ".3f", "/")
        parts.append(f"mag bias {_join(estimate.mag_bias, '.3f')} (±{sigma})")
    if estimate.gravity is not None and estimate.sd_gravity is not None:
        value = _join(map(math.degrees, estimate.gravity), ".2f")
        sigma = _join(map(math.degrees, estimate.sd_gravity), ".2f", "/")
        parts.append(f"gravity {value} deg (±{sigma})")
    return parts


def _plain_vehicle(vehicle: VehicleStatus) -> str:
    parts = [f"vehicle {vehicle.sysid}: {_health(vehicle)}"]
    estimate = vehicle.estimate
    if estimate is not None:
        sd_att = _join(_degrees(estimate.sd_attitude), ".1f", "/")
        parts += [
            f"p {_join(estimate.p_n, '.2f')} m (±{_join(estimate.sd_p, '.2f', '/')})",
            f"v {_join(estimate.v_l, '.2f')} m/s (±{_join(estimate.sd_v, '.2f', '/')})",
            f"rpy {_join(_degrees(estimate.attitude), '.1f')} deg (±{sd_att})",
        ]
        if estimate.lever_arm is not None and estimate.sd_lever_arm is not None:
            sigma = _join(estimate.sd_lever_arm, ".2f", "/")
            parts.append(f"lever arm {_join(estimate.lever_arm, '.2f')} m (±{sigma})")
        if estimate.delay is not None:
            parts.append(f"delay {estimate.delay:.3f} s (±{estimate.sd_delay:.3f})")
        parts += _plain_biases(estimate)
    if vehicle.rates:
        parts.append(", ".join(f"{name} {rate:.0f} Hz" for name, rate in vehicle.rates.items()))
    parts.append(f"rejected {rejected_total(vehicle)}")
    if vehicle.error is not None:
        parts.append(f"error {_error(vehicle)}")
    return " | ".join(parts)


def rejected_total(vehicle: VehicleStatus) -> int:
    """How many measurements of a vehicle were not fused, whatever the aiding and the reason."""
    return sum(sum(aiding.rejected.values()) for aiding in vehicle.aidings.values())


def _health(vehicle: VehicleStatus) -> str:
    health = vehicle.health.replace("_", " ")
    return f"{health} ({vehicle.reason})" if vehicle.reason else health


def _traffic(snapshot: StatusSnapshot) -> str:
    peers = "1 peer" if snapshot.peers == 1 else f"{snapshot.peers} peers"
    dropped = _counts(snapshot.dropped)
    text = f"{peers}, {snapshot.packets_in} packets in, {snapshot.packets_out} out"
    return f"{text}, dropped: {dropped}" if dropped else text


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counts.items() if count)


def _error(vehicle: VehicleStatus) -> str:
    error = vehicle.error
    assert error is not None
    return (
        f"{math.hypot(*error.pos):.3f} m, {math.hypot(*error.vel):.3f} m/s, "
        f"{math.degrees(math.hypot(*error.att)):.2f} deg"
    )


def _degrees(angles: Vector) -> Vector:
    roll, pitch, yaw = angles
    return math.degrees(roll), math.degrees(pitch), math.degrees(yaw)


def _fit(values: Vector, width: int, digits: int, sign: str = "") -> str:
    """Three columns; large values lose decimals before they break the line."""
    texts = (_join(values, f"{sign}{width}.{d}f") for d in range(digits, -1, -1))
    return next((text for text in texts if len(text) == 3 * width + 2), _join(values, ".0e"))


def _join(values: Iterable[float], form: str, separator: str = " ") -> str:
    return separator.join(format(value, form) for value in values)


_COLOURS: Final = {
    "waiting": "yellow",
    "aligning": "yellow",
    "running": "green",
    "dead_reckoning": "magenta",
    "diverged": "red",
}


def to_panel(snapshot: StatusSnapshot) -> RenderableType:
    """The panel of the live status, 78 columns wide.

    Its columns are set by hand: rich's tables take five times as long, and the service that draws
    this has packets to answer.
    """
    from rich.panel import Panel
    from rich.text import Text

    body = Text("\n\n").join(_panel_vehicle(vehicle) for vehicle in snapshot.vehicles)
    if not snapshot.vehicles:
        body = Text("waiting for a vehicle's IMU", style="yellow")
    return Panel(
        body,
        title=f"mavins  {snapshot.uptime:.0f} s",
        subtitle=_traffic(snapshot),
        title_align="left",
        subtitle_align="left",
        padding=(1, 1),
    )


def _panel_vehicle(vehicle: VehicleStatus) -> Text:
    from rich.text import Text

    text = Text.assemble(
        (f"vehicle {vehicle.sysid}  ", "bold"),
        (vehicle.health.replace("_", " ").upper(), f"bold {_COLOURS.get(vehicle.health, 'white')}"),
        f"  {vehicle.reason}\n",
    )
    if vehicle.estimate is not None:
        _append_estimate(text, vehicle.estimate, vehicle.error)
    if vehicle.aidings:
        _append_aidings(text, vehicle.aidings)
    rates = "   ".join(f"{name} {rate:.0f} Hz" for name, rate in vehicle.rates.items())
    return text.append(f"\n{rates}   resets {vehicle.reset_counter}", style="dim")


def _append_estimate(text: Text, estimate: EstimateStatus, error: TruthError | None) -> None:
    """Rows of value, sigma, and the error against the truth where one is seen."""
    off: tuple[Vector | None, ...] = (None, None, None)
    if error is not None:
        off = (error.pos, error.vel, _degrees(error.att))
    rows = (
        ("pos NED m", estimate.p_n, estimate.sd_p, off[0]),
        ("vel NED m/s", estimate.v_l, estimate.sd_v, off[1]),
        ("rpy deg", _degrees(estimate.attitude), _degrees(estimate.sd_attitude), off[2]),
    )
    title = f"{'':11} {'estimate':>23}  {'1-sigma':>17}"
    text.append(f"\n{title}  {'error':>20}\n" if error else f"\n{title}\n", style="dim")
    for name, value, sigma, gone in rows:
        line = f"{name:11} {_fit(value, 7, 2)}  {_fit(sigma, 5, 3)}"
        text.append(f"{line}  {_fit(gone, 6, 3, '+')}\n" if gone else f"{line}\n")
    if estimate.lever_arm is not None and estimate.sd_lever_arm is not None:
        line = f"{_fit(estimate.lever_arm, 7, 2)}  {_fit(estimate.sd_lever_arm, 5, 3)}"
        text.append(f"{'lever arm m':11} {line}\n")
    if estimate.delay is not None:
        text.append(f"{'delay s':11} {estimate.delay:7.3f} {'':15}  {estimate.sd_delay:5.3f}\n")
    if estimate.baro_bias is not None:
        line = f"{estimate.baro_bias:7.2f} {'':15}  {estimate.sd_baro_bias:5.2f}"
        text.append(f"{'baro bias m':11} {line}\n")
    if estimate.mag_bias is not None and estimate.sd_mag_bias is not None:
        line = f"{_fit(estimate.mag_bias, 7, 3)}  {_fit(estimate.sd_mag_bias, 5, 3)}"
        text.append(f"{'mag bias':11} {line}\n")
    if estimate.gravity is not None and estimate.sd_gravity is not None:
        turn = _join(map(math.degrees, estimate.gravity), "7.2f")
        sd = _join(map(math.degrees, estimate.sd_gravity), "5.2f")
        text.append(f"{'gravity deg':11} {turn} {'':7}  {sd}\n")
    place = f"{estimate.lat_deg:.7f}  {estimate.lon_deg:.7f}  {estimate.alt:.2f} m"
    text.append(f"{'lat lon alt':11}   {place}\n")


def _append_aidings(text: Text, aidings: Mapping[str, AidingStatus]) -> None:
    title = f"{'aiding':15} {'fused':>7} {'NIS':>7} {'expected':>9} {'sigma ratio':>12}"
    text.append(f"\n{title}  rejected\n", style="dim")
    for name, aiding in aidings.items():
        nis, expected, ratio = (
            "-" if value is None else f"{value:.2f}"
            for value in (aiding.nis_mean, aiding.nis_expected, aiding.sigma_ratio)
        )
        line = f"{name:15} {aiding.fused:7} {nis:>7} {expected:>9} {ratio:>12}  "
        text.append(line + (_counts(aiding.rejected) or "0") + "\n")


def to_svg(snapshot: StatusSnapshot, width: int = 80) -> str:
    """A picture of the panel for the documentation, without references to fonts elsewhere."""
    import io

    from rich.console import Console

    console = Console(record=True, width=width, file=io.StringIO(), force_terminal=True)
    console.print(to_panel(snapshot))
    svg = console.export_svg(title="mavins serve")
    return re.sub(r"@font-face \{.*?\}\s*", "", svg, flags=re.DOTALL)
