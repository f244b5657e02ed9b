"""The stream of measurements: order, rates, one seed one stream."""

import dataclasses
import itertools

import numpy as np
import pytest

from mavins.types import GnssFix, HeadingFix, ImuSample
from sitl import scenario
from sitl.simulation import START_US, Simulation, TrueState, simulate, stamp


@pytest.fixture(scope="module")
def quad():
    return scenario.load("quad_mission")


def test_events_come_in_order_and_at_their_rates(quad):
    events = list(itertools.islice(Simulation(quad, 3), 3 * (250 + 50 + 5 + 50)))
    stamps = [stamp(event) for event in events]
    assert stamps == sorted(stamps)
    assert stamps[0] == START_US
    assert stamps[-1] < START_US + 3_000_000
    for kind, rate in ((ImuSample, 250), (HeadingFix, 50), (GnssFix, 5), (TrueState, 50)):
        own = [stamp(event) for event in events if isinstance(event, kind)]
        assert own == list(range(START_US, START_US + 3_000_000, 1_000_000 // rate))
    assert [type(event) for event in events[:4]] == [ImuSample, HeadingFix, GnssFix, TrueState]


def test_a_seed_gives_the_same_stream_for_any_duration(quad):
    short, long = simulate(quad, 7, 1.5), simulate(quad, 7, 4.0)
    n = len(short.imu)
    assert n == 375
    assert short.imu.gyro_b.tobytes() == long.imu.gyro_b[:n].tobytes()
    assert short.imu.accel_b.tobytes() == long.imu.accel_b[:n].tobytes()
    assert short.truth.b_g.tobytes() == long.truth.b_g[:n].tobytes()
    assert short.fixes == long.fixes[: len(short.fixes)]
    assert short.headings == long.headings[: len(short.headings)]
    events = itertools.islice(Simulation(quad, 7), 500)
    gyro = np.array([e.gyro_b for e in events if isinstance(e, ImuSample)])
    assert gyro.tobytes() == long.imu.gyro_b[: len(gyro)].tobytes()


def test_seeds_differ_in_everything_but_the_truth(quad):
    one, two = simulate(quad, 1, 1.0), simulate(quad, 2, 1.0)
    assert np.mean(one.imu.gyro_b != two.imu.gyro_b) > 0.9
    assert one.fixes[0].lat != two.fixes[0].lat
    assert one.headings[0].yaw != two.headings[0].yaw
    assert np.all(one.truth.b_a[0] != two.truth.b_a[0])
    np.testing.assert_array_equal(one.truth.p_n, two.truth.p_n)


def test_a_noise_that_is_off_does_not_move_the_others(quad):
    gyro = dataclasses.replace(quad.imu.gyro, scale_factor=0.0, bias=0.0)
    other = dataclasses.replace(quad, imu=dataclasses.replace(quad.imu, gyro=gyro))
    one, two = simulate(quad, 1, 1.0), simulate(other, 1, 1.0)
    assert one.fixes == two.fixes
    np.testing.assert_array_equal(one.imu.accel_b, two.imu.accel_b)


def test_readings_less_their_noises_are_the_truth(quad):
    clean = dataclasses.replace(
        quad.imu,
        gyro=dataclasses.replace(quad.imu.gyro, noise=0.0, scale_factor=0.0, quantum=0.0),
        accel=dataclasses.replace(quad.imu.accel, noise=0.0, scale_factor=0.0, quantum=0.0),
    )
    m = simulate(dataclasses.replace(quad, imu=clean), 4, 20.0)
    trajectory = quad.trajectory()
    k = trajectory.at((m.imu.t_us - START_US) / 1e6)
    w_b, f_b = trajectory.inertial(k)
    np.testing.assert_allclose(m.imu.gyro_b - m.truth.b_g, w_b, atol=1e-14)
    np.testing.assert_allclose(m.imu.accel_b - m.truth.b_a, f_b, atol=1e-13)
    np.testing.assert_array_equal(m.truth.q_nb, k.q_nb)


def test_integrated_samples_are_means_over_the_interval_before(quad):
    imu = dataclasses.replace(quad.imu, integrate=True)
    mean = simulate(dataclasses.replace(quad, imu=imu), 4, 20.0)
    point = simulate(quad, 4, 20.0)
    trajectory = quad.trajectory()
    t = (point.imu.t_us - START_US) / 1e6
    dtheta, _ = trajectory.increments(t - 0.004, 0.004)
    w_b, _ = trajectory.inertial(trajectory.at(t))
    expected = dtheta / 0.004 - w_b
    assert np.abs(expected).max() > 1e-3
    np.testing.assert_allclose(mean.imu.gyro_b - point.imu.gyro_b, expected, atol=1.5e-4)


def test_the_truth_is_that_of_the_trajectory(quad):
    m = simulate(quad, 0, 30.0)
    state = m.states[-1]
    frame = quad.trajectory().frame
    p_n = frame.from_lla(state.sample.lat, state.sample.lon, state.sample.alt)
    row = int(np.searchsorted(m.truth.t_us, state.sample.t_us))
    np.testing.assert_allclose(p_n, m.truth.p_n[row], atol=1e-8)
    assert np.linalg.norm(state.sample.v_l) == pytest.approx(np.linalg.norm(m.truth.v_n[row]))
    assert abs(m.truth.q_nb[row] @ state.sample.q_lb) == pytest.approx(1.0, abs=1e-9)


def test_a_duration_must_be_positive(quad):
    with pytest.raises(ValueError, match="positive"):
        simulate(quad, 0, 0.0)
