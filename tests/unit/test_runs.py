"""A log in Python: what a run gives, that it is what replay writes, and that asking for it costs nothing before."""

from __future__ import annotations

import pytest

pytestmark = pytest.mark.jit
