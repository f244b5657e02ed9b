"""ArduPilot dataflash logs, `.BIN` or text, into the tables of a `SensorLog`.

Stamps are TimeUS, microseconds since boot. Format: docs/reference/dataflash.md.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

from mavins.errors import LogFormatError
from mavins.logs import readings
from mavins.logs.cleaning import thinned
from mavins.logs.dataflash import judges
from mavins.logs.dataflash.binary import BinaryLog
from mavins.logs.dataflash.channels import Channel, Reading, Wish, wish_of
from mavins.logs.dataflash.formats import Batch, Format
from mavins.logs.dataflash.gnss import GPA, GPS, ReceiverParameters, fixes_of
from mavins.logs.dataflash.survey import Firmware
from mavins.logs.dataflash.text import TextLog
from mavins.logs.packed import fault_of, open_packed
from mavins.logs.sensor_log import DEFAULT, Choice, SensorLog
from mavins.mavlink.codec.checks import MAX_ACCEL, MAX_GYRO
from mavins.types import FloatArray, ImuTable


def _rates(rows: FloatArray) -> FloatArray:
    """Gyro and accelerometer readings (M, 6), nan where no sensor reads as much."""
    limits = np.repeat([MAX_GYRO, MAX_ACCEL], 3)
    return np.where((abs(rows) > limits).any(axis=1, keepdims=True), np.nan, rows)


def _of_increments(rows: FloatArray) -> FloatArray:
    """The same of turns, of changes of velocity, and of the times of both, that of the turns maybe lacking."""
    over = np.where(np.isfinite(rows[:, 7]), rows[:, 7], rows[:, 6])
    return _rates(np.column_stack([rows[:, :3] / over[:, None], rows[:, 3:6] / rows[:, 6:7]]))


def _not_zero(rows: FloatArray) -> FloatArray:
    return np.where((rows == 0.0).all(axis=1)[:, None], np.nan, rows)


_IMU: Final = {
    "IMU": Reading(("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"), _rates),
    "IMT": Reading(
        ("DelAX", "DelAY", "DelAZ", "DelVX", "DelVY", "DelVZ", "DelvT", "[DelaT]"),
        _of_increments,
        over=6,
    ),
}
_MAG: Final = {"MAG": Reading(("MagX", "MagY", "MagZ"), _not_zero)}
_BARO: Final = {"BARO": Reading(("Alt",))}


_Reader: TypeAlias = Channel | ReceiverParameters | Firmware


class _Channels:
    """All that is read of a log."""

    def __init__(self, choice: Choice) -> None:
        gnss = wish_of(choice.gnss)
        same = None if gnss is None else Wish(gnss.text, None, gnss.number)
        often = judges.PERIOD_US
        self.parameters = ReceiverParameters()
        self.imu = Channel(_IMU, wish_of(choice.imu), np.float32)
        self.gnss = Channel(GPS, gnss)
        self.quality = Channel(GPA, same)
        self.mag = Channel(_MAG)
        self.baro = Channel(_BARO)
        self.sim = Channel(judges.SIM, period_us=often)
        self.sim2 = Channel(judges.SIM2, period_us=often)
        self.reference = Channel(judges.REFERENCES, wish_of(choice.reference), period_us=often)
        self.attitude = Channel(judges.ATTITUDE, period_us=often)
        self.origin = Channel(judges.ORIGIN, Wish("0", None, 0))
        self.firmware = Firmware()
        self._all: list[_Reader] = list(vars(self).values())
        self._by_format: dict[Format, list[_Reader]] = {}

    def _readers(self, form: Format) -> list[_Reader]:
        if form not in self._by_format:
            self._by_format[form] = [each for each in self._all if each.fields_of(form)]
        return self._by_format[form]

    def sources(self) -> dict[str, Channel]:
        """Those with readings, as `SensorLog.names` calls them."""
        named = {"imu": self.imu, "gnss": self.gnss, "mag": self.mag, "baro": self.baro}
        return {name: channel for name, channel in named.items() if len(channel)}

    def choices(self) -> dict[str, list[str]]:
        """What can be chosen of those."""
        named = {"imu": self.imu, "gnss": self.gnss, "reference": self.reference}
        return {name: channel.choices for name, channel in named.items()}

    def wanted(self, form: Format) -> tuple[str, ...]:
        """The fields of a message that any of them reads."""
        labels = (label for each in self._readers(form) for label in each.fields_of(form))
        return tuple(dict.fromkeys(labels))

    def take(self, batch: Batch) -> None:
        """Hand a batch to those that read its message."""
        for each in self._readers(batch.format):
            each.take(batch)

    def check(self) -> None:
        """LogFormatError where something was asked for that is not there."""
        self.imu.check("IMU")
        self.gnss.check("GNSS")
        self.reference.check("reference")


def read_dataflash(path: Path, choice: Choice = DEFAULT) -> SensorLog:
    """Read what an estimator needs of a log; LogFormatError where there is no IMU, or not what was chosen.

    The IMU's table is float32, as it was logged, so that hours of it fit into memory.
    """
    channels = _Channels(choice)
    with open_packed(path) as stream:
        is_text = stream.read(3) == b"FMT"
    with open_packed(path) as stream:
        log = (TextLog if is_text else BinaryLog)(stream, channels.wanted)
        for batch in log:
            channels.take(batch)
        fault = fault_of(stream)
    messages = log.survey.messages()
    if not messages:
        raise LogFormatError(f"{path} is not an ArduPilot dataflash log: no messages in it")
    channels.check()
    if not len(channels.imu):
        raise LogFormatError(f"{path} has no IMU messages (IMU, IMT): nothing to estimate from")
    damage = {"skipped_bytes": log.skipped, "unpacking_failed": int(bool(fault))}
    return _sensor_log(channels, {k: v for k, v in damage.items() if v}, messages)


def _sensor_log(
    channels: _Channels, damage: dict[str, int], messages: dict[str, tuple[int, float]]
) -> SensorLog:
    dropped: Counter[str] = Counter()
    sources = channels.sources()
    for channel in sources.values():
        dropped.update(channel.dropped)
    names = {name: str(channel.source) for name, channel in sources.items()}
    # the large ones first: each table is let go of when its readings are made
    truth = judges.truth_of(channels.sim, channels.sim2)
    reference = judges.reference_of(channels.reference, channels.attitude, channels.origin)
    fixes, headings = fixes_of(channels.gnss, channels.quality, dropped)
    if headings:
        names["heading"] = headings[0].source
    mag, baro = readings.NO_FIELDS, readings.NO_LEVELS
    if "mag" in names:
        mag = readings.fields(*thinned(*channels.mag.table.release()), names["mag"])
    if "baro" in names:
        t_us, rows = thinned(*channels.baro.table.release())
        baro = readings.levels(t_us, rows[:, 0], names["baro"])
    for name, judge in (("truth", truth), ("reference", reference)):
        if judge is not None:
            names[name] = judge.source
    receiver = channels.gnss.source
    t_us, imu = channels.imu.table.release()
    return SensorLog(
        ImuTable(t_us, imu[:, 3:], imu[:, :3]),
        fixes,
        headings,
        mag,
        baro,
        truth,
        reference,
        names,
        +dropped,
        damage,
        None if receiver is None else channels.parameters.delay(receiver.number),
        channels.choices(),
        messages,
        channels.firmware.name,
    )
