"""The parameter protocol: list, read and set, every value a 32-bit float.

Source: the MAVLink developer guide, parameter protocol.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

from mavins.errors import ParameterError
from mavins.mavlink.codec import Payload, fields_of, param_error, param_value
from mavins.mavlink.microservice import Reply, Request

PARAM_REQUEST_READ: Final = fields_of("PARAM_REQUEST_READ").msgid
PARAM_REQUEST_LIST: Final = fields_of("PARAM_REQUEST_LIST").msgid
PARAM_SET: Final = fields_of("PARAM_SET").msgid

LIST_RATE: Final = 150
"""Values per second to a peer that lists them: all within two seconds, at 6 kB/s."""
LIST_BURST: Final = 16
"""At most so many at once, however long the last tick is past."""
MAX_LISTINGS: Final = 64
"""More peers than this do not list at the same time."""

DOES_NOT_EXIST: Final = 1
VALUE_OUT_OF_RANGE: Final = 2
PERMISSION_DENIED: Final = 3
"""Numbers of MAV_PARAM_ERROR."""
_INFO: Final = 6
_WARNING: Final = 4
"""Numbers of MAV_SEVERITY."""


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

    def save(self) -> str:
        """Keep all values for the next start; returns why that failed, or nothing."""

    def load(self) -> None:
        """Back to what was saved last, or begun with."""

    def reset(self) -> None:
        """Back to what this run has begun with."""


class Owner(Protocol):
    """Whose parameters they are: a vehicle, which also numbers its texts."""

    @property
    def parameters(self) -> VehicleParameters:
        """The vehicle's parameters."""

    def text(self, text: str, severity: int) -> list[Payload]:
        """STATUSTEXT in chunks."""


def carry_out(message: Any, store: ParameterStore) -> str:
    """What a PARAM_SET does, live and again in a replay: returns what `ParameterStore.set` does.

    Its param_type is not looked at: clients differ in what they say of a type that is not theirs.
    """
    return store.set(message.param_id, float(message.param_value))


def is_refused(message: Any, store: ParameterStore) -> bool:
    """True for a PARAM_SET that `carry_out` would refuse, as a replay might not: a recording leaves it out."""
    return store.refuses(message.param_id, float(message.param_value))


def values_of(store: ParameterStore) -> dict[str, float]:
    """All values, to tell later which have changed."""
    return {name: store.value(name) for name in store.names}


def changes_since(before: Mapping[str, float], store: ParameterStore) -> list[Payload]:
    """PARAM_VALUE of each parameter that has another value than `before`, after a load or a reset."""
    return [_value(store, name) for name in store.names if store.value(name) != before[name]]


def _value(store: ParameterStore, name: str) -> Payload:
    names = store.names
    return param_value(name, store.value(name), names.index(name), len(names))


@dataclass(slots=True)
class _Listing:
    """A list on its way to a peer: since when, and how many values have gone."""

    since_us: int
    sent: int = 0


class VehicleParameters:
    """One vehicle's parameters, and the lists of them that are on their way."""

    def __init__(self, store: ParameterStore) -> None:
        self.store = store
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
                yield address, _value(self.store, name)
            listing.sent = max(end, listing.sent)
            if listing.sent == len(names):
                del self._listings[address]


class Parameters:
    """The microservice of parameters."""

    msgids = frozenset((PARAM_REQUEST_READ, PARAM_REQUEST_LIST, PARAM_SET))

    def answer(self, request: Request, vehicle: Owner) -> Iterable[Reply]:
        """What is sent at once because of a request; a list goes out with the ticks that follow."""
        msgid = request.message.get_msgId()
        if msgid == PARAM_SET:
            return _set(request, vehicle)
        if msgid == PARAM_REQUEST_READ:
            return _read(request, vehicle.parameters.store)
        vehicle.parameters.begin_list(request.address, request.now_us)
        return ()

    def tick(self, now_us: int, vehicle: Owner) -> Iterable[tuple[Hashable, Payload]]:
        """The values that are due to each peer that lists them."""
        return vehicle.parameters.listed(now_us)


def _read(request: Request, store: ParameterStore) -> Iterator[Reply]:
    """One value, by its index if one is given, or by its name."""
    names, message = store.names, request.message
    index, name = int(message.param_index), str(message.param_id)
    if 0 <= index < len(names):
        yield Reply(_value(store, names[index]))
    elif index == -1 and name in names:
        yield Reply(_value(store, name))
    else:
        yield Reply(param_error(name, index, DOES_NOT_EXIST, *request.sender))


def _set(request: Request, vehicle: Owner) -> Iterator[Reply]:
    """Change a value; whatever becomes of it, the value that holds now is told."""
    store, name = vehicle.parameters.store, str(request.message.param_id)
    if name not in store.names:
        yield Reply(param_error(name, -1, DOES_NOT_EXIST, *request.sender))
        return
    if not request.trusted:
        yield Reply(param_error(name, -1, PERMISSION_DENIED, *request.sender))
        yield Reply(_value(store, name))
        return
    try:
        remark, severity = carry_out(request.message, store), _INFO
    except ParameterError as error:
        yield Reply(param_error(name, -1, VALUE_OUT_OF_RANGE, *request.sender))
        remark, severity = str(error), _WARNING
    yield Reply(_value(store, name), to_all=True)
    if remark:
        for text in vehicle.text(remark, severity):
            yield Reply(text)
