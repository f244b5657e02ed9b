"""`mavins sitl`: the simulator, which declares its options itself.

Only this command imports it; nothing that navigates does.
"""

from __future__ import annotations

from sitl.command import EPILOG, SUMMARY, add_arguments, run

__all__ = ["EPILOG", "SUMMARY", "add_arguments", "run"]
