"""ArduPilot dataflash logs: what is read of them, binary and as text, intact and damaged."""

from __future__ import annotations

import lzma
import math
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from mavins.errors import LogFormatError
from mavins.logs.content import kind_of
from mavins.logs.dataflash import read_dataflash
from mavins.logs.dataflash.binary import BinaryLog
from mavins.logs.dataflash.formats import CHARACTERS, HEADER, format_of
from mavins.logs.dataflash.tables import Table, forward
from mavins.logs.sensor_log import Choice, SensorLog
from mavins.nav.so3 import quat_to_euler

FORMATS = {
    "IMU": ("QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "IMT": ("QBfffffffff", "TimeUS,I,DelT,DelvT,DelaT,DelAX,DelAY,DelAZ,DelVX,DelVY,DelVZ"),
    "GPS": ("QBBBcLLeffff", "TimeUS,I,Status,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,Yaw"),
    "GPA": ("QBCCCfBI", "TimeUS,I,HAcc,VAcc,SAcc,YAcc,VV,SMS"),
    "MAG": ("QBhhh", "TimeUS,I,MagX,MagY,MagZ"),
    "BARO": ("QBf", "TimeUS,I,Alt"),
    "PARM": ("QNf", "TimeUS,Name,Value"),
    "MSG": ("QZ", "TimeUS,Message"),
    "ORGN": ("QBLLe", "TimeUS,Type,Lat,Lng,Alt"),
    "XKF1": ("QBccCffffff", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD"),
    "POS": ("QLLf", "TimeUS,Lat,Lng,Alt"),
    "ATT": ("Qfff", "TimeUS,Roll,Pitch,Yaw"),
    "SIM": ("QccCfLLffff", "TimeUS,Roll,Pitch,Yaw,Alt,Lat,Lng,Q1,Q2,Q3,Q4"),
    "SIM2": ("Qdddfff", "TimeUS,PN,PE,PD,VN,VE,VD"),
    "IMU2": ("Qffffff", "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
}
_STRUCT = {"n": "4s", "N": "16s", "Z": "64s", "c": "h", "C": "H", "e": "i", "E": "I", "L": "i"}
Message = tuple[str, Sequence[float | str]]


def binary(messages: Sequence[Message]) -> bytes:
    """A log as the autopilot writes it, whose FMT come first."""
    numbers = {name: 130 + k for k, name in enumerate(FORMATS)}
    numbers["FMT"] = 128
    out = b""
    for name, (characters, labels) in {"FMT": ("BBnNZ", "Type,Length"), **FORMATS}.items():
        size = sum(np.dtype(CHARACTERS[c][0]).itemsize for c in characters)
        fields = (name.encode(), characters.encode(), labels.encode())
        out += b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", numbers[name], HEADER + size, *fields)
    for name, values in messages:
        characters = FORMATS[name][0]
        packed = [
            v.encode() if isinstance(v, str) else v if c in "fd" else round(v / CHARACTERS[c][1])
            for c, v in zip(characters, values, strict=True)
        ]
        form = "<" + "".join(_STRUCT.get(c, c) for c in characters)
        out += bytes([0xA3, 0x95, numbers[name]]) + struct.pack(form, *packed)
    return out


def text(messages: Sequence[Message]) -> bytes:
    """The same as ground stations write it."""
    lines = [
        f"FMT, {130 + k}, 89, {name}, {characters}, {labels}"
        for k, (name, (characters, labels)) in enumerate(FORMATS.items())
    ]
    lines += [", ".join([name, *map(str, values)]) for name, values in messages]
    return ("\n".join(lines) + "\n").encode()


def imu(n: int, start: int = 1_000_000, sensor: int = 0, x: float = 0.5) -> list[Message]:
    return [("IMU", (start + 2500 * k, sensor, 0.25, 0, 0, x, 0, -9.75)) for k in range(n)]


FLIGHT: list[Message] = [
    ("MSG", (900_000, "ArduCopter V4.7.0-dev (2a929aea)")),
    ("PARM", (900_000, "GPS1_TYPE", 1.0)),
    ("ORGN", (1_000_000, 0, -35.25, 149.5, 584.0)),
    ("ORGN", (1_000_000, 1, -10.0, 10.0, 0.0)),
    *[m for pair in zip(imu(4), imu(4, sensor=1, x=-0.5), strict=True) for m in pair],
    ("GPS", (1_005_000, 0, 6, 11, 1.21, -35.25, 149.5, 600.25, 2.0, 90.0, -0.5, 0.0)),
    ("GPA", (1_005_000, 0, 0.3, 0.4, 0.02, 0.0, 1, 970)),
    ("GPS", (1_205_000, 0, 3, 0, 1.21, -35.25, 149.5, 600.25, 2.0, 180.0, -0.5, 360.0)),
    ("GPA", (1_205_000, 0, 0.0, 0.4, 0.02, 2.0, 0, 1170)),
    ("GPS", (1_405_000, 0, 1, 0, 1.21, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)),
    ("GPA", (1_405_000, 0, 0.0, 0.4, 0.02, 2.0, 0, 1170)),
    ("MAG", (1_000_000, 0, 227, -70, -528)),
    ("MAG", (1_100_000, 0, 0, 0, 0)),
    ("BARO", (1_000_000, 0, 16.5)),
    ("XKF1", (900_000, 0, 1.0, -2.0, 355.0, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0)),
    ("XKF1", (1_000_000, 0, 1.0, -2.0, 355.0, 1.0, 2.0, 3.0, 100.0, 0.0, -7.0)),
    ("XKF1", (1_000_000, 1, 9.0, -2.0, 355.0, 1.0, 2.0, 3.0, 100.0, 0.0, -7.0)),
    ("POS", (1_000_000, -35.5, 149.5, 590.0)),
    ("ATT", (900_000, 2.0, 0.0, 350.0)),
    ("ATT", (1_100_000, 4.0, 0.0, 350.0)),
]


@pytest.fixture(params=[binary, text])
def write(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[..., Path]:
    def write(messages: Sequence[Message]) -> Path:
        path = tmp_path / "log"
        path.write_bytes(request.param(messages))
        return path

    return write


def written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def test_all_tables(write: Callable[..., Path]) -> None:
    path = write(FLIGHT)
    assert kind_of(path) == "dataflash"
    log = read_dataflash(path)
    assert log.imu.t_us.tolist() == [1_000_000, 1_002_500, 1_005_000, 1_007_500]
    assert log.imu.gyro_b[0].tolist() == [0.25, 0, 0]
    assert log.imu.accel_b[3].tolist() == [0.5, 0, -9.75]
    assert [sample.field.tolist() for sample in log.mag] == [[227, -70, -528]]
    assert [(sample.t_us, sample.alt) for sample in log.baro] == [(1_000_000, 16.5)]
    assert log.damage == {}
    assert log.dropped == {"MAG[0] not a reading": 1, "GPS[0] repeated": 1}
    assert log.about == "ArduCopter V4.7.0-dev (2a929aea)"
    assert log.messages["IMU"] == (8, pytest.approx(7 / 0.0075))
    assert log.messages["PARM"] == (1, 0.0)
    assert log.choices["imu"] == ["IMU[0]", "IMU[1]"]
    assert log.names["reference"] == "XKF1[0]"


def test_a_fix_has_the_stamp_of_its_arrival(write: Callable[..., Path]) -> None:
    log = read_dataflash(write(FLIGHT))
    first, second = log.gnss
    assert (first.t_us, second.t_us) == (970_000, 1_170_000)
    assert (first.lat, first.lon) == pytest.approx((math.radians(-35.25), math.radians(149.5)))
    assert (first.alt, first.fix_type, first.satellites) == (600.25, 6, 11)
    assert first.v_l == pytest.approx((0.0, 2.0, -0.5))
    assert (first.sigma_h, first.sigma_v, first.sigma_speed) == pytest.approx((0.3, 0.4, 0.02))
    assert second.satellites is None
    assert second.sigma_h is None
    assert second.v_l is not None
    assert math.isnan(second.v_l[2])  # the receiver says that it has no vertical velocity
    assert log.gnss_delay == 0.14


def test_a_heading_of_two_antennas(write: Callable[..., Path]) -> None:
    (heading,) = read_dataflash(write(FLIGHT)).headings
    assert heading.yaw == pytest.approx(0.0)
    assert heading.sigma == pytest.approx(math.radians(2.0))
    assert heading.source == "GPS[0].Yaw"


def test_other_sources(write: Callable[..., Path]) -> None:
    path = write(FLIGHT)
    assert read_dataflash(path, Choice(imu="1")).imu.accel_b[0, 0] == -0.5
    assert read_dataflash(path, Choice(imu="IMU[1]")).names["imu"] == "IMU[1]"
    second = read_dataflash(path, Choice(reference="XKF1[1]")).reference
    assert second is not None
    assert np.degrees(quat_to_euler(second.q_lb[0])) == pytest.approx([9.0, -2.0, -5.0])
    with pytest.raises(LogFormatError, match=r"no IMU called '2'; it has IMU\[0\], IMU\[1\]"):
        read_dataflash(path, Choice(imu="2"))
    with pytest.raises(LogFormatError, match=r"no GNSS called 'x'; it has GPS\[0\]"):
        read_dataflash(path, Choice(gnss="x"))


def test_a_reference_from_its_origin(write: Callable[..., Path]) -> None:
    reference = read_dataflash(write(FLIGHT)).reference
    assert reference is not None
    assert np.isnan(reference.lla[0]).all()  # before there is an origin
    north = math.degrees(100.0 / 6378100.0)
    assert_allclose(np.degrees(reference.lla[1, :2]), [-35.25 + north, 149.5], atol=1e-9)
    assert reference.lla[1, 2] == pytest.approx(591.0)
    assert reference.v_l[1].tolist() == [1, 2, 3]
    assert np.degrees(quat_to_euler(reference.q_lb[1])) == pytest.approx([1.0, -2.0, -5.0])


def test_a_reference_of_position_and_attitude(write: Callable[..., Path]) -> None:
    reference = read_dataflash(write(FLIGHT), Choice(reference="POS")).reference
    assert reference is not None
    assert reference.source == "POS[0], ATT"
    assert_allclose(np.degrees(reference.lla[0, :2]), [-35.5, 149.5])
    assert np.isnan(reference.v_l).all()
    assert np.degrees(quat_to_euler(reference.q_lb[0])) == pytest.approx(
        [3.0, 0.0, -10.0], abs=0.01
    )


@pytest.mark.parametrize(
    ("parameters", "delay"),
    [
        ({}, 0.14),
        ({"GPS_TYPE": 2.0}, 0.12),
        ({"GPS1_TYPE": 5.0}, 0.2),
        ({"GPS1_TYPE": 5.0, "GPS1_DELAY_MS": 220.0}, 0.22),
        ({"GPS2_DELAY_MS": 220.0}, 0.14),
    ],
)
def test_the_delay_is_as_set_or_by_type(
    write: Callable[..., Path], parameters: dict[str, float], delay: float
) -> None:
    told: list[Message] = [("PARM", (1, name, value)) for name, value in parameters.items()]
    assert read_dataflash(write([*FLIGHT, *told])).gnss_delay == pytest.approx(delay)


def test_increments_become_means(write: Callable[..., Path]) -> None:
    step = (0.004, 0.004, 0.002, 0.001, 0, 0, 0, 0, -0.04)
    rows: list[Message] = [("IMT", (1_000_000 + 4000 * k, 0, *step)) for k in range(3)]
    log = read_dataflash(write(rows))
    assert log.names["imu"] == "IMT[0]"
    assert log.imu.t_us.tolist() == [998_000, 1_002_000, 1_006_000]  # the middle of the interval
    assert_allclose(log.imu.gyro_b[0], [0.5, 0, 0], rtol=1e-6)
    assert_allclose(log.imu.accel_b[0], [0, 0, -10.0], rtol=1e-6)
    assert read_dataflash(write([*rows, *imu(2)])).names["imu"] == "IMU[0]"


def test_older_logs_have_a_message_for_each_sensor(write: Callable[..., Path]) -> None:
    second: Message = ("IMU2", (1_000_000, 0, 0, 0, 0, 0, -9.0))
    log = read_dataflash(write([*imu(2), second]), Choice(imu="1"))
    assert log.names["imu"] == "IMU[1]"
    assert log.imu.accel_b[0, 2] == -9.0


def simulated(lifted: float) -> list[Message]:
    """A simulated vehicle that stands; SIM says of its last instants that it is higher, SIM2 does not."""
    q = (math.cos(0.5), 0, 0, math.sin(0.5))
    sim: list[Message] = [
        (
            "SIM",
            (1_000_000 + 100_000 * k, 0, 0, 57.3, 590.0 + lifted * (k > 6), -35.25, 149.5, *q),
        )
        for k in range(9)
    ]
    sim2: list[Message] = [
        ("SIM2", (1_000_000 + 50_000 * k, 0, 40.0, -6.0, 0, 0, 0)) for k in range(17)
    ]
    return [*imu(200), *sim, *sim2]


def test_truth_of_two_messages(write: Callable[..., Path]) -> None:
    truth = read_dataflash(write(simulated(0.0))).truth
    assert truth is not None
    assert truth.source == "SIM2[0], SIM[0]"
    assert len(truth) == 17
    assert_allclose(np.degrees(truth.lla[:, :2]), np.tile([-35.25, 149.5], (17, 1)), atol=1e-9)
    assert_allclose(truth.lla[:, 2], 590.0, atol=1e-6)
    assert quat_to_euler(truth.q_lb[3]) == pytest.approx([0, 0, 1.0])
    assert (truth.v_l == 0.0).all()


def test_what_the_simulator_contradicts_is_no_truth(write: Callable[..., Path]) -> None:
    truth = read_dataflash(write(simulated(0.2))).truth
    assert truth is not None
    assert np.isfinite(truth.lla[:13]).all()
    assert np.isnan(truth.lla[13:]).all()
    assert np.isnan(truth.v_l[13:]).all()
    agreed = read_dataflash(write(simulated(0.02))).truth
    assert agreed is not None
    assert np.isfinite(agreed.v_l).all()


def test_no_gnss(write: Callable[..., Path]) -> None:
    log = read_dataflash(write(imu(3)))
    assert (len(log.gnss), log.gnss_delay) == (0, None)


def test_no_imu(write: Callable[..., Path]) -> None:
    with pytest.raises(LogFormatError, match="has no IMU messages"):
        read_dataflash(write([("BARO", (1, 0, 1.0))]))


@pytest.mark.parametrize("data", [b"FMT", b"\xa3\x95\x80", b"hello" * 1000, bytes(4096)])
def test_what_is_no_log(tmp_path: Path, data: bytes) -> None:
    with pytest.raises(LogFormatError, match="no messages in it"):
        read_dataflash(written(tmp_path / "log", data))
    with pytest.raises(LogFormatError, match="is empty"):
        read_dataflash(written(tmp_path / "log", b""))


def test_bad_stamps_and_readings(write: Callable[..., Path]) -> None:
    rows = imu(20)
    rows[5] = ("IMU", (2**61, *rows[5][1][1:]))
    rows[8] = ("IMU", (3, *rows[8][1][1:]))
    rows[12] = rows[11]
    rows[15] = ("IMU", (*rows[15][1][:5], 1e9, 0, 0))
    rows[16] = ("IMU", (*rows[16][1][:5], math.nan, 0, 0))
    log = read_dataflash(write(rows))
    assert log.dropped == {"IMU[0] stamp not in order": 3, "IMU[0] not a reading": 2}
    kept = [k for k in range(20) if k not in (5, 8, 12, 15, 16)]
    assert log.imu.t_us.tolist() == [1_000_000 + 2500 * k for k in kept]


def test_a_log_that_is_cut_off(tmp_path: Path) -> None:
    data = binary(imu(10))
    log = read_dataflash(written(tmp_path / "log", data[:-20]))
    assert (len(log.imu), log.damage) == (9, {"skipped_bytes": 16})
    packed = lzma.compress(binary(imu(20_000)))
    log = read_dataflash(written(tmp_path / "log", packed[: len(packed) // 2]))
    assert 100 < len(log.imu) < 20_000
    assert log.damage["unpacking_failed"] == 1
    log = read_dataflash(written(tmp_path / "log", text(imu(10))[:-3]))
    assert len(log.imu) == 10
    log = read_dataflash(written(tmp_path / "log", text(imu(10))[:-20]))
    assert (len(log.imu), log.damage) == (9, {"skipped_bytes": 23})


def test_damage_costs_only_what_it_hits(tmp_path: Path) -> None:
    data = bytearray(binary(imu(100)))
    size = len(binary(imu(1))) - len(binary([]))
    for k in (20, 40, 60):
        data[len(data) - k * size] ^= 0x10  # the first byte of a header
    data[len(data) - 80 * size + 2] = 128  # an IMU that says that it is a FMT
    data[-10 * size : -10 * size] = bytes(1000)  # and a gap
    log = read_dataflash(written(tmp_path / "log", bytes(data)))
    assert len(log.imu) == 96
    assert log.damage == {"skipped_bytes": 4 * size + 1000}


class Slow:
    """A file of which a few bytes come at a time."""

    def __init__(self, data: bytes, step: int) -> None:
        self.data, self.step, self.pos = data, step, 0

    def read(self, _: int) -> bytes:
        self.pos += self.step
        return self.data[self.pos - self.step : self.pos]


@pytest.mark.parametrize("step", [1, 7, 100])
def test_it_does_not_matter_how_the_bytes_come(step: int) -> None:
    data = bytearray(binary(FLIGHT))
    data[-300] ^= 0xFF
    data[-40] ^= 0xFF
    found = []
    for size in (step, len(data)):
        log = BinaryLog(Slow(bytes(data), size), lambda form: form.labels[:1])  # type: ignore[arg-type]
        rows = [(batch.format.name, t) for batch in log for t in batch.t_us.tolist()]
        found.append((sorted(rows), log.skipped))
    assert found[0] == found[1]


@pytest.mark.parametrize(
    ("stamps", "after", "kept"),
    [
        ([1, 2, 3], -1, [0, 1, 2]),
        ([1, 2, 2, 3], -1, [0, 1, 3]),
        ([1, 9, 2, 3], -1, [0, 2, 3]),
        ([4, 1, 5, 6], 3, [0, 2, 3]),
        ([1, 2, 3, 10**12], -1, [0, 1, 2]),
        ([1, 10**8, 10**8 + 1, 10**8 + 2], -1, [1, 2, 3]),
        ([-1, -1], -1, []),
    ],
)
def test_stamps_go_forward(stamps: list[int], after: int, kept: list[int]) -> None:
    assert forward(np.array(stamps), after).tolist() == kept


@pytest.mark.parametrize(
    "parts",
    [("GPS", "QB", "TimeUS"), ("GPS", "Q?", "A,B"), ("GPS", "QQ", "A,A"), ("G\0", "Q", "A")],
)
def test_damaged_formats_are_none(parts: tuple[str, str, str]) -> None:
    assert format_of(*parts) is None


def test_a_table_may_begin_with_nothing_usable() -> None:
    table = Table()
    table.append(np.empty(0, np.int64), np.empty((0, 3)))
    table.append(np.array([5]), np.array([[1.0, 2.0, 3.0]]))
    assert (table.t_us.tolist(), table.rows.tolist()) == ([5], [[1.0, 2.0, 3.0]])


flips = st.lists(st.tuples(st.floats(0, 1), st.integers(1, 255)), max_size=40)


@pytest.mark.parametrize("kind", [binary, text])
@given(flips=flips, cut=st.floats(0, 1))
@settings(max_examples=60)
def test_damage_raises_nothing_else(
    tmp_path_factory: pytest.TempPathFactory,
    kind: Callable[[Sequence[Message]], bytes],
    flips: list[tuple[float, int]],
    cut: float,
) -> None:
    data = bytearray(kind([*FLIGHT, *simulated(0.0)[:30]]))
    for where, mask in flips:
        data[int(where * (len(data) - 1))] ^= mask
    if cut > 0.5:
        del data[int(cut * len(data)) :]
    path = tmp_path_factory.getbasetemp() / f"flipped-{kind.__name__}"
    path.write_bytes(data)
    try:
        log = read_dataflash(path)
    except LogFormatError:
        return
    assert isinstance(log, SensorLog)
    assert (np.diff(log.imu.t_us) > 0).all()
    assert np.isfinite(log.imu.accel_b).all()


@pytest.mark.slow
def test_the_same_as_pymavlink_reads(shared: Callable[[str], Path], tmp_path: Path) -> None:
    from pymavlink import DFReader

    packed = shared("recordings/ap_copter_square_circle.BIN.xz")
    with lzma.open(packed) as stream:
        part = stream.read(3_000_000)
    plain = written(tmp_path / "log.BIN", part)
    wanted = {"IMU": "I", "GPS": "I", "MAG": "I", "BARO": "I", "SIM2": None, "XKF1": "C"}
    rows: dict[str, list[dict[str, float]]] = {name: [] for name in wanted}
    reader = DFReader.DFReader_binary(str(plain))
    counts = dict.fromkeys(rows, 0)
    while (message := reader.recv_match(type=list(wanted))) is not None:
        row = message.to_dict()
        name = row["mavpackettype"]
        counts[name] += 1
        if not row.get(wanted[name] or "", 0):
            rows[name].append(row)
    log = read_dataflash(plain)

    def stacked(name: str, *labels: str) -> np.ndarray:
        return np.array([[row[label] for label in labels] for row in rows[name]])

    assert {name: log.messages[name][0] for name in counts} == counts
    assert_allclose(log.imu.t_us, stacked("IMU", "TimeUS")[:, 0])
    assert_allclose(log.imu.gyro_b, stacked("IMU", "GyrX", "GyrY", "GyrZ"))
    assert_allclose(log.imu.accel_b, stacked("IMU", "AccX", "AccY", "AccZ"))
    told = stacked("GPS", "Lat", "Lng", "Alt")
    fixes = np.array([[math.degrees(f.lat), math.degrees(f.lon), f.alt] for f in log.gnss])
    assert_allclose(fixes, told, atol=1e-9)
    assert_allclose([s.field for s in log.mag], stacked("MAG", "MagX", "MagY", "MagZ"))
    assert_allclose([s.alt for s in log.baro], stacked("BARO", "Alt")[:, 0])
    assert log.reference is not None
    assert_allclose(log.reference.v_l, stacked("XKF1", "VN", "VE", "VD"))
    assert log.dropped == {}
