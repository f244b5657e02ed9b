"""The signing key file, and beside it the file of timestamps that outlive a run.

The file of timestamps holds one that is ahead of all that were used, so that a crash makes none be used twice, and the
last one of each stream, so that what was taken before a restart is not taken again after it. It is replaced whole.
"""

from __future__ import annotations

import json
import os
import stat
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Final

from mavins.errors import KeyFileError
from mavins.mavlink.signing import KEY_LENGTH, LATEST, Clock, Key, Memory, Signer, Stream, Verifier

SAVE_US: Final = 30_000_000
"""How often the timestamps are saved."""
AHEAD: Final = 4_500_000
"""Ticks (45 s) that a saved timestamp is ahead: more than till the next one is saved, and less than the minute that a
peer may be behind us."""


def read_key(path: Path) -> Key:
    """The key of a file that only its owner, who must be us, can read; KeyFileError says what to do otherwise."""
    try:
        # a pipe would keep us waiting; what is asked about is what was opened
        descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))
    except OSError as error:
        raise KeyFileError(f"cannot read the signing key {path}: {error.strerror}") from None
    try:
        _check_owner(path, os.fstat(descriptor))
        content = os.read(descriptor, 4 * KEY_LENGTH)
    except OSError as error:
        raise KeyFileError(f"cannot read the signing key {path}: {error.strerror}") from None
    finally:
        os.close(descriptor)
    return Key(_secret(path, content))


def _check_owner(path: Path, status: os.stat_result) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise KeyFileError(f"the signing key {path} is not a file")
    if hasattr(os, "geteuid") and status.st_uid != os.geteuid():
        raise KeyFileError(
            f"the signing key {path} belongs to another user: chown {os.geteuid()} {path}"
        )
    if os.name == "posix" and status.st_mode & 0o077:
        raise KeyFileError(f"others can read the signing key {path}: chmod 600 {path}")


def _secret(path: Path, content: bytes) -> bytes:
    """The bytes of a key; a text of 64 hexadecimal digits may end with a newline."""
    secret = content
    if len(content) != KEY_LENGTH:
        try:
            secret = bytes.fromhex(content.decode("ascii").strip())
        except ValueError:
            secret = b""
    if len(secret) != KEY_LENGTH or not any(secret):
        raise KeyFileError(
            f"{path} is not a signing key: 32 bytes, or 64 hexadecimal digits, not all zero "
            f"(head -c 32 /dev/urandom > {path})"
        ) from None
    return secret


def load(path: Path) -> Memory:
    """What the last run left; nothing where there was none."""
    try:
        data = json.loads(path.read_bytes())
        streams = {(link, sysid, compid): last for link, sysid, compid, last in data["streams"]}
        numbers = [data["timestamp"], *streams.values()]
        if not all(type(n) is int and 0 <= n <= LATEST + AHEAD for n in numbers):
            raise ValueError
        if not all(type(n) is int and 0 <= n <= 255 for stream in streams for n in stream):
            raise ValueError
    except FileNotFoundError:
        return Memory()
    except OSError as error:
        raise KeyFileError(f"cannot read {path}: {error.strerror}") from None
    except (ValueError, TypeError, KeyError):
        raise KeyFileError(
            f"{path} is damaged; remove it (packets signed in the last minute could then be replayed once)"
        ) from None
    return Memory(data["timestamp"], streams)


def save(path: Path, memory: Memory) -> None:
    """Replace the file; OSError where that cannot be done."""
    rows = [[*stream, last] for stream, last in memory.streams.items()]
    text = json.dumps({"timestamp": memory.timestamp, "streams": rows}) + "\n"
    part = path.with_name(path.name + ".part")
    part.unlink(missing_ok=True)
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with open(descriptor, "w", encoding="ascii") as file:
        file.write(text)
        file.flush()
        os.fsync(descriptor)
    os.replace(part, path)


def memory_path(key_file: Path) -> Path:
    """Where the timestamps of a key lie."""
    return key_file.with_name(key_file.name + ".timestamps")


class Signing:
    """The signers and the verifier of a service. Close it: then no time is lost by a restart.

    `save_errors` counts the times that could not be saved; the service goes on without.
    """

    def __init__(
        self, key_file: Path, unix_us: Callable[[], int] = lambda: time.time_ns() // 1000
    ) -> None:
        self._key = read_key(key_file)
        self._path = memory_path(key_file)
        memory = load(self._path)
        self._clock = Clock(unix_us, memory.timestamp)
        self.verifier = Verifier(self._key, self._clock, memory.streams)
        self.save_errors = 0
        try:
            save(self._path, self._memory(AHEAD))
        except OSError as error:
            raise KeyFileError(f"cannot write {self._path}: {error.strerror}") from None
        # a card may take its time to save, and no sample shall wait for it
        self._saver = ThreadPoolExecutor(1, "signing")
        self._saving: Future[None] | None = None
        self._next_us: int | None = None

    def signer(self, link_id: int) -> Signer:
        """The signer of a link."""
        return Signer(self._key, link_id, self._clock)

    def keep(self, now_us: int) -> None:
        """Save the timestamps when it is due; call it about once a second with a time that never steps back."""
        if self._next_us is None:
            self._next_us = now_us + SAVE_US
        if now_us < self._next_us or (self._saving is not None and not self._saving.done()):
            return
        self._next_us = now_us + SAVE_US
        self._saving = self._saver.submit(self._save, self._memory(AHEAD))

    def close(self) -> None:
        """Save the timestamps as they are."""
        self._saver.shutdown()
        self._save(self._memory(0))

    def _memory(self, ahead: int) -> Memory:
        streams: Mapping[Stream, int] = dict(self.verifier.streams)
        return Memory(self._clock.now() + ahead, streams)

    def _save(self, memory: Memory) -> None:
        try:
            save(self._path, memory)
        except OSError:
            self.save_errors += 1
