"""What a MAVLink microservice of ours is: it answers requests that are addressed to a vehicle of ours.

A microservice is one module and one line in `session.MICROSERVICES`. It knows no addresses and no sequence numbers:
the session asks who may do what, hands the request over, and sends the replies.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from mavins.mavlink.codec import Payload

if TYPE_CHECKING:
    from mavins.mavlink.vehicle import Vehicle


@dataclass(frozen=True, slots=True)
class Request:
    """A message for one of our vehicles, or for all of them.

    `message` is as pymavlink decoded it; `sender` is (sysid, compid); `address` is the peer it came from; `trusted`
    says whether it may change our state; `now_us` is its reception stamp.
    """

    message: Any
    sender: tuple[int, int]
    address: Hashable
    trusted: bool
    now_us: int


@dataclass(frozen=True, slots=True)
class Reply:
    """What is sent because of a request: to the peer that asked, or to all peers."""

    payload: Payload
    to_all: bool = False


class Microservice(Protocol):
    """One protocol of MAVLink's, for one of our vehicles."""

    msgids: frozenset[int]
    """The requests that it answers."""

    def answer(self, request: Request, vehicle: Vehicle) -> Iterable[Reply]:
        """What is sent because of a request."""

    def tick(self, now_us: int, vehicle: Vehicle) -> Iterable[tuple[Hashable, Payload]]:
        """What is due by our clock, some twenty times a second: (peer, payload), for what must be paced."""
