"""The parameter protocol: what is answered to whom, and how a list is paced."""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable
from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from mavins.config import Config
from mavins.mavlink.codec import Payload, frame, statustext
from mavins.mavlink.microservice import Reply, Request
from mavins.mavlink.parameter_service import Parameters
from mavins.mavlink.parameters import (
    LIST_BURST,
    MAX_LISTINGS,
    VehicleParameters,
    changes_since,
    is_refused,
    set_again,
    values_of,
)
from mavins.parameters import TABLE, ConfigStore

GCS = (255, 190)
ADDRESS = ("gcs", 1)
TICK_US = 50_000
NAMES = list(TABLE)


def decoded(payload: Payload) -> Any:
    """A payload as an independent receiver reads it."""
    return dialect.MAVLink(None).decode(bytearray(frame(payload, 100, 1, 0)))


def received(packet: bytes) -> Any:
    return dialect.MAVLink(None).decode(bytearray(packet))


def sent(message: Any) -> Any:
    """A message as it arrives."""
    return received(message.pack(dialect.MAVLink(None, *GCS)))


@dataclass
class Bench:
    """A service over the default configuration."""

    applied: list[Config] = field(default_factory=list)
    now_us: int = 1_000_000

    def __post_init__(self) -> None:
        self.store = ConfigStore(Config(), self.applied.append, lambda config: "")
        self.parameters = VehicleParameters(self.store)
        self.service = Parameters()

    def text(self, text: str, severity: int) -> list[Payload]:
        return statustext(text, severity, 1)

    def ask(
        self, message: Any, trusted: bool = True, address: Hashable = ADDRESS
    ) -> list[tuple[Any, bool]]:
        """(message, to all?) of each reply."""
        request = Request(sent(message), GCS, address, trusted, self.now_us)
        replies: Iterable[Reply] = self.service.answer(request, self)
        return [(decoded(r.payload), r.to_all) for r in replies]

    def set(self, name: str, value: float, kind: int = 9, trusted: bool = True) -> list[Any]:
        message = dialect.MAVLink_param_set_message(100, 1, name.encode(), value, kind)
        return self.ask(message, trusted)

    def read(self, name: str, index: int = -1) -> list[tuple[Any, bool]]:
        return self.ask(dialect.MAVLink_param_request_read_message(100, 1, name.encode(), index))

    def list(self, address: Hashable = ADDRESS) -> None:
        message = dialect.MAVLink_param_request_list_message(100, 1)
        assert self.ask(message, address=address) == []

    def tick(self, us: int = TICK_US) -> list[tuple[Hashable, Any]]:
        self.now_us += us
        return [(a, decoded(p)) for a, p in self.service.tick(self.now_us, self)]


def kinds(replies: list[tuple[Any, bool]]) -> list[str]:
    return [message.get_type() for message, _ in replies]


def test_a_list_brings_every_parameter_once_in_two_seconds_without_a_burst() -> None:
    b = Bench()
    b.list()
    ticks = [b.tick() for _ in range(40)]
    values = [m for tick in ticks for _, m in tick]
    assert [m.param_id for m in values] == NAMES
    assert [m.param_index for m in values] == list(range(len(NAMES)))
    assert {m.param_count for m in values} == {len(NAMES)}
    assert {m.param_type for m in values} == {dialect.MAV_PARAM_TYPE_REAL32}
    assert {a for tick in ticks for a, _ in tick} == {ADDRESS}
    assert max(map(len, ticks)) <= LIST_BURST
    assert ticks[-1] == []


def test_late_ticks_do_not_make_a_burst() -> None:
    b = Bench()
    b.list()
    assert len(b.tick(5_000_000)) == LIST_BURST


def test_several_peers_list_at_once_each_its_own() -> None:
    b = Bench()
    got: dict[Hashable, list[str]] = {k: [] for k in range(3)}
    for k in got:
        b.list(k)
        for address, m in b.tick():
            got[address].append(m.param_id)
    for _ in range(40):
        for address, m in b.tick():
            got[address].append(m.param_id)
    assert all(names == NAMES for names in got.values())


def test_a_repeated_request_begins_anew() -> None:
    b = Bench()
    b.list()
    first = [m.param_index for _, m in b.tick()]
    b.list()
    again = [m.param_index for _, m in b.tick()]
    assert first == again[: len(first)]
    assert again[0] == 0


def test_no_more_peers_than_a_limit_list_at_once() -> None:
    b = Bench()
    for k in range(MAX_LISTINGS + 5):
        b.list(k)
    assert {a for a, _ in b.tick()} == set(range(MAX_LISTINGS))
    for _ in range(40):
        b.tick()
    b.list("later")
    assert {a for a, _ in b.tick()} == {"later"}


@pytest.mark.parametrize("name", ["GNSS_GATE", "GNSS_STAND_SPEED"])
def test_a_value_is_read_by_name_and_by_index(name: str) -> None:
    b = Bench()
    index = NAMES.index(name)
    for asked in (b.read(name), b.read("", index), b.read("OTHER", index)):
        ((message, to_all),) = asked
        assert not to_all
        assert (message.get_type(), message.param_id, message.param_index) == (
            "PARAM_VALUE",
            name,
            index,
        )
        assert message.param_value == pytest.approx(b.store.value(name))


@pytest.mark.parametrize(
    ("name", "index"),
    [("NO_SUCH", -1), ("", -1), ("GNSS_GATE", -2), ("GNSS_GATE", len(NAMES)), ("", 32767)],
)
def test_what_is_not_there_is_an_error_to_who_asked(name: str, index: int) -> None:
    ((message, to_all),) = Bench().read(name, index)
    assert not to_all
    assert message.get_type() == "PARAM_ERROR"
    assert message.error == dialect.MAV_PARAM_ERROR_DOES_NOT_EXIST
    assert (message.target_system, message.target_component) == GCS
    assert (message.param_id, message.param_index) == (name, index)


