"""PX4 logs: what they hold, also where they are damaged, in old and new fields; pyulog is the judge of the format."""

from __future__ import annotations

import gzip
import io
import math
import struct
from collections.abc import Callable
from pathlib import Path
from random import Random

import numpy as np
import pytest

from mavins.errors import LogFormatError
from mavins.logs.sensor_log import Choice
from mavins.logs.ulog import read_ulog
from mavins.logs.ulog_file import MAGIC, UlogFile, scan

START = 1_000_000
LETTERS = {"uint64_t": "Q", "uint32_t": "I", "uint8_t": "B", "bool": "?", "int32_t": "i"} | {
    "float": "f",
    "double": "d",
}
COMBINED = (
    "uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;"
    "int32_t accelerometer_timestamp_relative;float[3] accelerometer_m_s2;"
    "uint32_t accelerometer_integral_dt;"
)
IMU = (
    "uint64_t timestamp;uint64_t timestamp_sample;uint32_t device_id;float[3] delta_angle;"
    "float[3] delta_velocity;uint32_t delta_angle_dt;uint32_t delta_velocity_dt;"
)
VELOCITY = "float vel_n_m_s;float vel_e_m_s;float vel_d_m_s;bool vel_ned_valid;"
QUALITY = "float eph;float epv;float s_variance_m_s;uint8_t fix_type;uint8_t satellites_used;"
GPS_OLD = f"uint64_t timestamp;int32_t lat;int32_t lon;int32_t alt;{VELOCITY}{QUALITY}"
GPS = (
    "uint64_t timestamp;uint64_t timestamp_sample;double latitude_deg;double longitude_deg;"
    f"double altitude_msl_m;double altitude_ellipsoid_m;{VELOCITY}{QUALITY}"
)
MAG = "uint64_t timestamp;uint64_t timestamp_sample;float[3] magnetometer_ga;uint8_t[4] _padding0;"
AIR = "uint64_t timestamp;uint64_t timestamp_sample;float baro_alt_meter;"
ATTITUDE = "uint64_t timestamp;uint64_t timestamp_sample;float[4] q;"
LOCAL = (
    "uint64_t timestamp;uint64_t timestamp_sample;float vx;float vy;float vz;"
    "bool v_xy_valid;bool v_z_valid;"
)
GLOBAL = "uint64_t timestamp;uint64_t timestamp_sample;double lat;double lon;float alt;"


class Writer:
    """A small ULog of given topics."""

    def __init__(self) -> None:
        self._formats: dict[str, str] = {}
        self._head = bytearray(MAGIC + b"\x01" + START.to_bytes(8, "little"))
        self._head += self._message("B", bytes(40))
        self._data = bytearray()
        self._ids: dict[tuple[str, int], int] = {}

    def topic(self, name: str, fields: str, instances: int = 1) -> Writer:
        self._head += self._message("F", f"{name}:{fields}".encode())
        self._formats[name] = fields
        for i in range(instances):
            number = len(self._ids)
            self._ids[name, i] = number
            self._data += self._message("A", struct.pack("<BH", i, number) + name.encode())
        return self

    def parameter(self, name: str, value: float) -> Writer:
        key = f"float {name}".encode()
        self._head += self._message("P", bytes([len(key)]) + key + struct.pack("<f", value))
        return self

    def data(self, name: str, *values: object, instance: int = 0) -> Writer:
        layout = "<"
        for part in filter(None, self._formats[name].split(";")):
            kind, _, label = part.partition(" ")
            kind, _, count = kind.partition("[")
            if not label.startswith("_padding"):
                layout += (count.rstrip("]") or "") + LETTERS[kind]
        body = struct.pack(layout, *values)
        number = struct.pack("<H", self._ids[name, instance])
        self._data += self._message("D", number + body)
        return self

    def raw(self, kind: str, payload: bytes) -> Writer:
        self._data += self._message(kind, payload)
        return self

    def bytes(self) -> bytes:
        return bytes(self._head + self._data)

    @staticmethod
    def _message(kind: str, payload: bytes) -> bytes:
        return struct.pack("<HB", len(payload), ord(kind)) + payload


