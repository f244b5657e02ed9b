"""Under which ids we speak about a vehicle."""

from __future__ import annotations

from collections.abc import Collection
from typing import Final

from mavins.mavlink.peers import Identity
from mavins.mavlink.settings import SessionSettings

AUTOPILOT: Final = 1
COMPANION: Final = 191
"""MAV_COMPONENT: AUTOPILOT1, ONBOARD_COMPUTER."""


def identity_for(
    sysid: int, settings: SessionSettings, seen: Collection[int], ours: Collection[int]
) -> Identity:
    """Under which ids we speak about vehicle `sysid`: as its companion, or with a sysid of our own, which is one of
    those not `seen` in use nor `ours` for another vehicle."""
    companion = settings.persona == "companion"
    compid = settings.compid if settings.compid != "auto" else COMPANION if companion else AUTOPILOT
    return Identity(sysid if companion else _own_sysid(sysid, settings, seen, ours), compid)


def _own_sysid(
    sysid: int, settings: SessionSettings, seen: Collection[int], ours: Collection[int]
) -> int:
    if settings.sysid != "auto" and not ours:
        return settings.sysid
    candidates = [1 + (sysid + 98 + k) % 250 for k in range(250)]
    free = [c for c in candidates if c not in ours]
    return next((c for c in free if c not in seen), free[0])
