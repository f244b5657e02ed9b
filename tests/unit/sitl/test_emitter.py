"""What goes over the wire, read back by pymavlink."""

import itertools
import math
import os
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from mavins.cli.main import main as mavins_main
from sitl import scenario
from sitl.command import main
from sitl.emitter import UNIX_AT_BOOT_US, fly, packets
from sitl.simulation import START_US, Simulation, simulate


def decoded(stream):
    parser = dialect.MAVLink(None)
    return [(t_us, parser.decode(bytearray(packet))) for t_us, packet in stream]


def records(data):
    """(UNIX us, packet) of a tlog's bytes."""
    place = 0
    while place < len(data):
        length = data[place + 9] + 12
        yield int.from_bytes(data[place : place + 8], "big"), data[place + 8 : place + 8 + length]
        place += 8 + length


def flown(name, seconds, seed=0):
    stream = packets(Simulation(scenario.load(name), seed))
    end = START_US + seconds * 1_000_000
    return decoded(itertools.takewhile(lambda item: item[0] < end, stream))


@pytest.fixture(scope="module")
def mission():
    return flown("quad_mission", 12)


def of_type(messages, name):
    return [m for _, m in messages if m.get_type() == name]


def test_every_message_has_its_rate(mission):
    counts = Counter(m.get_type() for _, m in mission)
    assert counts == {
        "HEARTBEAT": 12,
        "SYSTEM_TIME": 12,
        "HIGHRES_IMU": 3000,
        "ATTITUDE": 600,
        "GPS_RAW_INT": 60,
        "GLOBAL_POSITION_INT": 60,
        "HIL_STATE_QUATERNION": 600,
    }
    times = [t_us for t_us, _ in mission]
    assert times == sorted(times)


def test_the_vehicle_says_who_it_is(mission):
    heartbeat = of_type(mission, "HEARTBEAT")[0]
    assert heartbeat.type == dialect.MAV_TYPE_QUADROTOR
    assert heartbeat.autopilot == dialect.MAV_AUTOPILOT_GENERIC
    assert {(m.get_srcSystem(), m.get_srcComponent()) for _, m in mission} == {(1, 1)}
    assert [m.get_seq() for _, m in mission] == [k % 256 for k in range(len(mission))]


def test_stamps_are_boot_time(mission):
    for t_us, m in mission:
        own = getattr(m, "time_usec", None) or 1000 * getattr(m, "time_boot_ms", t_us / 1000)
        assert own == t_us
    for clock in of_type(mission, "SYSTEM_TIME"):
        assert clock.time_unix_usec == UNIX_AT_BOOT_US + 1000 * clock.time_boot_ms


def test_the_imu_goes_out_as_measured(mission):
    imu = simulate(scenario.load("quad_mission"), 0, 1.0).imu
    for k, m in enumerate(of_type(mission, "HIGHRES_IMU")[:250]):
        assert m.time_usec == imu.t_us[k]
        assert m.fields_updated == 0x3F
        np.testing.assert_allclose([m.xacc, m.yacc, m.zacc], imu.accel_b[k], rtol=1e-6)
        np.testing.assert_allclose([m.xgyro, m.ygyro, m.zgyro], imu.gyro_b[k], rtol=1e-6)


def test_both_gnss_messages_tell_one_fix(mission):
    raws, positions = (of_type(mission, n) for n in ("GPS_RAW_INT", "GLOBAL_POSITION_INT"))
    fixes = simulate(scenario.load("quad_mission"), 0, 12.0).fixes
    for raw, position, fix in zip(raws, positions, fixes, strict=True):
        assert raw.time_usec == 1000 * position.time_boot_ms == fix.t_us
        assert (raw.lat, raw.lon, raw.alt) == (position.lat, position.lon, position.alt)
        assert raw.lat == pytest.approx(math.degrees(fix.lat) * 1e7, abs=0.6)
        sent = [position.vx, position.vy, position.vz]
        np.testing.assert_allclose(sent, np.multiply(fix.v_l, 100.0), atol=0.6)
        assert (raw.fix_type, raw.satellites_visible) == (3, 14)
        assert (raw.h_acc, raw.v_acc, raw.vel_acc) == (500, 800, 100)
        assert position.relative_alt == pytest.approx(position.alt - 488_000, abs=1)


def test_attitude_is_the_compass_and_nothing_else(mission):
    headings = simulate(scenario.load("quad_mission"), 0, 12.0).headings
    for m, heading in zip(of_type(mission, "ATTITUDE"), headings, strict=True):
        assert m.yaw == pytest.approx(heading.yaw, abs=1e-6)
        assert (m.roll, m.pitch, m.rollspeed, m.pitchspeed, m.yawspeed) == (0, 0, 0, 0, 0)


def test_the_truth_goes_out_as_hil_state(mission):
    states = simulate(scenario.load("quad_mission"), 0, 12.0).states
    for m, state in zip(of_type(mission, "HIL_STATE_QUATERNION"), states, strict=True):
        np.testing.assert_allclose(m.attitude_quaternion, state.sample.q_lb, atol=1e-7)
        assert m.lon == pytest.approx(math.degrees(state.sample.lon) * 1e7, abs=0.6)
        assert m.vz == pytest.approx(100.0 * state.sample.v_l[2], abs=0.6)
        assert m.yawspeed == pytest.approx(state.w_b[2], abs=1e-6)
        assert m.zacc == pytest.approx(state.f_b[2] / 9.80665e-3, abs=1.0)


