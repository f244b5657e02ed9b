"""The key file and the timestamps beside it: who may read, what is understood, what a crash leaves."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavins.errors import KeyFileError
from mavins.mavlink.codec import frame, heartbeat, scan
from mavins.mavlink.signing import SIGNED, Clock, Key, Memory, Signer, ticks
from mavins.signing_store import AHEAD, SAVE_US, Signing, load, memory_path, read_key, save

SECRET = bytes(range(1, 33))
NOW_US = 1_790_000_000_000_000
PACKET = frame(heartbeat(2, 3), 7, 1, 0, SIGNED)


def key_file(folder: Path, content: bytes = SECRET, mode: int = 0o600) -> Path:
    path = folder / "signing.key"
    path.write_bytes(content)
    path.chmod(mode)
    return path


def timestamp(signed: bytes) -> int:
    return int.from_bytes(signed[-12:-6], "little")


@pytest.mark.parametrize(
    "content",
    [
        SECRET,
        SECRET.hex().encode(),
        SECRET.hex().upper().encode() + b"\n",
        b"0x"[2:] + SECRET.hex().encode() + b"\r\n",
    ],
)
def test_a_key_in_bytes_or_hexadecimal(tmp_path: Path, content: bytes) -> None:
    key = read_key(key_file(tmp_path, content))
    assert key.signature(b"data") == Key(SECRET).signature(b"data")


@pytest.mark.parametrize(
    "content",
    [
        b"",
        SECRET[:-1],
        SECRET + b"\n",
        SECRET.hex().encode()[:-2],
        b"zz" * 32,
        bytes(32),
        b"00" * 32,
        b"\xff" * 1000,
    ],
)
def test_what_is_no_key(tmp_path: Path, content: bytes) -> None:
    path = key_file(tmp_path, content)
    with pytest.raises(KeyFileError, match="is not a signing key: 32 bytes, or 64 hex") as caught:
        read_key(path)
    text = str(caught.value)
    assert "\n" not in text
    assert caught.value.__cause__ is None
    assert len(content) < 8 or content.hex()[:16] not in text


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o610, 0o644, 0o601])
def test_a_key_that_others_can_read_is_refused_with_the_remedy(tmp_path: Path, mode: int) -> None:
    path = key_file(tmp_path, mode=mode)
    with pytest.raises(KeyFileError) as caught:
        read_key(path)
    remedy = re.search(r"chmod (\d+) (.*)", str(caught.value))
    assert remedy
    Path(remedy[2]).chmod(int(remedy[1], 8))
    read_key(path)


def test_a_key_of_another_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = key_file(tmp_path)
    monkeypatch.setattr(os, "geteuid", lambda: path.stat().st_uid + 1)
    with pytest.raises(KeyFileError, match="belongs to another user: chown"):
        read_key(path)


def test_a_key_that_is_not_there_or_no_file(tmp_path: Path) -> None:
    with pytest.raises(KeyFileError, match="No such file"):
        read_key(tmp_path / "missing")
    with pytest.raises(KeyFileError, match="is not a file"):
        read_key(tmp_path)
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe, 0o600)
    with pytest.raises(KeyFileError, match="is not a file"):
        read_key(pipe)


# ---- timestamps ----------------------------------------------------------------------------------

byte = st.integers(0, 255)
memories = st.builds(
    Memory,
    st.integers(0, 2**47),
    st.dictionaries(st.tuples(byte, byte, byte), st.integers(0, 2**47), max_size=20),
)


@given(memory=memories)
def test_what_is_saved_is_loaded(memory: Memory, tmp_path_factory: pytest.TempPathFactory) -> None:
    path = tmp_path_factory.getbasetemp() / "kept.timestamps"
    save(path, memory)
    assert load(path) == memory
    assert path.stat().st_mode & 0o077 == 0
    assert not path.with_name(path.name + ".part").exists()


def test_nothing_is_kept_at_first(tmp_path: Path) -> None:
    assert load(tmp_path / "missing") == Memory()


@pytest.mark.parametrize(
    "text",
    [
        "", "{}", "[]", "7", '{"timestamp": 1}', '{"timestamp": "1", "streams": []}',
        '{"timestamp": -1, "streams": []}', '{"timestamp": 1, "streams": [[1, 2, 3]]}',
        '{"timestamp": 1, "streams": [[1, 2, 300, 4]]}', '{"timestamp": true, "streams": []}',
        '{"timestamp": 1e99, "streams": []}', '{"timestamp": 1, "streams": [[[1], 2, 3, 4]]}', "\xff",
    ],
)  # fmt: skip
def test_damage_is_told_in_one_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "kept"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(KeyFileError, match="is damaged; remove it"):
        load(path)


def test_a_save_that_breaks_leaves_the_file_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "kept"
    save(path, Memory(7))

    def broken(descriptor: int) -> None:
        raise OSError("no space")

    monkeypatch.setattr(os, "fsync", broken)
    with pytest.raises(OSError, match="no space"):
        save(path, Memory(8))
    monkeypatch.undo()
    assert load(path) == Memory(7)
    save(path, Memory(9))
    assert load(path) == Memory(9)


# ---- a service's signing -------------------------------------------------------------------------


def test_no_timestamp_is_used_twice_after_a_crash(tmp_path: Path) -> None:
    path = key_file(tmp_path)
    # a computer whose clock starts at the same time each time
    first = Signing(path, lambda: NOW_US)
    used = [timestamp(first.signer(link).sign(PACKET)) for link in (0, 1, 0)]
    assert used == sorted(set(used))
    # no close
    second = Signing(path, lambda: NOW_US)
    assert timestamp(second.signer(0).sign(PACKET)) > max(used)
    assert load(memory_path(path)).timestamp >= ticks(NOW_US) + AHEAD
    first.close()
    second.close()


def test_a_clean_end_loses_no_time(tmp_path: Path) -> None:
    path = key_file(tmp_path)
    signing = Signing(path, lambda: NOW_US)
    last = timestamp(signing.signer(0).sign(PACKET))
    signing.close()
    assert load(memory_path(path)).timestamp == last
    again = Signing(path, lambda: NOW_US)
    assert timestamp(again.signer(0).sign(PACKET)) == last + 1
    again.close()


def test_replays_are_refused_across_a_restart(tmp_path: Path) -> None:
    path = key_file(tmp_path)
    packet = Signer(Key(SECRET), 0, Clock(lambda: NOW_US)).sign(PACKET)
    signing = Signing(path, lambda: NOW_US)
    assert signing.verifier.check(scan(packet), False).keep.all()
    signing.close()
    again = Signing(path, lambda: NOW_US)
    assert not again.verifier.check(scan(packet), False).keep.any()
    again.close()


def test_timestamps_are_saved_now_and_then(tmp_path: Path) -> None:
    path, clock_us = key_file(tmp_path), [NOW_US]
    signing = Signing(path, lambda: clock_us[0])

    def saved_after(now_us: int) -> int:
        clock_us[0] = NOW_US + now_us
        signing.keep(now_us)
        if signing._saving is not None:
            signing._saving.result()
        return load(memory_path(path)).timestamp - ticks(NOW_US)

    assert saved_after(0) == AHEAD
    assert saved_after(SAVE_US - 1) == AHEAD
    assert saved_after(SAVE_US) == AHEAD + SAVE_US // 10
    assert saved_after(SAVE_US + 1) == AHEAD + SAVE_US // 10
    signing.close()


def test_a_disk_that_is_full_is_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    signing = Signing(key_file(tmp_path), lambda: NOW_US)

    def full(path: Path, memory: Memory) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("mavins.signing_store.save", full)
    signing.close()
    assert signing.save_errors == 1
    with pytest.raises(KeyFileError, match=r"cannot write .*timestamps: No space"):
        Signing(tmp_path / "signing.key", lambda: NOW_US)


def test_nothing_of_the_key_is_saved(tmp_path: Path) -> None:
    path = key_file(tmp_path)
    Signing(path, lambda: NOW_US).close()
    content = memory_path(path).read_bytes()
    assert SECRET not in content
    assert SECRET.hex().encode() not in content
    assert set(json.loads(content)) == {"timestamp", "streams"}
