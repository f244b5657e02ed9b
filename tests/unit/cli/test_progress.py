"""The progress bar: only where somebody watches."""

from __future__ import annotations

import io
import sys

import pytest

from mavins.cli.progress import progress_bar


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("quiet", [False, True])
def test_silent_without_a_terminal_or_when_quiet(
    monkeypatch: pytest.MonkeyPatch, quiet: bool
) -> None:
    stream = _Terminal() if quiet else io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    with progress_bar("reading", 10.0, quiet) as report:
        report(5.0)
    assert stream.getvalue() == ""


def test_a_terminal_sees_the_label(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = _Terminal()
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", stream)
    with progress_bar("reading", 10.0) as report:
        report(10.0)
    assert "reading" in stream.getvalue()
