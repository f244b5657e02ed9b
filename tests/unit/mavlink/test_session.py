"""Who may come in, who is answered, and under which number."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as dialect

from mavins.config import Config
from mavins.mavlink.codec import frame, heartbeat, highres_imu
from mavins.mavlink.identity import identity_for
from mavins.mavlink.session import Session, Surroundings
from mavins.mavlink.settings import AskingSettings, SessionSettings
from mavins.types import ImuSample

# a flight through the estimator takes minutes where nothing is compiled
pytestmark = pytest.mark.jit

NOW_US = 1_790_000_000_000_000
HERE, THERE, AWAY = "here", "there", "away"


class Tape:
    """A recorder that keeps everything."""

    def __init__(self) -> None:
        self.packets: list[tuple[int, bytes]] = []

    def write(self, t_us: int, packet: bytes) -> None:
        self.packets.append((t_us, packet))


SILENT = AskingSettings(enabled=False)


class Rig:
    def __init__(self, make_estimator: Callable[[], Any], **settings: Any) -> None:
        self.tape = Tape()
        self.estimators: dict[int, Any] = {}
        self.now_us = NOW_US

        def make(sysid: int) -> Any:
            self.estimators[sysid] = make_estimator()
            return self.estimators[sysid]

        self.session = Session(
            Config(mavlink=SessionSettings(**settings), asking=SILENT),
            make,
            Surroundings(lambda address: address != AWAY, self.tape),
        )

    def put(self, data: bytes, address: str = HERE, after_us: int = 1000) -> list[Any]:
        """A datagram comes in; what goes out because of it, as (message, address)."""
        self.now_us += after_us
        self.session.receive(data, address, self.now_us)
        return self.out()

    def tick(self, after_us: int = 0) -> list[Any]:
        self.now_us += after_us
        self.session.tick(self.now_us)
        return self.out()

    def out(self) -> list[Any]:
        link = dialect.MAVLink(None)
        return [(link.decode(bytearray(data)), to) for data, to in self.session.datagrams()]


@pytest.fixture
def rig(make_estimator: Any) -> Rig:
    return Rig(make_estimator)


def imu(sysid: int = 1, t_us: int = 1_000_000) -> bytes:
    sample = ImuSample(t_us, np.array([0.0, 0.0, -9.8]), np.zeros(3))
    return frame(highres_imu(sample), sysid, 1, 0)


def beat(sysid: int = 255, compid: int = 190) -> bytes:
    return frame(heartbeat(6, 8), sysid, compid, 0)


def packed(message: Any, sysid: int = 255) -> bytes:
    return bytes(message.pack(dialect.MAVLink(None, sysid, 190)))


def asking(target: int, component: int = 1) -> bytes:
    return packed(
        dialect.MAVLink_command_long_message(target, component, 512, 0, 148, 0, 0, 0, 0, 0, 0)
    )


def origin(target: int) -> bytes:
    return packed(dialect.MAVLink_set_gps_global_origin_message(target, 470000000, 80000000, 4000))


@pytest.mark.parametrize(
    ("sysid", "seen", "ours", "expected"),
    [
        (1, set(), set(), 100),
        (8, set(), set(), 107),
        (152, set(), set(), 1),
        (255, set(), set(), 104),
        (1, {100, 101}, set(), 102),
        (1, {100}, {101}, 102),
        (151, {250}, set(), 1),
        (1, set(range(256)), set(), 100),
        (1, set(range(256)), {100}, 101),
    ],
)
def test_our_sysid(sysid: int, seen: set[int], ours: set[int], expected: int) -> None:
    assert identity_for(sysid, SessionSettings(), seen, ours) == (expected, 1)


def test_our_ids_as_configured() -> None:
    settings = SessionSettings(sysid=42)
    assert identity_for(1, settings, {42}, set()) == (42, 1)
    assert identity_for(2, settings, {1}, {42}) == (101, 1)
    assert identity_for(7, SessionSettings(persona="companion"), {7}, set()) == (7, 191)
    assert identity_for(7, SessionSettings(persona="companion", compid=197), {7}, {7}) == (7, 197)


def test_only_an_imu_makes_a_vehicle(rig: Rig) -> None:
    rig.put(beat(1, 1))
    assert rig.session.vehicles == {}
    rig.put(imu())
    assert set(rig.session.vehicles) == {1}
    assert rig.session.vehicles[1].identity == (100, 1)
    assert rig.estimators[1].imu_rows == 1


def test_everyone_who_sends_is_told_everything(rig: Rig) -> None:
    rig.put(imu(), HERE)
    rig.put(beat(), THERE)
    told = rig.tick(1_000_000)
    for address in (HERE, THERE):
        kinds = [m.get_type() for m, to in told if to == address]
        assert kinds == ["HEARTBEAT", "SYS_STATUS", "EXTENDED_SYS_STATE"]


def test_numbers_follow_each_other_for_each_peer(rig: Rig) -> None:
    rig.put(imu(), HERE)
    numbers: dict[str, list[int]] = {HERE: [], THERE: []}
    for k in range(300):
        if k == 100:
            rig.put(beat(), THERE)
        for message, to in rig.tick(1_000_000) if k % 20 else rig.put(asking(100), HERE):
            numbers[to].append(message.get_seq())
        rig.put(imu(t_us=1_000_000 + k * 1_000_000), HERE)
    for sequence in numbers.values():
        assert sequence == [k % 256 for k in range(len(sequence))]


def test_a_silent_peer_is_forgotten_but_not_a_named_one(rig: Rig) -> None:
    rig.session.add_peer("named")
    rig.put(imu(), HERE)
    rig.put(beat(), THERE)
    rig.tick(29_000_000)
    assert set(rig.session.peers) == {"named", HERE, THERE}
    rig.put(beat(), THERE)
    rig.tick(2_000_000)
    assert set(rig.session.peers) == {"named", THERE}


def test_a_named_peer_that_speaks_stays_named(rig: Rig) -> None:
    rig.session.add_peer(THERE)
    rig.put(beat(), THERE)
    rig.tick(10**9)
    assert set(rig.session.peers) == {THERE}


def test_commands_for_us_are_answered_to_the_one_who_asked(rig: Rig) -> None:
    rig.put(imu(), HERE)
    rig.put(beat(), THERE)
    answers = rig.put(asking(100), THERE)
    assert [(m.get_type(), to) for m, to in answers] == [
        ("COMMAND_ACK", THERE),
        ("AUTOPILOT_VERSION", THERE),
    ]
    assert len(rig.put(asking(0, 0), THERE)) == 2
    # those for the autopilot, for another component or for nobody are not ours to answer
    for data in (asking(1), asking(100, 191), asking(77)):
        assert rig.put(data, THERE) == []


def test_an_origin_is_taken_from_this_host_only(rig: Rig) -> None:
    rig.put(imu(), HERE)
    rig.put(origin(100) + beat(), AWAY)
    assert rig.estimators[1].origins == []
    assert rig.session.dropped["changes asked for by another host"] == 1
    assert AWAY in rig.session.peers  # the rest of the datagram counts
    assert not any(data == origin(100) for _, data in rig.tape.packets)
    rig.put(origin(100), THERE)
    rig.put(origin(0), THERE)
    rig.put(origin(1), THERE)
    assert len(rig.estimators[1].origins) == 2


def ordering(number: int, *p: float, target: int = 100) -> bytes:
    params = (*p, *[0.0] * (7 - len(p)))
    return packed(dialect.MAVLink_command_long_message(target, 1, number, 0, *params))


CHANGES = (
    ordering(611, 0, 0, 0, 0, 47.0, 8.0, 400.0),
    ordering(179, 1),
    ordering(241, 1),
    ordering(246, 1),
    ordering(245, 1),
)


@pytest.mark.parametrize("change", CHANGES)
def test_changes_are_denied_to_other_hosts_with_one_text(rig: Rig, change: bytes) -> None:
    rig.put(imu(), HERE)
    first, second = rig.put(change, AWAY), rig.put(change, AWAY)
    assert first[0][0].get_type() == "COMMAND_ACK"
    assert first[0][0].result == second[0][0].result == 2
    assert {m.get_type() for m, _ in first[1:]} == {"STATUSTEXT"}
    assert len(second) == 1
    assert {to for _, to in first + second} == {AWAY}
    assert not any(data == change for _, data in rig.tape.packets)
    # reads and rates are anybody's
    assert rig.put(ordering(511, 30, 100_000), AWAY)[0][0].result == 0


def test_remote_changes_are_taken_where_they_are_allowed(make_estimator: Any) -> None:
    rig = Rig(make_estimator, allow_remote_config=True)
    rig.put(imu(), HERE)
    assert rig.put(CHANGES[0], AWAY)[0][0].result == 0
    assert len(rig.estimators[1].origins) == 1
    assert any(data == CHANGES[0] for _, data in rig.tape.packets)


def test_each_peer_has_its_own_rates(rig: Rig) -> None:
    rig.put(imu(), HERE)
    rig.put(beat(), THERE)
    rig.estimators[1].start(1_000_000)
    rig.put(ordering(511, 30, 500_000), THERE)  # ATTITUDE twice a second
    rig.put(ordering(511, 32, -1), THERE)  # no LOCAL_POSITION_NED
    for t_us in (1_988_000, 1_992_000, 1_996_000, 2_000_000):
        rig.put(imu(t_us=t_us), HERE)
    counts: Counter[tuple[str, str]] = Counter()
    for k in range(1, 501):
        told = rig.put(imu(t_us=2_000_000 + k * 4000), HERE)
        counts.update((message.get_type(), to) for message, to in told)
    assert counts["ATTITUDE", THERE] == 4
    assert counts["LOCAL_POSITION_NED", THERE] == 0
    assert counts["ATTITUDE", HERE] == counts["LOCAL_POSITION_NED", HERE] == 100
    assert counts["ODOMETRY", HERE] == counts["ODOMETRY", THERE] == 50
    (_, (answer, to)) = rig.put(ordering(510, 30), THERE)
    assert (answer.get_type(), answer.interval_us, to) == ("MESSAGE_INTERVAL", 500_000, THERE)
    assert rig.put(ordering(510, 30), HERE)[1][0].interval_us == 20_000


def test_a_peer_that_has_gone_has_no_wishes_left(rig: Rig) -> None:
    rig.put(imu(), HERE)
    rig.put(ordering(511, 30, -1), THERE)
    rig.tick(31_000_000)
    rig.put(beat(), THERE)
    assert rig.put(ordering(510, 30), THERE)[1][0].interval_us == 20_000


def test_a_companion_shares_the_sysid_and_drops_its_own_echo(make_estimator: Any) -> None:
    rig = Rig(make_estimator, persona="companion")
    rig.put(imu(), HERE)
    rig.put(beat(), THERE)
    (heart, _) = rig.tick(1_000_000)[0]
    assert (heart.get_srcSystem(), heart.get_srcComponent()) == (1, 191)
    assert (heart.type, heart.autopilot) == (18, 8)
    rig.put(frame(heartbeat(18, 8), 1, 191, 0), THERE)
    assert rig.session.dropped["our own packets"] == 1
    rig.estimators[1].start(1_000_000)
    told = {m.get_type() for m, _ in rig.put(imu(t_us=2_000_000), HERE)}
    assert "ODOMETRY" in told
    assert not told & {"ATTITUDE", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED"}
    # a command to the autopilot itself is not ours, one to us is
    assert rig.put(asking(1, 1), THERE) == []
    assert rig.put(asking(1, 191), THERE)[0][0].get_type() == "COMMAND_ACK"


def test_an_origin_waits_for_its_vehicle(rig: Rig) -> None:
    rig.put(origin(100), HERE)
    rig.put(origin(107), HERE)
    rig.put(imu(8), THERE)
    rig.put(imu(1), HERE)
    assert len(rig.estimators[8].origins) == len(rig.estimators[1].origins) == 1


def test_everything_in_and_out_is_recorded(rig: Rig) -> None:
    rig.put(imu(), HERE)
    rig.put(asking(100), THERE)
    rig.tick(1_000_000)
    link = dialect.MAVLink(None)
    recorded = [(link.decode(bytearray(data)), t_us) for t_us, data in rig.tape.packets]
    kinds = [m.get_type() for m, _ in recorded]
    assert kinds == [
        "HIGHRES_IMU",
        "COMMAND_LONG",
        "COMMAND_ACK",
        "AUTOPILOT_VERSION",
        "HEARTBEAT",
        "SYS_STATUS",
        "EXTENDED_SYS_STATE",
    ]
    stamps = [t_us - NOW_US for _, t_us in recorded]
    assert stamps == [1000, 2000, 2000, 2000, 1002000, 1002000, 1002000]
    ours = [m.get_seq() for m, _ in recorded if m.get_srcSystem() == 100]
    assert ours == [0, 1, 2, 3, 4]


def test_damage_is_counted_and_nothing_of_it_recorded(rig: Rig) -> None:
    good = imu()
    rig.put(good[:-1] + bytes([good[-1] ^ 1]))
    rig.put(good[:20])
    rig.put(b"what is this")
    assert rig.session.dropped["bad crc"] == 1
    assert rig.session.dropped["truncated"] == 1
    assert rig.session.dropped["skipped bytes"] == len(good) + 20 + 12
    assert rig.tape.packets == []
    assert len(rig.session.peers) == 0


def test_packets_go_out_at_once_where_there_is_a_way(make_estimator: Any) -> None:
    sent: list[tuple[bytes, Any]] = []
    session = Session(
        Config(asking=SILENT),
        lambda sysid: make_estimator(),
        Surroundings(transmit=lambda data, address: sent.append((data, address))),
    )
    session.receive(imu(), HERE, NOW_US)
    session.tick(NOW_US)
    assert [address for _, address in sent] == [HERE, HERE, HERE]
    assert session.datagrams() == []
    assert session.packets_out == 3


def test_a_connection_that_ends_frees_its_peer_and_its_vehicle(rig: Rig) -> None:
    rig.session.add_peer(AWAY)
    rig.put(imu(1))
    rig.put(beat(), THERE)
    rig.session.hang_up(HERE)
    assert set(rig.session.peers) == {THERE, AWAY}
    rig.session.hang_up(AWAY)  # named by the user: it may come back
    rig.session.hang_up("never seen")
    assert set(rig.session.peers) == {THERE, AWAY}
    # another one may speak for the vehicle at once, and holds it then
    rig.put(imu(1, 1_004_000), THERE)
    assert rig.session.vehicles[1].holder.address == THERE
    rig.put(imu(1, 1_008_000), HERE)
    assert rig.session.dropped["sysid 1 from another address"] == 1