def stamps(seconds: float, rate: float) -> list[int]:
    return [START + round(k * 1e6 / rate) for k in range(int(seconds * rate))]


def flight(seconds: float = 4.0) -> Writer:
    """A vehicle that stands, in the fields of today."""
    w = Writer().parameter("EKF2_GPS_DELAY", 110.0).topic("sensor_combined", COMBINED)
    w.topic("vehicle_imu", IMU, 2).topic("vehicle_gps_position", GPS).topic("sensor_gps", GPS, 2)
    w.topic("vehicle_magnetometer", MAG).topic("vehicle_air_data", AIR)
    w.topic("vehicle_attitude", ATTITUDE).topic("vehicle_local_position", LOCAL)
    w.topic("vehicle_global_position", GLOBAL)
    for k, t in enumerate(stamps(seconds, 200.0)):
        w.data("sensor_combined", t, 0.01, 0.0, 0.0, 5000, 0, 0.0, 0.0, -9.8, 5000)
        for i in (0, 1) if k % 100 == 0 else ():
            angle = (0.02 * 0.004 * (1 + i), 0.0, 0.0)
            w.data("vehicle_imu", t + 300, t, 7, *angle, 0.0, 0.0, -0.0392, 4000, 4000, instance=i)
        if k % 4 == 0:
            w.data("vehicle_magnetometer", t, t - 100, 0.2, 0.0, 0.4)
        if k % 10 == 0:
            w.data("vehicle_air_data", t, t, 12.5)
            w.data("vehicle_attitude", t, t, 1.0, 0.0, 0.0, 0.0)
        if k % 20 == 0:
            w.data("vehicle_local_position", t, t, 1.0 + k, 2.0, 3.0, True, k % 40 == 0)
        if k % 40 == 0:
            w.data("vehicle_global_position", t, t, 47.0, 8.0, 500.0)
            fix = (47.0, 8.0, 500.0, 547.0, 0.1, 0.2, 0.3, True, 0.9, 1.4, 0.2, 3, 14)
            w.data("vehicle_gps_position", t, 0, *fix)
            for i in (0, 1) if k % 200 == 0 else ():
                w.data("sensor_gps", t, 0, 46.0 + i, *fix[1:], instance=i)
    return w