def test_in_an_outage_the_messages_go_on_without_a_fix():
    messages = flown("gnss_outage", 62)
    raws, positions = (of_type(messages, n) for n in ("GPS_RAW_INT", "GLOBAL_POSITION_INT"))
    assert len(raws) == len(positions) == 310
    out = [k for k, raw in enumerate(raws) if raw.fix_type < 3]
    assert out == list(range(251, 301))  # 50 s to 60 s, the fixes coming 0.12 s late
    assert {raws[k].lat for k in out} == {raws[250].lat}
    assert {positions[k].vx for k in out} == {positions[250].vx}


def test_pacing(monkeypatch):
    now = [7.0]

    def wait(seconds):
        now[0] += seconds

    monkeypatch.setattr("sitl.emitter.time", SimpleNamespace(monotonic=lambda: now[0], sleep=wait))
    stream = [(START_US + 4000 * k, b"") for k in range(500)]
    seen = []
    fly(
        iter(stream),
        lambda t_us, _: seen.append((t_us, now[0])),
        duration=0.4,
        speed=2.0,
        wait=wait,
    )
    assert [t_us for t_us, _ in seen] == [t_us for t_us, _ in stream[:100]]
    assert [at for _, at in seen] == pytest.approx([7.0 + 0.002 * k for k in range(100)])
    seen.clear()
    fly(iter(stream), lambda t_us, _: seen.clear(), speed=math.inf)
    assert seen == []
    fly(iter(stream), lambda t_us, _: seen.append(t_us), stopped=lambda: len(seen) == 3, wait=wait)
    assert len(seen) == 3


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "flight.tlog"
    assert mavins_main(["sitl", "--record", str(path), "--duration", "3", "--speed", "max"]) == 0
    return path


def test_a_recorded_log(log):
    messages = decoded(records(log.read_bytes()))
    assert len(messages) == 3 * 362
    assert [t - UNIX_AT_BOOT_US for t, _ in messages] == [t for t, _ in flown("quad_mission", 3)]


def test_a_seed_gives_the_same_bytes(log, tmp_path):
    own, other = tmp_path / "own.tlog", tmp_path / "other.tlog"
    flags = ["--duration", "3", "--speed", "50"]
    assert main(["--record", str(own), *flags]) == 0
    assert own.read_bytes() == log.read_bytes()
    assert main(["--record", str(other), *flags, "--seed", "1"]) == 0
    assert other.read_bytes() != log.read_bytes()


def test_udp(capsys):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(2.0)
        port = receiver.getsockname()[1]
        flags = ["--duration", "0.1", "--speed", "max", "--sysid", "7", "--compid", "9"]
        assert main(["--udp", f"127.0.0.1:{port}", *flags]) == 0
        parser = dialect.MAVLink(None)
        first = parser.decode(bytearray(receiver.recv(2000)))
        assert first.get_type() == "HEARTBEAT"
        assert (first.get_srcSystem(), first.get_srcComponent()) == (7, 9)
    assert f"to 127.0.0.1:{port}" in capsys.readouterr().err


def test_a_dead_port_is_no_error():
    assert main(["--udp", "127.0.0.1:9", "--duration", "0.2", "--speed", "max"]) == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "nowhere to send the packets"),
        (["--udp", "here"], "'here' is not an address"),
        (["--record", "/none/x.tlog"], "cannot write /none/x.tlog"),
        (["--udp", "127.0.0.1:9", "--scenario", "loop"], "unknown scenario 'loop': use one of"),
    ],
)
def test_a_user_s_mistake_is_one_line(capsys, arguments, message):
    for run in (main, lambda words: mavins_main(["sitl", *words])):
        assert run(arguments) == 2
        error = capsys.readouterr().err.strip()
        assert message in error
        assert "\n" not in error


@pytest.mark.parametrize("word", ["--speed=0", "--duration=-1", "--seed=-1", "--sysid=0"])
def test_a_wrong_number_is_refused(capsys, word):
    with pytest.raises(SystemExit) as stop:
        main(["--udp", "127.0.0.1:9", word])
    assert stop.value.code == 2
    assert "must be" in capsys.readouterr().err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_cleanly(tmp_path, number):
    path = tmp_path / "cut.tlog"
    process = subprocess.Popen(
        [sys.executable, "-m", "sitl", "--record", str(path)],
        stderr=subprocess.PIPE,
        env=os.environ,
    )
    assert process.stderr is not None
    assert process.stderr.readline().startswith(b"flying quad_mission")
    until = time.monotonic() + 20.0
    while (
        not path.stat().st_size
    ):  # what is written waits for some more, and is then some hundred packets
        assert time.monotonic() < until
        time.sleep(0.02)
    process.send_signal(number)
    _, error = process.communicate(timeout=20)
    assert (process.returncode, error) == (0, b"")
    assert len(decoded(records(path.read_bytes()))) > 10
