"""`mavins info` and `mavins play`, as a user starts them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from mavins.cli.main import main
from mavins.cli.play import due_times
from mavins.logs.tlog import TlogWriter, read_tlog
from mavins.mavlink.codec import frame, heartbeat, highres_imu
from mavins.transports.udp import UdpTransport
from mavins.types import ImuSample

T0 = 1_750_000_000_000_000


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Half a second of system 8, with a ground station (255) and a camera (8, component 100)
    between.
    """
    path = tmp_path / "flight.tlog"
    with TlogWriter(path) as writer:
        writer.write(T0, frame(heartbeat(6, 8), 255, 190, 0))
        writer.write(T0, frame(heartbeat(2, 12), 8, 1, 0))
        writer.write(T0, frame(heartbeat(30, 8), 8, 100, 0))
        for k in range(125):
            sample = ImuSample(1_000_000 + 4000 * k, np.array([0.0, 0.0, -9.8]), np.zeros(3))
            writer.write(T0 + 4000 * k, frame(highres_imu(sample), 8, 1, k))
    return path


@pytest.fixture
def listener() -> Iterator[UdpTransport]:
    transport = UdpTransport.bind("127.0.0.1", 0)
    yield transport
    transport.close()


def target(listener: UdpTransport) -> str:
    host, port = listener.address
    return f"{host}:{port}"


def everything(listener: UdpTransport) -> list[bytes]:
    got: list[bytes] = []
    while batch := listener.recv(0.2):
        got += [data for data, _ in batch]
    return got


def test_info(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(log)]) == 0
    out = capsys.readouterr().out
    for piece in (
        "128 packets",
        "vehicle 8, component 1: QUADROTOR, autopilot PX4",
        "HIGHRES_IMU id 0, 125 samples at 250.0 Hz",
        "GPS_RAW_INT, delay 0 s",
        "attitude, at most 5 Hz",
        "truth      none",
        "messages of system 255, component 190",
        "0 packets with a wrong checksum",
    ):
        assert piece in out


@pytest.mark.parametrize("command", [["info"], ["play", "--udp", "127.0.0.1:9"]])
def test_an_unreadable_log_is_one_line_and_status_2(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    nonsense = tmp_path / "nonsense.tlog"
    nonsense.write_text("this is no log")
    for path in (nonsense, tmp_path / "missing.tlog"):
        assert main([*command, str(path)]) == 2
        err = capsys.readouterr().err
        assert str(path) in err
        assert len(err.splitlines()) == 1


def test_play_sends_one_vehicle_whole_and_in_order(
    log: Path, listener: UdpTransport, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["play", str(log), "--udp", target(listener), "--speed", "max"]) == 0
    frames = read_tlog(log)
    mine = frames.select(frames.sysid == 8)
    assert everything(listener) == [mine.packet(i) for i in range(len(mine))]
    assert "sent 127 of 127 packets of system 8" in capsys.readouterr().err


def test_play_keeps_the_pace_and_takes_what_comes_back(log: Path, listener: UdpTransport) -> None:
    arrivals: list[float] = []

    def answer() -> None:
        while len(arrivals) < 127 and time.monotonic() < start + 30.0:
            for _, address in listener.recv(1.0):
                arrivals.append(time.monotonic())
                listener.send(b"an answer", address)

    start = time.monotonic()
    thread = threading.Thread(target=answer)
    thread.start()
    assert main(["play", str(log), "--udp", target(listener), "--speed", "2"]) == 0
    thread.join()
    assert len(arrivals) == 127
    # 0.496 s of log in half the time; a loaded machine may be late, never early
    assert arrivals[-1] - start >= 0.248


def test_play_of_another_system(log: Path, listener: UdpTransport) -> None:
    arguments = ["play", str(log), "--udp", target(listener), "--speed", "max", "-q"]
    assert main([*arguments, "--sysid", "255"]) == 0
    assert len(everything(listener)) == 1
    assert main([*arguments, "--sysid", "77"]) == 2


def test_play_into_nothing_says_so(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with_port = UdpTransport.bind("127.0.0.1", 0)
    port = with_port.address[1]
    with_port.close()
    assert main(["play", str(log), "--udp", f"127.0.0.1:{port}", "--speed", "20"]) == 0
    assert "nobody listened" in capsys.readouterr().err


def test_ctrl_c_ends_play_with_130(
    log: Path, listener: UdpTransport, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(self: UdpTransport, data: bytes, address: object = None) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(UdpTransport, "send", interrupted)
    assert main(["play", str(log), "--udp", target(listener)]) == 130


@pytest.mark.parametrize("speed", ["0", "-1", "nan", "inf", "fast"])
def test_speeds_that_make_no_sense(
    speed: str, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["play", str(log), "--udp", "127.0.0.1:9", f"--speed={speed}"])
    assert ended.value.code == 2
    assert "or 'max'" in capsys.readouterr().err


def test_a_recorder_whose_clock_stepped_back_does_not_hurry(tmp_path: Path) -> None:
    path = tmp_path / "stepped.tlog"
    with TlogWriter(path) as writer:
        for k, t in enumerate([0, 1_000_000, 400_000, 1_500_000]):
            writer.write(T0 + t, frame(heartbeat(2, 12), 8, 1, k))
    assert due_times(read_tlog(path), 2.0) == [0.0, 0.5, 0.5, 0.75]
    assert due_times(read_tlog(path), float("inf")) == [0.0] * 4


def sensor_folder(path: Path) -> Path:
    path.mkdir()
    rows = "\n".join(
        f"{k * 10_000},0,0,-9.8,0,0,0.01" for k in range(100) if k not in range(40, 60)
    )
    (path / "imu.csv").write_text(f"t_us,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z\n{rows}\n")
    (path / "gnss.csv").write_text("t_us,lat_deg,lon_deg,alt_m\n0,47,8,500\n500000,47,8,500\n")
    return path


def test_info_of_sensors(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(sensor_folder(tmp_path / "flight"))]) == 0
    out = capsys.readouterr().out
    assert "a folder of CSV, 1.0 s" in out
    assert "imu.csv, 80 samples at 100.0 Hz" in out
    assert "1 of more than 3 intervals: 0.210 s at 0.4" in out
    assert "gnss.csv, 2 readings at 2.0 Hz, 2 with a 3-D fix, delay not told" in out
    assert "compass    none" in out


def test_info_of_a_ulog_names_what_could_be_chosen(
    shared: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(shared("data/flights/quad_px4_mr_tropic.ulg.xz"))
    assert main(["info", path]) == 0
    out = capsys.readouterr().out
    assert "PX4 NXP_MR_TROPIC, 79.5 s" in out
    assert "sensor_combined, 15843 samples at 199.5 Hz; --imu could be vehicle_imu.0" in out
    assert "delay 0.11 s; --gnss could be sensor_gps.0" in out
    assert "vehicle_air_data                              399     5.0 Hz" in out
    assert main(["info", path, "--imu", "1"]) == 0
    assert "IMU        vehicle_imu.1, 159 samples at 2.0 Hz" in capsys.readouterr().out
    assert main(["info", path, "--imu", "5"]) == 2
    assert "no IMU called '5'; it has sensor_combined, vehicle_imu.0" in capsys.readouterr().err
