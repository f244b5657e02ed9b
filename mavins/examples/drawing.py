"""Pictures are drawn where matplotlib is installed; without it an example says how to get it, and goes on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

HINT = "no pictures without matplotlib: pip install 'mavins[report]'"


def pyplot(say: Callable[[str], None]) -> Any | None:
    """matplotlib's pyplot, drawing into files; None where it is not installed."""
    try:
        from mavins.evaluation.pictures import plt
    except ImportError:
        say(HINT)
        return None
    return plt