def written(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


def test_all_sensors(tmp_path: Path) -> None:
    log = read_ulog(written(tmp_path / "flight.ulg", flight().bytes()))
    assert log.counts == {
        "sensor_combined": 800,
        "vehicle_gps_position": 20,
        "vehicle_magnetometer": 81,  # of 200, in spells of 50 ms
        "vehicle_air_data": 80,
    }
    # means over 5 ms that end at the stamp
    assert log.imu.t_us[0] == START - 2500
    np.testing.assert_allclose(log.imu.gyro_b[0], [0.01, 0.0, 0.0], rtol=1e-6)
    np.testing.assert_allclose(log.imu.accel_b[0], [0.0, 0.0, -9.8], rtol=1e-6)
    fix = log.gnss[0]
    assert (fix.lat, fix.lon, fix.alt) == (math.radians(47.0), math.radians(8.0), 500.0)
    assert fix.v_l == pytest.approx((0.1, 0.2, 0.3))
    assert (fix.sigma_h, fix.sigma_v, fix.sigma_speed) == pytest.approx((0.9, 1.4, 0.2))
    assert (fix.fix_type, fix.satellites, fix.t_us) == (3, 14, START)
    assert log.gnss_delay == pytest.approx(0.11)
    assert log.baro[0].alt == 12.5
    assert not log.headings
    assert log.truth is None
    assert dict(log.damage) == {}
    assert sum(log.dropped.values()) == 0


def test_where_the_accelerometer_was_clipped(tmp_path: Path) -> None:
    gps = (0.5, 0.15, 500.0, 545.0, 0.0, 0.0, 0.0, True, 0.5, 0.9, 0.2, 3, 14)
    w = Writer().topic("sensor_combined", COMBINED + "uint8_t accelerometer_clipping;")
    w.topic("vehicle_imu", IMU + "uint8_t delta_velocity_clipping;").topic("sensor_gps", GPS)
    for k, t in enumerate(stamps(1.0, 200.0)):
        w.data("sensor_combined", t, 0.0, 0.0, 0.0, 5000, 0, 0.0, 0.0, -9.8, 5000, 4 * (k == 7))
        w.data("vehicle_imu", t, t, 7, *[0.0] * 5, -0.049, 5000, 5000, 3 * (k in (8, 9)))
    w.data("sensor_gps", START, START, *gps)
    path = written(tmp_path / "flight.ulg", w.bytes())
    for imu, where in (("sensor_combined", [7]), ("vehicle_imu.0", [8, 9])):
        clipped = read_ulog(path, Choice(imu=imu)).imu.clipped
        assert clipped is not None
        assert np.flatnonzero(clipped).tolist() == where
    assert read_ulog(written(tmp_path / "old.ulg", flight().bytes())).imu.clipped is None


def test_the_magnetometer_is_averaged_down_to_20_hz(tmp_path: Path) -> None:
    log = read_ulog(written(tmp_path / "flight.ulg", flight().bytes()))
    assert len(log.mag) == pytest.approx(4 * 20, abs=2)
    np.testing.assert_allclose(log.mag[3].field, [0.2, 0.0, 0.4], rtol=1e-6)


def test_the_reference_has_all_at_the_attitude_s_stamps(tmp_path: Path) -> None:
    reference = read_ulog(written(tmp_path / "flight.ulg", flight().bytes())).reference
    assert reference is not None
    assert reference.source == "vehicle"
    assert len(reference) == 80
    np.testing.assert_allclose(reference.q_lb[5], [1, 0, 0, 0])
    np.testing.assert_allclose(reference.v_l[1], [11.0, 2.0, np.nan])
    np.testing.assert_allclose(np.degrees(reference.lla[4, :2]), [47.0, 8.0])
    assert reference.lla[4, 2] == 500.0
    assert np.isnan(reference.lla[-1]).all()  # nothing to interpolate to


def test_other_sources(tmp_path: Path) -> None:
    path = written(tmp_path / "flight.ulg", flight().bytes())
    log = read_ulog(path, Choice(imu="1", gnss="sensor_gps.1"))
    assert log.names["imu"] == "vehicle_imu.1"
    np.testing.assert_allclose(log.imu.gyro_b[0], [0.04, 0.0, 0.0], rtol=1e-6)
    np.testing.assert_allclose(log.imu.accel_b[0], [0.0, 0.0, -9.8], rtol=1e-6)
    assert log.imu.t_us[0] == START - 2000
    assert math.degrees(log.gnss[0].lat) == pytest.approx(47.0)
    assert math.degrees(read_ulog(path, Choice(gnss="0")).gnss[0].lat) == pytest.approx(46.0)
    assert log.choices["imu"] == ["sensor_combined", "vehicle_imu.0", "vehicle_imu.1"]
    with pytest.raises(LogFormatError, match=r"no GNSS called '7'; it has vehicle_gps_position, "):
        read_ulog(path, Choice(gnss="7"))
    with pytest.raises(LogFormatError, match="no reference called 'truth'"):
        read_ulog(path, Choice(reference="truth"))


def test_the_fields_of_old_and_truth_of_a_simulator(tmp_path: Path) -> None:
    w = Writer().topic("sensor_combined", COMBINED).topic("vehicle_gps_position", GPS_OLD)
    for what, fields in (("attitude", ATTITUDE), ("local_position", LOCAL)):
        w.topic(f"vehicle_{what}_groundtruth", fields)
    for t in stamps(2.0, 100.0):
        w.data("sensor_combined", t, 0.0, 0.0, 0.0, 10000, 0, 0.0, 0.0, -9.8, 10000)
        w.data("vehicle_attitude_groundtruth", t, t, 0.0, 0.0, 0.0, 1.0)
        w.data("vehicle_local_position_groundtruth", t, t, 1.0, 2.0, 3.0, True, True)
    moving = (0.1, 0.2, 0.3, False, 0.9, 1.4, 0.2, 4, 9)
    w.data("vehicle_gps_position", START, 473977420, 85455940, 488100, *moving)
    log = read_ulog(written(tmp_path / "flight.ulg", w.bytes()))
    assert math.degrees(log.gnss[0].lat) == pytest.approx(47.3977420, abs=1e-9)
    assert log.gnss[0].alt == pytest.approx(488.1)
    assert log.gnss[0].v_l is None
    assert log.gnss_delay is None
    assert log.truth is not None
    np.testing.assert_allclose(log.truth.q_lb[0], [0, 0, 0, 1])
    np.testing.assert_allclose(log.truth.v_l[3], [1.0, 2.0, 3.0])
    assert log.reference is None


def test_fixes_that_tell_when_they_were_measured(tmp_path: Path) -> None:
    w = flight(1.0).topic("unused", AIR)
    for k in range(20):
        t = START + 2_000_000 + k
        fix = (47.0, 8.0, 500.0, 547.0, 0.1, 0.2, 0.3, True, 0.9, 1.4, 0.2, 3, 14)
        w.data("sensor_gps", t, t - 90_000, *fix)
    log = read_ulog(written(tmp_path / "flight.ulg", w.bytes()), Choice(gnss="0"))
    assert log.gnss[-1].t_us == START + 2_000_019 - 90_000
    assert log.gnss_delay == 0.0


def test_disorder_repetitions_and_wild_stamps(tmp_path: Path) -> None:
    w = Writer().topic("sensor_combined", COMBINED)
    times = stamps(1.0, 100.0)
    times[10], times[11] = times[11], times[10]
    times[20] = times[19]
    times[30] += 1 << 44
    for t in times:
        w.data("sensor_combined", t, 0.0, 0.0, 0.0, 10000, 0, 0.0, 0.0, -9.8, 10000)
    w.data("sensor_combined", t + 10000, math.nan, 0.0, 0.0, 10000, 0, 0.0, 0.0, -9.8, 10000)
    w.data("sensor_combined", t + 20000, 1e30, 0.0, 0.0, 10000, 0, 0.0, 0.0, -9.8, 10000)
    log = read_ulog(written(tmp_path / "flight.ulg", w.bytes()))
    assert len(log.imu) == 98
    assert (np.diff(log.imu.t_us) > 0).all()
    assert log.dropped["imu repeated"] == 1
    assert log.dropped["imu wild stamp"] == 1
    assert log.dropped["imu unusable"] == 2
    assert log.damage["imu_backwards"] == 1


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"", "is empty"),
        (b"nothing", "is not a PX4 .ulg"),
        (MAGIC, "is not a PX4 .ulg"),
        (Writer().topic("vehicle_air_data", AIR).bytes(), "has no IMU"),
        (MAGIC + bytes(9) + Writer._message("B", bytes(8) + b"\x02" + bytes(31)), "not known here"),
    ],
)
def test_what_cannot_be_read_is_one_line(tmp_path: Path, data: bytes, told: str) -> None:
    with pytest.raises(LogFormatError, match=told) as caught:
        read_ulog(written(tmp_path / "flight.ulg", data))
    assert "\n" not in str(caught.value)


