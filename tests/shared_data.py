"""Where tests find the team's shared recordings: beside the repository, or in $MAVINS_SHARED."""

import os
from pathlib import Path

import pytest

SHARED = Path(os.environ.get("MAVINS_SHARED") or Path(__file__).resolve().parents[2] / "shared")


def shared(relative: str) -> Path:
    """A file of the shared folder; skips the test where it is absent, fails under
    MAVINS_REQUIRE_SHARED=1.
    """
    path = SHARED / relative
    if not path.exists():
        reason = f"needs {relative} in {SHARED} (set MAVINS_SHARED to the shared folder)"
        if os.environ.get("MAVINS_REQUIRE_SHARED") == "1":
            pytest.fail(reason)
        pytest.skip(reason)
    return path


def recording(name: str) -> Path:
    """A recorded flight of the shared folder, e.g. px4_quad_mission.tlog.xz."""
    return shared(f"recordings/{name}")
