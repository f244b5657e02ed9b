"""What a demo flight comes to: RMS errors against the simulator's truth, and if they will do."""

from __future__ import annotations

import math
from typing import Final

from mavins.status import StatusSnapshot, TruthError, VehicleStatus

POSITION_LIMIT: Final = 1.0
"""RMS of the position error in m, three axes together, above which the demo fails."""


class Verdict:
    """Collects status snapshots while the filter runs, then sums up and judges."""

    def __init__(self) -> None:
        self.samples = 0
        self._errors: list[TruthError] = []
        self._last: StatusSnapshot | None = None

    def add(self, snapshot: StatusSnapshot) -> bool:
        """Take a snapshot; True if it shows a running filter."""
        self._last = snapshot
        vehicle = next((one for one in snapshot.vehicles if one.estimate is not None), None)
        if vehicle is None or not (self.samples or vehicle.health == "running"):
            return False
        self.samples += 1
        if vehicle.error is not None:
            self._errors.append(vehicle.error)
        return True

    def failures(self) -> list[str]:
        """Why the estimate is not good enough; empty if it is."""
        if not self.samples:
            return []  # whoever waited for the first estimate says so
        if not self._errors:
            return ["the simulator's truth was never seen"]
        position = self._rms()[0]
        if not position <= POSITION_LIMIT:  # NaN fails too
            return [f"RMS position error {position:.2f} m is above {POSITION_LIMIT:g} m"]
        return []

    def summary(self) -> str:
        """A few lines: errors, rates, what was fused and rejected."""
        lines = ["", f"{self.samples} samples of a running filter"]
        if self._errors:
            position, velocity, attitude = self._rms()
            lines.append(
                f"RMS error: position {position:.3f} m, velocity {velocity:.3f} m/s, "
                f"attitude {math.degrees(attitude):.3f} deg"
            )
        for vehicle in self._last.vehicles if self._last else ():
            lines += _vehicle_lines(vehicle)
        return "\n".join(lines)

    def _rms(self) -> tuple[float, float, float]:
        """Root of the mean squared length of the error vectors: m, m/s, rad."""
        count = len(self._errors)
        return (
            math.sqrt(sum(math.hypot(*error.pos) ** 2 for error in self._errors) / count),
            math.sqrt(sum(math.hypot(*error.vel) ** 2 for error in self._errors) / count),
            math.sqrt(sum(math.hypot(*error.att) ** 2 for error in self._errors) / count),
        )


def _vehicle_lines(vehicle: VehicleStatus) -> list[str]:
    rates = ", ".join(f"{name} {rate:.1f} Hz" for name, rate in vehicle.rates.items())
    lines = [f"vehicle {vehicle.sysid}: {vehicle.health}, resets {vehicle.reset_counter}, {rates}"]
    for name, aiding in vehicle.aidings.items():
        reasons = ", ".join(f"{why} {count}" for why, count in aiding.rejected.items() if count)
        lines.append(f"  {name}: fused {aiding.fused}, rejected {reasons or 0}")
    return lines
