"""Where a running service tells its status to who asks on this host: one line of JSON for each connection.

The Unix socket is named by the service's process id and lies in a folder that only the service's user can enter: the
one of systemd (RuntimeDirectory), else one in the user's runtime folder, else one among the temporary files.
"""

from __future__ import annotations

import contextlib
import os
import socket
import stat
import tempfile
from pathlib import Path
from typing import Final

from mavins.errors import TransportError
from mavins.status import StatusSnapshot, from_json, to_json

SYSTEM_FOLDER: Final = Path("/run/mavins")
"""Where a service of systemd's has it; root alone can make a folder there."""
ANSWER_S: Final = 3.0
LONGEST: Final = 1 << 22
_SUFFIX: Final = ".status"
_AT_ONCE: Final = 8


def own_folder() -> Path:
    """Where a service that is started here has its socket."""
    if given := os.environ.get("RUNTIME_DIRECTORY"):
        return Path(given.partition(":")[0])
    if given := os.environ.get("XDG_RUNTIME_DIR"):
        return Path(given) / "mavins"
    return Path(tempfile.gettempdir()) / f"mavins-{os.getuid()}"


def folders() -> list[Path]:
    """Where services that we may ask can have theirs."""
    user = os.getuid()
    usual = (
        Path(f"/run/user/{user}/mavins"),
        Path(tempfile.gettempdir()) / f"mavins-{user}",
        SYSTEM_FOLDER,
    )
    return list(dict.fromkeys((own_folder(), *usual)))


class StatusSocket:
    """The service's end: it never waits for who asks."""

    def __init__(self, folder: Path | None = None) -> None:
        _check_system()
        folder = own_folder() if folder is None else folder
        self.path = folder / f"{os.getpid()}{_SUFFIX}"
        self._snapshot: StatusSnapshot | None = None
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            folder.mkdir(mode=0o700, exist_ok=True)
            _check_private(folder)
            _remove_leftovers(folder)
            self._socket.setblocking(False)
            self._socket.bind(str(self.path))
            self._socket.listen(_AT_ONCE)
        except OSError as error:
            self._socket.close()
            raise TransportError(
                f"no status socket at {self.path}: {error.strerror or error}"
            ) from None
        except TransportError:
            self._socket.close()
            raise

    def fileno(self) -> int:
        """A descriptor that is readable when somebody asks."""
        return self._socket.fileno()

    def show(self, snapshot: StatusSnapshot) -> None:
        """This is answered from now on."""
        self._snapshot = snapshot

    def answer(self) -> None:
        """Answer those who wait; what does not fit into the kernel's buffer is not sent."""
        for _ in range(_AT_ONCE):
            try:
                connection, _address = self._socket.accept()
            except OSError:
                return
            with connection, contextlib.suppress(OSError):
                connection.setblocking(False)
                if self._snapshot is not None:
                    connection.send(to_json(self._snapshot).encode() + b"\n")

    def close(self) -> None:
        """Nobody is answered any more."""
        self._socket.close()
        self.path.unlink(missing_ok=True)


def ask(path: Path) -> StatusSnapshot | None:
    """The status of the service behind a socket, None where there is none; TransportError: it does not answer."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(ANSWER_S)
        try:
            connection.connect(str(path))
            answer = b""
            while not answer.endswith(b"\n") and (part := connection.recv(65536)):
                answer += part
                if len(answer) > LONGEST:
                    break
            return from_json(answer.decode())
        except (ConnectionRefusedError, FileNotFoundError):
            return None
        except (OSError, ValueError):
            raise TransportError(
                f"the service {path.stem} does not answer; is it starting, or stopped? "
                f"See 'ps -p {path.stem}', and ask again"
            ) from None


def running(pid: int | None = None) -> dict[int, StatusSnapshot]:
    """The status of every service that we may ask, or of one, by process id."""
    _check_system()
    found = {}
    for folder in folders():
        for path in sorted(_sockets(folder)):
            number = int(path.stem)
            if pid in (None, number) and (snapshot := ask(path)) is not None:
                found[number] = snapshot
    return found


def hidden() -> bool:
    """True where a service of another user may run that we may not ask."""
    return SYSTEM_FOLDER.is_dir() and not os.access(SYSTEM_FOLDER, os.R_OK | os.X_OK)


def _sockets(folder: Path) -> list[Path]:
    """The sockets in a folder, if we can trust it: anyone can make one among the temporary files."""
    try:
        if folder != SYSTEM_FOLDER:
            _check_private(folder)
        return [p for p in folder.iterdir() if p.suffix == _SUFFIX and p.stem.isdecimal()]
    except (OSError, TransportError):
        return []


def _check_system() -> None:
    if not hasattr(socket, "AF_UNIX"):
        raise TransportError("this system has no Unix sockets")


def _check_private(folder: Path) -> None:
    status = folder.lstat()
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.geteuid():
        raise TransportError(f"{folder} is not a folder of this user's; remove it")
    if status.st_mode & 0o077:
        raise TransportError(f"others can enter {folder}: chmod 700 {folder}")


def _remove_leftovers(folder: Path) -> None:
    """Those of services that were killed, and of one that had our process id."""
    for path in _sockets(folder):
        pid = int(path.stem)
        if pid == os.getpid() or not _lives(pid):
            path.unlink(missing_ok=True)


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass  # another user's
    return True
