"""`mavins info`: what a log holds."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from mavins.logs.inspect import LogReport, VehicleReport

SUMMARY = """\
Show what a log holds: the messages of each component with their rates, the vehicles with their IMU,
its gaps, reboots and clock jumps, the sources that `auto` would use, truth, and damage."""

EPILOG = """\
examples:
  mavins info flight.tlog
  mavins info flight.tlog.xz            compressed logs are read as they are"""

LONGEST_GAPS: Final = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("log", type=Path, metavar="LOG", help="a .tlog, also in .gz or .xz")


def run(args: argparse.Namespace) -> int:
    """Read the log and print the report."""
    from mavins.logs.inspect import inspect
    from mavins.logs.tlog import read_tlog

    print("\n".join(report_lines(str(args.log), inspect(read_tlog(args.log)))))
    return 0


def report_lines(name: str, report: LogReport) -> Iterator[str]:
    """The report as lines of text."""
    yield f"{name}: {report.packets} packets, {report.size / 1e6:.1f} MB, {report.duration:.1f} s"
    damage = report.damage
    yield (
        f"damage: {damage.bad_crc} packets with a wrong checksum, {damage.truncated} cut off, "
        f"{damage.skipped_bytes} bytes skipped; {damage.unknown} packets of unknown messages"
    )
    if report.reception_jumps:
        yield f"the recorder's clock jumped {report.reception_jumps} times"
    for vehicle in report.vehicles:
        yield ""
        yield from _vehicle_lines(vehicle)
    if not report.vehicles:
        yield ""
        yield "no system sends a usable IMU: there is nothing to estimate in this log"
    for (sysid, compid), messages in groupby(report.messages, lambda m: (m.sysid, m.compid)):
        yield ""
        yield f"messages of system {sysid}, component {compid}"
        for message in messages:
            rate = f"{message.rate:8.1f} Hz" if message.rate else ""
            yield f"  {message.name:<32}{message.count:>9}{rate}"


def _vehicle_lines(vehicle: VehicleReport) -> Iterator[str]:
    from pymavlink.dialects.v20 import all as dialect

    def name(enum: str, value: int | None, prefix: str) -> str:
        if value is None:
            return "unknown"
        entry = dialect.enums[enum].get(value)
        return str(entry.name).removeprefix(prefix) if entry else f"{prefix}{value}"

    first, last = (t * 1e-6 for t in vehicle.t_us)
    yield (
        f"vehicle {vehicle.sysid}, component {vehicle.compid}: "
        f"{name('MAV_TYPE', vehicle.vehicle_type, 'MAV_TYPE_')}, "
        f"autopilot {name('MAV_AUTOPILOT', vehicle.autopilot, 'MAV_AUTOPILOT_')}"
    )
    yield f"  time       {first:.3f} .. {last:.3f} s on its own clock, {last - first:.1f} s"
    yield (
        f"  IMU        {vehicle.imu} id {vehicle.imu_id}, {vehicle.imu_count} samples at "
        f"{vehicle.imu_rate:.1f} Hz, {vehicle.unusable} unusable, {vehicle.wild_stamps} bad stamps"
    )
    gaps = sorted(vehicle.gaps, key=lambda gap: -gap.length)
    longest = ", ".join(f"{g.length:.3f} s at {g.t_us * 1e-6:.1f}" for g in gaps[:LONGEST_GAPS])
    yield f"  gaps       {len(gaps)} of more than 3 intervals" + (f": {longest}" * bool(gaps))
    yield f"  clock      {vehicle.reboots} reboots, {vehicle.jumps} jumps forward"
    sources = vehicle.sources
    stamps = "UTC" if vehicle.gnss_is_utc else "boot time"
    delay = sources.utc_delay if vehicle.gnss_is_utc else sources.gnss_delay
    yield (
        f"  GNSS       {sources.gnss.upper()}, delay {delay:g} s; "
        f"{vehicle.gnss_fixes} GPS_RAW_INT with a 3-D fix, stamped in {stamps}"
    )
    limit = f", at most {sources.heading_rate:g} Hz" if sources.heading_rate else ""
    yield f"  heading    {sources.heading}{limit}"
    yield f"  vertical   velocity {'used' if sources.vertical_velocity else 'off'}"
    truth = f"{vehicle.truth}, {vehicle.truth_count} rows" if vehicle.truth else "none"
    yield f"  truth      {truth}"
