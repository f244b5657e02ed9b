"""The parameter protocol: list, read and set, every value a 32-bit float.

Source: the MAVLink developer guide, parameter protocol.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator
from typing import Final, Protocol

from mavins.errors import ParameterError
from mavins.mavlink.codec import Payload, fields_of, param_error
from mavins.mavlink.microservice import Reply, Request
from mavins.mavlink.parameters import (
    PARAM_SET,
    ParameterStore,
    VehicleParameters,
    set_from,
    value_of,
)

PARAM_REQUEST_READ: Final = fields_of("PARAM_REQUEST_READ").msgid
PARAM_REQUEST_LIST: Final = fields_of("PARAM_REQUEST_LIST").msgid

DOES_NOT_EXIST: Final = 1
VALUE_OUT_OF_RANGE: Final = 2
PERMISSION_DENIED: Final = 3
"""Numbers of MAV_PARAM_ERROR."""
_INFO: Final = 6
_WARNING: Final = 4
"""Numbers of MAV_SEVERITY."""


class Owner(Protocol):
    """Whose parameters they are: a vehicle, which also numbers its texts."""

    @property
    def parameters(self) -> VehicleParameters:
        """The vehicle's parameters."""

    def text(self, text: str, severity: int) -> list[Payload]:
        """STATUSTEXT in chunks."""


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
        yield Reply(value_of(store, names[index]))
    elif index == -1 and name in names:
        yield Reply(value_of(store, name))
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
        yield Reply(value_of(store, name))
        return
    try:
        remark, severity = set_from(request.message, store), _INFO
    except ParameterError as error:
        yield Reply(param_error(name, -1, VALUE_OUT_OF_RANGE, *request.sender))
        remark, severity = str(error), _WARNING
    yield Reply(value_of(store, name), to_all=True)
    if remark:
        for text in vehicle.text(remark, severity):
            yield Reply(text)
