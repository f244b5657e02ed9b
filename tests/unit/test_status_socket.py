"""The status socket: who may ask, what is answered, and what is left of services that were killed."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from mavins import status_socket
from mavins.errors import TransportError
from mavins.status import StatusSnapshot, VehicleStatus
from mavins.status_socket import StatusSocket, ask, own_folder, running

SNAPSHOT = StatusSnapshot(12.5, 1, 20, 30, pid=os.getpid())


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The only folder where services of ours can be; a Unix socket's path must be short."""
    with tempfile.TemporaryDirectory() as made:
        monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
        monkeypatch.setenv("XDG_RUNTIME_DIR", made)
        folder = Path(made) / "mavins"
        monkeypatch.setattr(status_socket, "folders", lambda: [folder])
        yield folder


@pytest.fixture
def service(runtime: Path) -> Iterator[StatusSocket]:
    made = StatusSocket()
    yield made
    made.close()


def answered(service: StatusSocket, path: Path) -> StatusSnapshot | None:
    """What `ask` returns while the service answers as its loop does."""
    asker_is_done = threading.Event()

    def serve() -> None:
        while not asker_is_done.wait(0.005):
            service.answer()

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        return ask(path)
    finally:
        asker_is_done.set()
        thread.join()


def test_a_snapshot_arrives_whole(service: StatusSocket) -> None:
    vehicles = tuple(VehicleStatus(k, "running", "x" * 1000, k) for k in range(16))
    snapshot = StatusSnapshot(1.0, 2, 3, 4, {"wrong CRC": 5}, vehicles, ("a remark",), 77)
    service.show(snapshot)
    assert answered(service, service.path) == snapshot


def test_who_asks_nothing_does_not_hold_the_service_up(service: StatusSocket) -> None:
    service.show(SNAPSHOT)
    silent = [socket.socket(socket.AF_UNIX) for _ in range(4)]
    for one in silent:
        one.connect(str(service.path))
    silent[0].close()  # before it was answered
    service.answer()
    assert answered(service, service.path) == SNAPSHOT
    for one in silent:
        one.close()


def test_an_answer_that_does_not_fit_is_cut_and_told(service: StatusSocket) -> None:
    service.show(StatusSnapshot(1.0, 0, 0, 0, remarks=("x" * 10_000_000,)))
    with pytest.raises(TransportError, match="does not answer"):
        answered(service, service.path)


def test_before_the_first_snapshot(service: StatusSocket) -> None:
    with pytest.raises(TransportError, match=f"{os.getpid()} does not answer; is it starting"):
        answered(service, service.path)


def test_a_service_that_hangs(service: StatusSocket, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(status_socket, "ANSWER_S", 0.05)
    with pytest.raises(TransportError, match=f"ps -p {os.getpid()}"):
        ask(service.path)


def test_nobody_but_the_user_can_enter(service: StatusSocket, runtime: Path) -> None:
    assert runtime.stat().st_mode & 0o777 == 0o700
    assert service.path.parent == runtime


def test_a_folder_that_others_can_enter_is_refused(runtime: Path) -> None:
    runtime.mkdir()
    runtime.chmod(0o755)
    with pytest.raises(TransportError, match="chmod 700"):
        StatusSocket()
    (runtime / "1.status").touch()
    assert running() == {}


def test_a_link_to_a_folder_is_refused(runtime: Path, tmp_path: Path) -> None:
    tmp_path.chmod(0o700)
    runtime.symlink_to(tmp_path)
    with pytest.raises(TransportError, match="not a folder of this user's"):
        StatusSocket()


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    with pytest.raises(TransportError, match="no status socket at"):
        StatusSocket(tmp_path / "missing" / "mavins")
    with pytest.raises(TransportError, match="no status socket at"):
        StatusSocket(tmp_path / ("long" * 40))


def test_what_a_killed_service_left_is_passed_over_and_removed(runtime: Path) -> None:
    code = (
        "import time; from mavins.status_socket import StatusSocket; s = StatusSocket(); "
        "print(s.path, flush=True); time.sleep(60)"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    path = Path(process.stdout.readline().strip())
    assert path == runtime / f"{process.pid}.status"
    process.send_signal(signal.SIGKILL)
    process.wait()
    process.stdout.close()
    assert path.exists()
    assert running() == {}
    (runtime / "notes.txt").touch()
    service = StatusSocket()
    assert sorted(p.name for p in runtime.iterdir()) == [f"{os.getpid()}.status", "notes.txt"]
    service.close()
    assert not service.path.exists()


def test_where_it_lies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/run/user/7")
    monkeypatch.setenv("RUNTIME_DIRECTORY", "/run/mavins:/run/other")
    assert own_folder() == Path("/run/mavins")
    monkeypatch.delenv("RUNTIME_DIRECTORY")
    assert own_folder() == Path("/run/user/7/mavins")
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert own_folder() == Path(tempfile.gettempdir()) / f"mavins-{os.getuid()}"
    # who asks without that variable finds it as well
    assert {own_folder(), Path(f"/run/user/{os.getuid()}/mavins"), Path("/run/mavins")} == set(
        status_socket.folders()
    )
