"""One time base per vehicle: kinds of stamps, reboots, jumps, wraps; grouping changes nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavins.mavlink.clock import WRAP_US, Clock, ImuTimes, is_unix

UNIX = 1_750_000_000_000_000
LATENCY = 3_000


def feed(
    clock: Clock, stamps: list[int], received: list[int] | None = None, **how: Any
) -> ImuTimes:
    at = received if received is not None else [UNIX + s % WRAP_US + LATENCY for s in stamps]
    return clock.map_imu(np.array(stamps, np.int64), np.array(at, np.int64), **how)


def running(t: int = 10_000_000) -> Clock:
    """A clock that has seen IMU stamps up to t."""
    clock = Clock()
    feed(clock, list(range(t - 400_000, t + 1, 4000)))
    return clock


def test_before_the_first_imu_there_is_no_time() -> None:
    clock = Clock()
    assert clock.newest_us is None
    assert clock.map(5_000_000, UNIX) == "no IMU yet"


def test_boot_stamps_are_the_base() -> None:
    clock = Clock()
    times = feed(clock, [1_000_000, 1_004_000, 1_008_000])
    assert times.t_us.tolist() == [1_000_000, 1_004_000, 1_008_000]
    assert times.keep.all()
    assert times.events == ()
    assert clock.map(900_000, UNIX, wraps=True) == 900_000
    assert clock.newest_us == 1_008_000


def test_magnitude_tells_unix_from_boot() -> None:
    assert is_unix(UNIX)
    assert not is_unix(400 * 86_400_000_000)


class TestUnixStamps:
    def test_system_time_tells_the_offset(self) -> None:
        clock = running()
        clock.system_time(UNIX, 10_000_000)
        assert clock.unix_minus_boot_us == UNIX - 10_000_000
        assert clock.map(UNIX - 200_000, 0) == 9_800_000
        assert clock.map(9_800_000, 0) == 9_800_000
        assert clock.unix_of(9_800_000) == UNIX - 200_000
        assert clock.unix_of(UNIX + 7) == UNIX + 7
        assert running().unix_of(9_800_000) is None

    def test_a_system_time_without_unix_time_or_of_another_boot_says_nothing(self) -> None:
        clock = running()
        clock.system_time(None, 10_000_000)
        clock.system_time(UNIX, 60_000_000)
        assert clock.unix_minus_boot_us is None

    def test_without_it_the_reception_places_the_message(self) -> None:
        clock = running()  # received 3 ms after each stamp
        assert clock.map(UNIX + 5, UNIX + 9_900_000 + LATENCY) == 9_900_000

    def test_the_smallest_recent_delay_counts(self) -> None:
        clock = Clock()
        stamps = list(range(1_000_000, 4_000_000, 4000))
        delays = [LATENCY if k % 50 == 7 else 40_000 for k in range(len(stamps))]
        feed(clock, stamps, [UNIX + s + d for s, d in zip(stamps, delays, strict=True)])
        assert clock.map(UNIX, UNIX + 3_900_000 + LATENCY) == 3_900_000
        # a link that falls 5 s behind is followed within two seconds
        later = list(range(4_000_000, 7_000_000, 4000))
        feed(clock, later, [UNIX + s + 5_000_000 for s in later])
        assert clock.map(UNIX, UNIX + 6_900_000 + 5_000_000) == 6_900_000

    def test_an_imu_in_unix_time_is_a_base_too(self) -> None:
        clock = Clock()
        feed(clock, [UNIX, UNIX + 4000])
        clock.system_time(UNIX + 4000, 50_000_000)
        assert clock.map(UNIX - 100_000, 0) == UNIX - 100_000
        assert clock.map(50_000_000, 0, wraps=True) == UNIX + 4000


class TestBadStamps:
    def test_zero_stamps_are_refused_and_counted(self) -> None:
        clock = running()
        assert clock.map(0, UNIX) == "zero stamp"
        times = feed(clock, [10_004_000, 0, 10_008_000, -5])
        assert times.keep.tolist() == [True, False, True, False]
        assert (times.zero_stamps, times.wild_stamps) == (2, 0)

    @pytest.mark.parametrize("wild", [1, 5_000_000, 11_000_000, 10**12, UNIX, 2**61])
    def test_one_bad_stamp_is_not_a_reboot(self, wild: int) -> None:
        clock = running()
        times = feed(clock, [10_004_000, wild, 10_008_000, wild, wild, 10_012_000])
        assert times.keep.tolist() == [True, False, True, False, False, True]
        assert times.wild_stamps == 3
        assert times.events == ()
        assert clock.newest_us == 10_012_000

    def test_reordered_and_repeated_packets_keep_their_stamps(self) -> None:
        clock = running()
        times = feed(clock, [10_008_000, 10_004_000, 10_004_000, 9_100_000, 10_012_000])
        assert times.keep.all()
        assert times.t_us.tolist() == [10_008_000, 10_004_000, 10_004_000, 9_100_000, 10_012_000]
        assert clock.newest_us == 10_012_000

    @pytest.mark.parametrize("stamp", [10_000_000 + 11_000_000, 10**14, 1])
    def test_a_message_far_from_the_imu_is_wild(self, stamp: int) -> None:
        clock = running(12_000_000)
        assert clock.map(stamp + 2_000_000 if stamp > 100 else stamp, UNIX) == "wild stamp"


class TestRebootsAndJumps:
    def test_three_stamps_make_a_reboot(self) -> None:
        clock = running()
        clock.system_time(UNIX, 10_000_000)
        times = feed(clock, [2_000_000, 2_004_000, 2_008_000, 2_012_000])
        assert times.keep.tolist() == [False, False, True, True]
        (event,) = times.events
        assert (event.kind, event.row, event.before_us, event.t_us) == (
            "reboot",
            2,
            10_000_000,
            2_008_000,
        )
        assert clock.newest_us == 2_012_000
        assert clock.unix_minus_boot_us is None
        assert clock.map(2_000_000, UNIX) == 2_000_000

    def test_a_late_packet_of_the_old_boot_delays_the_decision_only(self) -> None:
        clock = running()
        times = feed(clock, [2_000_000, 2_004_000, 10_004_000, 2_008_000, 2_012_000, 2_016_000])
        assert times.keep.tolist() == [False, False, True, False, False, True]
        assert [event.row for event in times.events] == [5]

    def test_a_repeated_wild_packet_does_not_confirm_itself(self) -> None:
        clock = running()
        assert feed(clock, [2_000_000] * 5).wild_stamps == 5

    def test_an_outage_is_a_jump(self) -> None:
        clock = running()
        times = feed(clock, [15_000_000, 15_004_000, 15_008_000])
        assert times.keep.tolist() == [False, False, True]
        assert [event.kind for event in times.events] == ["jump"]

    def test_a_short_gap_is_not(self) -> None:
        clock = running()
        times = feed(clock, [10_450_000, 10_454_000])
        assert times.keep.all()
        assert times.events == ()


class TestWrap:
    def test_imu_milliseconds_run_on_past_the_wrap(self) -> None:
        clock = Clock()
        last = WRAP_US - 4000
        stamps = [last - 4000, last, 4000, last, 8000, 12000]
        times = feed(clock, stamps, wraps=True)
        expected = [last - 4000, last, WRAP_US + 4000, last, WRAP_US + 8000, WRAP_US + 12000]
        assert times.t_us.tolist() == expected
        assert times.events == ()
        # and messages on either side of it find their place
        assert clock.map(8000, UNIX, wraps=True) == WRAP_US + 8000
        assert clock.map(last, UNIX, wraps=True) == last

    def test_milliseconds_wrap_while_the_imu_runs_on_in_microseconds(self) -> None:
        clock = running(WRAP_US + 5_000_000)
        assert clock.map(4_000_000, UNIX, wraps=True) == WRAP_US + 4_000_000
        clock.system_time(UNIX, 5_000_000)
        assert clock.unix_minus_boot_us == UNIX - WRAP_US - 5_000_000

    def test_a_reboot_after_a_wrap_starts_from_zero(self) -> None:
        clock = Clock()
        feed(clock, [WRAP_US - 4000, 4000, 8000], wraps=True)
        times = feed(clock, [1_000_000_000, 1_000_004_000, 1_000_008_000], wraps=True)
        assert [event.kind for event in times.events] == ["jump"]
        times = feed(clock, [5_000_000, 5_004_000, 5_008_000, 5_012_000], wraps=True)
        assert [event.kind for event in times.events] == ["reboot"]
        assert times.t_us[2:].tolist() == [5_008_000, 5_012_000]


steps = st.one_of(
    st.just(4000),
    st.just(4000),
    st.integers(-20_000, 20_000),
    st.sampled_from([-60_000_000, -2_000_000, 700_000, 3_000_000, 10**15, -(10**15)]),
)


@given(
    st.lists(st.tuples(steps, st.booleans(), st.integers(0, 50_000)), min_size=1, max_size=60),
    st.lists(st.integers(1, 9), min_size=1),
    st.booleans(),
)
@settings(deadline=None)
def test_however_rows_are_grouped_the_times_are_the_same(
    walk: list[tuple[int, bool, int]], groups: list[int], wraps: bool
) -> None:
    stamps, received, t, base = [], [], 0, 70_000_000
    for step, stays, delay in walk:
        t = base + step
        base = base + 4000 if stays else max(t, 1)
        stamps.append(t % WRAP_US // 1000 * 1000 if wraps else t)
        received.append(UNIX + len(stamps) * 4000 + delay)
    whole = Clock()
    at_once = feed(whole, stamps, received, wraps=wraps)
    split = Clock()
    t_us, keep, events, zeros, wild, row, k = [], [], [], 0, 0, 0, 0
    while row < len(stamps):
        n = groups[k % len(groups)]
        part = feed(split, stamps[row : row + n], received[row : row + n], wraps=wraps)
        t_us += part.t_us.tolist()
        keep += part.keep.tolist()
        events += [(e.kind, e.row + row, e.before_us, e.t_us) for e in part.events]
        zeros, wild = zeros + part.zero_stamps, wild + part.wild_stamps
        row, k = row + n, k + 1
    assert keep == at_once.keep.tolist()
    assert t_us == at_once.t_us.tolist()
    assert events == [(e.kind, e.row, e.before_us, e.t_us) for e in at_once.events]
    assert (zeros, wild) == (at_once.zero_stamps, at_once.wild_stamps)
    assert zeros + wild == keep.count(False)
    probe = UNIX + 77
    assert split.map(probe, probe) == whole.map(probe, probe)