WANTED = {"sensor_combined": ("timestamp", "gyro_rad"), "vehicle_attitude": ("timestamp", "q")}


def scanned(data: bytes) -> UlogFile:
    return scan(io.BytesIO(data), WANTED)


def test_a_cut_off_log_keeps_what_is_whole(tmp_path: Path) -> None:
    data = flight().bytes()
    whole = scanned(data)
    cut = scanned(data[: len(data) * 2 // 3 + 5])
    n = cut.counts["sensor_combined", 0]
    assert 500 < n < 560
    kept = cut.topics["sensor_combined", 0]
    np.testing.assert_array_equal(kept, whole.topics["sensor_combined", 0][:n])
    assert 0 < cut.skipped < 100
    packed = gzip.compress(data)
    log = read_ulog(written(tmp_path / "flight.ulg.gz", packed[: len(packed) * 2 // 3]))
    assert 100 < len(log.imu) < 800
    assert log.damage["unpacking_failed"] == 1


def test_damage_costs_no_more_than_it_hits() -> None:
    data = bytearray(flight(20.0).bytes())
    whole = scanned(bytes(data)).counts.total()
    random = Random(3)
    for _ in range(40):
        data[random.randrange(4000, len(data))] ^= 1 << random.randrange(8)
    hurt = scanned(bytes(data))
    # a bit of a length or an id costs the message, and where the next begins is found again
    assert whole - hurt.counts.total() < 40
    assert hurt.skipped < 40 * 200
    gone = bytes(data[:20_000]) + random.randbytes(3000) + bytes(data[23_000:])
    lost = scanned(gone)
    assert 2900 < lost.skipped < 6000
    assert lost.counts.total() > hurt.counts.total() - 100


def test_junk_never_raises() -> None:
    random = Random(5)
    data = flight(0.5).bytes()
    for k in range(60):
        hurt = bytearray(data)
        begin = random.randrange(16, len(hurt))
        hurt[begin : begin + 200] = random.randbytes(200 if k % 2 else 20)
        try:
            found = scanned(bytes(hurt))
        except LogFormatError:
            continue  # the flags say that it is of an unknown kind
        assert found.skipped <= len(hurt)


@pytest.mark.parametrize(
    "fields",
    [
        "loop x;",
        "float x;",
        "uint64_t timestamp;float[-3] x;",
        "uint64_t timestamp;no_such x;",
        "(",
    ],
)
def test_a_format_that_makes_no_sense_is_passed_over(fields: str) -> None:
    w = flight(0.1)
    whole = scanned(w.bytes()).counts
    w._head += Writer._message("F", f"loop:{fields}".encode())
    w.raw("A", struct.pack("<BH", 0, 300) + b"loop").raw("D", struct.pack("<HQf", 300, START, 1.0))
    found = scanned(w.bytes())
    assert found.skipped > 0
    assert found.counts == whole


def test_pieces_do_not_show(monkeypatch: pytest.MonkeyPatch) -> None:
    data = (
        flight(1.0).raw("O", struct.pack("<H", 250)).raw("S", b"\x2f\x73\x13\x20\x25\x0c\xbb\x12")
    )
    whole = scanned(data.bytes())
    monkeypatch.setattr("mavins.logs.ulog_file._PIECE", 777)
    parts = scanned(data.bytes())
    assert parts.counts == whole.counts
    assert (parts.skipped, parts.dropouts, parts.dropout_ms) == (0, 1, 250)
    for topic, rows in whole.topics.items():
        np.testing.assert_array_equal(parts.topics[topic], rows)


def test_a_message_ends_where_data_were_appended() -> None:
    """After a crash PX4 appends to the log, whatever its last message was."""
    data = bytearray(flight(1.0).bytes())
    edge = len(data) - 20  # in the midst of the last message
    data[16 + 3 + 8] = 1
    data[16 + 3 + 16 : 16 + 3 + 24] = edge.to_bytes(8, "little")
    number = 0
    body = struct.pack("<HQ3fIi3fI", number, 5_000_000, 9.0, 0, 0, 5000, 0, 0, 0, -9.8, 5000)
    appended = bytes(data[:edge]) + Writer._message("D", body)
    found = scanned(appended)
    assert found.topics["sensor_combined", 0]["timestamp"][-1] == 5_000_000
    assert found.skipped > 0


def test_pyulog_reads_the_same(shared: Callable[[str], Path]) -> None:
    pyulog = pytest.importorskip("pyulog", reason="needs pyulog, of the extra test")
    import lzma

    data = lzma.decompress(shared("data/flights/quad_px4_mr_tropic.ulg.xz").read_bytes())
    theirs = pyulog.ULog(io.BytesIO(data))
    ours = scanned(data)
    assert ours.skipped == 0
    assert dict(ours.counts) == {
        (d.name, d.multi_id): len(d.data["timestamp"]) for d in theirs.data_list
    }
    assert ours.parameters == pytest.approx(theirs.initial_parameters)
    for (name, i), rows in ours.topics.items():
        dataset = theirs.get_dataset(name, i).data
        for label in rows.dtype.names or ():
            values = rows[label]
            for k in range(values.shape[1]) if values.ndim > 1 else ():
                np.testing.assert_array_equal(values[:, k], dataset[f"{label}[{k}]"])
            if values.ndim == 1:
                np.testing.assert_array_equal(values, dataset[label])
