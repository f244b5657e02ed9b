"""One vehicle's parameters as MAVLink sees them: a store of numbers with names, and the lists that are on their way."""

from __future__ import annotations

import contextlib
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

from mavins.errors import ParameterError
from mavins.mavlink.codec import Payload, fields_of, param_value

PARAM_SET: Final = fields_of("PARAM_SET").msgid

LIST_RATE: Final = 150
"""Values per second to a peer that lists them: all within two seconds, at 6 kB/s."""
LIST_BURST: Final = 16
"""At most so many at once, however long the last tick is past."""
MAX_LISTINGS: Final = 64
"""More peers than this do not list at the same time."""


class ParameterStore(Protocol):
    """The parameters of one vehicle."""

    @property
    def names(self) -> Sequence[str]:
        """All names, in a fixed order: their places are their indices."""

    def value(self, name: str) -> float:
        """The value of one of the names."""

    def set(self, name: str, value: float) -> str:
        """Change a value; returns what there is to say about it, or nothing. ParameterError if it is refused."""

    def refuses(self, name: str, value: float) -> bool:
        """True where `set` would raise; nothing is changed."""

    def described(self) -> bytes:
        """What the parameters are, as a file that ground stations read; empty where there is none."""

    def save(self) -> str:
        """Keep all values for the next start; returns why that failed, or nothing."""

    def load(self) -> None:
        """Back to what was saved last, or begun with."""

    def reset(self) -> None:
        """Back to what this run has begun with."""


class NoParameters:
    """The store of a vehicle that has no parameters."""

    names: Sequence[str] = ()

    def value(self, name: str) -> float:
        """There is none."""
        raise ParameterError(f"no parameter is called {name}")

    def set(self, name: str, value: float) -> str:
        """There is none."""
        raise ParameterError(f"no parameter is called {name}")

    def refuses(self, name: str, value: float) -> bool:
        """Always."""
        return True

    def described(self) -> bytes:
        """There is nothing to describe."""
        return b""

    def save(self) -> str:
        """Nothing to save."""
        return "there are no parameters"

    def load(self) -> None:
        """Nothing to load."""

    def reset(self) -> None:
        """Nothing to reset."""


def set_from(message: Any, store: ParameterStore) -> str:
    """What a PARAM_SET does: the same as `ParameterStore.set`.

    Its param_type is not looked at: clients differ in what they say of a type that is not theirs.
    """
    return store.set(message.param_id, float(message.param_value))


def set_again(message: Any, store: ParameterStore) -> None:
    """What a PARAM_SET did, again in a replay: what was refused is refused again."""
    with contextlib.suppress(ParameterError):
        set_from(message, store)


def is_refused(message: Any, store: ParameterStore) -> bool:
    """True for a PARAM_SET that `set_from` would refuse, as a replay might not: a recording leaves it out."""
    return store.refuses(message.param_id, float(message.param_value))


def values_of(store: ParameterStore) -> dict[str, float]:
    """All values, to tell later which have changed."""
    return {name: store.value(name) for name in store.names}


def changes_since(before: Mapping[str, float], store: ParameterStore) -> list[Payload]:
    """PARAM_VALUE of each parameter that has another value than `before`, after a load or a reset."""
    return [value_of(store, name) for name in store.names if store.value(name) != before[name]]


def value_of(store: ParameterStore, name: str) -> Payload:
    """PARAM_VALUE."""
    names = store.names
    return param_value(name, store.value(name), names.index(name), len(names))


@dataclass(slots=True)
class _Listing:
    """A list on its way to a peer: since when, and how many values have gone."""

    since_us: int
    sent: int = 0


class VehicleParameters:
    """One vehicle's parameters, and the lists of them that are on their way."""

    def __init__(self, store: ParameterStore | None = None) -> None:
        self.store = store or NoParameters()
        self._listings: dict[Hashable, _Listing] = {}

    def begin_list(self, address: Hashable, now_us: int) -> None:
        """Begin a list to a peer, or begin it anew."""
        if address in self._listings or len(self._listings) < MAX_LISTINGS:
            self._listings[address] = _Listing(now_us)

    def listed(self, now_us: int) -> Iterator[tuple[Hashable, Payload]]:
        """The values that are due to each peer that lists them."""
        names = self.store.names
        for address, listing in list(self._listings.items()):
            due = (now_us - listing.since_us) * LIST_RATE // 1_000_000 + 1
            end = min(due, listing.sent + LIST_BURST, len(names))
            for name in names[listing.sent : end]:
                yield address, value_of(self.store, name)
            listing.sent = max(end, listing.sent)
            if listing.sent == len(names):
                del self._listings[address]