@pytest.mark.parametrize("kind", [1, 6, 9, 10, 255])
def test_a_set_value_is_told_to_all_whatever_type_it_claims(kind: int) -> None:
    b = Bench()
    ((message, to_all),) = b.set("GNSS_SATS_MIN", 8.0, kind)
    assert to_all
    assert (message.get_type(), message.param_value, message.param_type) == ("PARAM_VALUE", 8.0, 9)
    assert [c.gnss.min_satellites for c in b.applied] == [8]


def test_setting_the_value_that_it_has_is_told_too() -> None:
    b = Bench()
    assert kinds(b.set("GNSS_GATE", 5.0)) == ["PARAM_VALUE"]
    assert b.applied == []


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("GNSS_GATE", math.nan),
        ("GNSS_GATE", math.inf),
        ("GNSS_GATE", -1.0),
        ("GNSS_GATE", 3e38),
        ("GNSS_SATS_MIN", 2.5),
        ("FILTER", 77.0),
        ("ZUPT_ENABLE", 2.0),
    ],
)
def test_a_refused_value_is_an_error_and_the_value_that_holds(name: str, value: float) -> None:
    b = Bench()
    replies = b.set(name, value)
    assert kinds(replies)[:2] == ["PARAM_ERROR", "PARAM_VALUE"]
    assert set(kinds(replies)[2:]) == {"STATUSTEXT"}
    (error, error_to_all), (told, told_to_all), *texts = replies
    assert error.error == dialect.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE
    assert (error_to_all, told_to_all) == (False, True)
    assert not any(to_all for _, to_all in texts)
    assert told.param_value == pytest.approx(b.store.value(name))
    text = "".join(m.text for m, _ in texts)
    assert TABLE[name].allowed in text
    assert b.store.config == Config()


def test_a_stranger_is_not_permitted() -> None:
    b = Bench()
    replies = b.set("GNSS_GATE", 4.0, trusted=False)
    assert kinds(replies) == ["PARAM_ERROR", "PARAM_VALUE"]
    assert replies[0][0].error == dialect.MAV_PARAM_ERROR_PERMISSION_DENIED
    assert replies[1][0].param_value == 5.0
    assert not any(to_all for _, to_all in replies)
    assert b.applied == []


def test_what_waits_for_a_restart_is_told_and_said_once() -> None:
    b = Bench()
    replies = b.set("EST_BUFFER", 2.0)
    assert kinds(replies)[0] == "PARAM_VALUE"
    assert replies[0][0].param_value == 2.0
    assert "restart" in "".join(m.text for m, _ in replies[1:])
    assert kinds(b.set("EST_BUFFER", 2.0)) == ["PARAM_VALUE"]


def test_an_unknown_name_cannot_be_set() -> None:
    replies = Bench().set("NO_SUCH", 1.0)
    assert kinds(replies) == ["PARAM_ERROR"]
    assert replies[0][0].error == dialect.MAV_PARAM_ERROR_DOES_NOT_EXIST
    assert replies[0][0].param_id == "NO_SUCH"


def test_after_a_reset_the_changes_are_told() -> None:
    b = Bench()
    b.set("GNSS_GATE", 4.0)
    b.set("FILTER", 2.0)
    before = values_of(b.store)
    b.store.reset()
    told = [decoded(p) for p in changes_since(before, b.store)]
    assert {(m.param_id, m.param_value) for m in told} == {("GNSS_GATE", 5.0), ("FILTER", 0.0)}


@given(
    st.one_of(st.binary(max_size=16), st.sampled_from(NAMES).map(str.encode)),
    st.floats(width=32),
    st.integers(0, 255),
    st.booleans(),
)
def test_any_bytes_of_a_set_are_answered(
    name: bytes, value: float, kind: int, trusted: bool
) -> None:
    b = Bench()
    message = dialect.MAVLink_param_set_message(100, 1, name, value, kind)
    replies = b.ask(message, trusted)
    assert kinds(replies)[0] in ("PARAM_ERROR", "PARAM_VALUE")
    known = name.split(b"\0")[0].decode("ascii", "replace") in NAMES
    assert ("PARAM_VALUE" in kinds(replies)) == known
    for parameter in NAMES:
        assert math.isfinite(b.store.value(parameter))
    assert trusted or b.store.config == Config()


@given(st.binary(max_size=16), st.integers(-(2**15), 2**15 - 1))
def test_any_bytes_of_a_read_are_answered(name: bytes, index: int) -> None:
    message = dialect.MAVLink_param_request_read_message(100, 1, name, index)
    assert len(Bench().ask(message)) == 1


@pytest.mark.parametrize(("value", "refused"), [(4.0, False), (-4.0, True), (math.nan, True)])
def test_it_is_known_beforehand_what_will_be_refused(value: float, refused: bool) -> None:
    b = Bench()
    message = sent(dialect.MAVLink_param_set_message(100, 1, b"GNSS_GATE", value, 9))
    assert is_refused(message, b.store) is refused
    assert b.store.config == Config()


def test_a_replay_sets_what_was_set() -> None:
    b = Bench()
    message = dialect.MAVLink_param_set_message(100, 1, b"GNSS_DELAY", 0.18, 9)
    set_again(sent(message), b.store)
    assert b.store.config.gnss.delay == 0.18
