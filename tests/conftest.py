"""What all tests share: where the recordings lie, and that CI does not skip for want of them."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Generator
from pathlib import Path

import hypothesis
import pytest

SHARED = Path(os.environ.get("MAVINS_SHARED") or Path(__file__).resolve().parents[2] / "shared")
"""The folder of recordings and data beside the repository, or wherever MAVINS_SHARED says."""

REQUIRED = os.environ.get("MAVINS_REQUIRE_SHARED") == "1"

# Without the compiler everything is a hundred times slower: a few examples then show that it runs at all.
# CI draws the same examples each time; whoever develops draws others, and adds what they find as a test.
hypothesis.settings.register_profile(
    "compiled", max_examples=200, deadline=None, derandomize=REQUIRED
)
hypothesis.settings.register_profile(
    "interpreted", max_examples=8, deadline=None, derandomize=REQUIRED
)
hypothesis.settings.load_profile(
    "interpreted" if os.environ.get("NUMBA_DISABLE_JIT") == "1" else "compiled"
)

_WANTING = ("shared", "client", "mavsdk", "chromium")
"""Words in the reason of a skip that tell that something from outside the repository is missing."""


def pytest_configure() -> None:
    """A shell that runs us in the background lets SIGINT be ignored, by our children too: put it back."""
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def shared() -> Callable[[str], Path]:
    """Return the path of a file of the shared folder; the test is skipped where it is absent."""

    def find(name: str) -> Path:
        path = SHARED / name
        if not path.exists():
            pytest.skip(f"shared/{name} is absent (MAVINS_SHARED names another folder)")
        return path

    return find


def _no_excuse(report: pytest.TestReport | pytest.CollectReport) -> None:
    """Turn a skip for want of ../shared or an outside client into a failure, where CI says so."""
    if not (REQUIRED and report.skipped and isinstance(report.longrepr, tuple)):
        return
    reason = report.longrepr[2]
    if any(word in reason.lower() for word in _WANTING):
        report.outcome = "failed"
        report.longrepr = f"MAVINS_REQUIRE_SHARED=1 does not allow this skip: {reason}"


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    _no_excuse(report)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    report = yield
    _no_excuse(report)
    return report
