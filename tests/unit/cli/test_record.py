"""The options of a recording, and of signing."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from mavins.cli import record, signing
from mavins.errors import KeyFileError


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("1M", 1 << 20),
        ("500m", 500 << 20),
        ("2G", 2 << 30),
        ("4096k", 4 << 20),
        ("1048576", 1 << 20),
    ],
)
def test_a_size(text: str, number: int) -> None:
    assert record.size(text) == number


@pytest.mark.parametrize(
    "text", ["", "M", "0", "1K", "-5M", "1.5G", "5T", "5 M", "5MB", "٥M", "9" * 30]
)
def test_what_is_no_size(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="at least 1M"):
        record.size(text)


def parsed(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    record.add_arguments(parser)
    signing.add_argument(parser)
    return parser.parse_args(words)


def test_a_recording_that_was_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    assert record.recording_of(parsed(), print) is None
    made = record.recording_of(parsed("--record", str(path), "--record-max-size", "1M"), print)
    assert made is not None
    made.close()
    assert path.exists()


def test_signing_that_was_asked_for(tmp_path: Path) -> None:
    assert signing.signing_of(parsed()) is None
    path = tmp_path / "key"
    path.write_bytes(bytes(range(32)))
    path.chmod(0o640)
    with pytest.raises(KeyFileError):
        signing.signing_of(parsed("--signing-key-file", str(path)))
    path.chmod(0o600)
    made = signing.signing_of(parsed("--signing-key-file", str(path)))
    assert made is not None
    made.close()
