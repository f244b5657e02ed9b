"""`mavins info`: what a log holds."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from mavins.cli.choosing import LOG_HELP, add_choice, choice_of

if TYPE_CHECKING:
    from mavins.logs.inspect import Gap, LogReport, VehicleReport
    from mavins.logs.readings import Readings
    from mavins.logs.sensor_log import SensorLog

SUMMARY = """\
Show what a log holds: its messages with their rates, the vehicles with their IMU, its gaps, reboots
and clock jumps, the sources that would be used and which others there are, truth, and damage."""

EPILOG = """\
examples:
  mavins info flight.tlog
  mavins info flight.tlog.xz            compressed logs are read as they are
  mavins info flight.ulg --gnss 1       as `mavins replay --gnss 1` would read it"""

LONGEST_GAPS: Final = 3
KINDS: Final = {
    "csv_folder": "a folder of CSV",
    "dataflash": "an ArduPilot dataflash log",
    "euroc": "a folder",
    "kf_gins": "text files",
    "ulog": "a PX4 .ulg",
}
LABELS: Final = {"gnss": "GNSS", "heading": "heading", "mag": "compass", "baro": "barometer"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("log", type=Path, metavar="LOG", help=LOG_HELP)
    add_choice(parser)


def run(args: argparse.Namespace) -> int:
    """Read the log and print the report."""
    from mavins.logs.content import kind_of
    from mavins.logs.inspect import inspect
    from mavins.logs.tlog import read_tlog
    from mavins.sources import read_sensors

    kind = kind_of(args.log)
    if kind == "tlog":
        lines = report_lines(str(args.log), inspect(read_tlog(args.log)))
    else:
        lines = sensor_lines(str(args.log), kind, read_sensors(args.log, kind, choice_of(args)))
    print("\n".join(lines))
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


def sensor_lines(name: str, kind: str, log: SensorLog) -> Iterator[str]:
    """What a log of sensors holds as lines of text."""
    from mavins.logs.inspect import rate_and_gaps

    about = f" of {log.about}" if log.about else ""
    yield f"{name}: {KINDS[kind]}{about}, {log.seconds:.1f} s"
    yield f"damage: {_counted(log.damage) or 'none'}"
    dropped = _counted(log.dropped)
    if dropped:
        yield f"left out: {dropped}"
    yield ""
    first, last = (t * 1e-6 for t in (log.imu.t_us[0], log.imu.t_us[-1]))
    rate, gaps = rate_and_gaps(log.imu.t_us)
    yield f"  time       {first:.3f} .. {last:.3f} s on its own clock"
    yield f"  IMU        {log.names['imu']}, {len(log.imu)} samples at {rate:.1f} Hz{_others(log, 'imu')}"
    yield _gap_line(gaps)
    sensors: dict[str, Readings[Any]] = {
        "gnss": log.gnss,
        "heading": log.headings,
        "mag": log.mag,
        "baro": log.baro,
    }
    for key, samples in sensors.items():
        label = f"  {LABELS[key]:<11}"
        if not samples:
            yield f"{label}none{_others(log, key)}"
            continue
        hertz = (len(samples) - 1) / max((samples.t_us[-1] - samples.t_us[0]) * 1e-6, 1e-6)
        words = f"{log.names[key]}, {len(samples)} readings at {hertz:.1f} Hz"
        if key == "gnss":
            good = sum(fix.fix_type >= 3 for fix in log.gnss)
            delay = "not told" if log.gnss_delay is None else f"{log.gnss_delay:g} s"
            words += f", {good} with a 3-D fix, delay {delay}"
        yield f"{label}{words}{_others(log, key)}"
    for key, judge in (("reference", log.reference), ("truth", log.truth)):
        words = "none" if judge is None else f"{judge.source}, {len(judge)} rows"
        yield f"  {key:<11}{words}{_others(log, key)}"
    if log.messages:
        yield ""
        yield "messages"
        for message, (count, hertz) in log.messages.items():
            yield f"  {message:<40}{count:>9}" + (f"{hertz:8.1f} Hz" if hertz else "")


def _others(log: SensorLog, table: str) -> str:
    """The sources that could be chosen in place of the one that is used."""
    names = [name for name in log.choices.get(table, ()) if name != log.names.get(table)]
    return f"; --{table} could be {', '.join(names)}" if names else ""


def _counted(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{n} {what.replace('_', ' ')}" for what, n in counts.items() if n)


def _gap_line(gaps: Sequence[Gap]) -> str:
    longest = sorted(gaps, key=lambda gap: -gap.length)[:LONGEST_GAPS]
    words = ", ".join(f"{g.length:.3f} s at {g.t_us * 1e-6:.1f}" for g in longest)
    return f"  gaps       {len(gaps)} of more than 3 intervals" + (f": {words}" * bool(gaps))


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
    yield _gap_line(vehicle.gaps)
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
