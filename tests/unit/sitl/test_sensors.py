"""The sensors err by what their settings say."""

import math

import numpy as np
import pytest

from mavins.nav.rotations import quats_to_dcms
from sitl import scenario
from sitl.gnss import NO_FIX, GnssSettings, Markov, MarkovSettings, Receiver, ReportedSettings
from sitl.heading import Compass, HeadingSettings
from sitl.imu import Triad, TriadSettings
from sitl.simulation import START_US

PERFECT = GnssSettings(sigma_h=0.0, sigma_v=0.0, sigma_speed=0.0)


def rng(seed=0):
    return np.random.Generator(np.random.PCG64(seed))


def read(settings, x, rate=100, seed=0):
    generator = rng(seed)
    return Triad(settings, rate, generator).measure(x, generator)


def test_a_perfect_triad_reads_the_truth():
    x = rng(1).normal(size=(50, 3))
    y, bias = read(TriadSettings(), x)
    np.testing.assert_array_equal(y, x)
    np.testing.assert_array_equal(bias, 0.0)


def test_white_noise_has_the_density():
    y, _ = read(TriadSettings(noise=0.01), np.zeros((40_000, 3)), rate=250)
    np.testing.assert_allclose(y.std(axis=0), 0.01 * math.sqrt(250), rtol=0.02)


def test_turn_on_bias_is_drawn_once_and_reported():
    settings = TriadSettings(bias=0.5)
    y, bias = read(settings, np.zeros((10, 3)))
    np.testing.assert_array_equal(y, bias)
    assert np.all(np.ptp(bias, axis=0) == 0.0)
    drawn = np.array([read(settings, np.zeros((1, 3)), seed=s)[1][0] for s in range(2000)])
    np.testing.assert_allclose(drawn.std(axis=0), 0.5, rtol=0.06)


def test_bias_walk_grows_with_the_root_of_time_across_blocks():
    ends = []
    for seed in range(500):
        generator = rng(seed)
        triad = Triad(TriadSettings(bias_walk=0.02), 50, generator)
        for _ in range(8):
            _, bias = triad.measure(np.zeros((50, 3)), generator)
        ends.append(bias[-1])
    np.testing.assert_allclose(np.std(ends), 0.02 * math.sqrt(8.0), rtol=0.06)


def test_scale_factor_quantum_and_full_scale():
    x = np.outer(np.linspace(-20.0, 20.0, 101), np.ones(3))
    y, _ = read(TriadSettings(scale_factor=0.01), x)
    gain = y[0] / x[0]
    np.testing.assert_allclose(y, x * gain)
    assert np.all(np.abs(gain - 1.0) < 0.05)
    assert np.ptp(gain) > 0.0
    y, _ = read(TriadSettings(quantum=0.5, full_scale=16.0), x)
    np.testing.assert_array_equal(np.mod(y, 0.5), 0.0)
    assert (y.min(), y.max()) == (-16.0, 16.0)
    assert np.abs(y - x)[np.abs(x) < 16.0].max() <= 0.25


def test_markov_errors_keep_their_sigma_and_forget_in_their_time():
    generator = rng(2)
    m = Markov(MarkovSettings(sigma=0.5, time=20.0), 5, generator).next(100_000, generator)
    np.testing.assert_allclose(m.std(axis=0), 0.5, rtol=0.06)
    lag = 100  # one correlation time
    for axis in m.T:
        assert np.mean(axis[:-lag] * axis[lag:]) / axis.var() == pytest.approx(
            math.exp(-1), abs=0.06
        )
    starts = [Markov(MarkovSettings(sigma=0.5), 5, rng(s))._m for s in range(2000)]
    np.testing.assert_allclose(np.std(starts, axis=0), 0.5, rtol=0.06)


@pytest.fixture(scope="module")
def trajectory():
    return scenario.load("quad_mission").trajectory()


def receive(settings, trajectory, seconds, seed=0):
    """The fixes of a receiver, and p_n and v_n that they tell."""
    period_us = 1_000_000 // settings.rate
    t_us = START_US + period_us * np.arange(seconds * settings.rate)
    k = trajectory.at((t_us - START_US) / 1e6 - settings.latency)
    generator = rng(seed)
    receiver = Receiver(settings, trajectory.frame, trajectory.period, generator)
    fixes = receiver.measure(t_us, k, generator)
    frame = trajectory.frame
    p_n = np.array([frame.from_lla(f.lat, f.lon, f.alt) for f in fixes])
    v_n = np.array([frame.local_level(f.lat, f.lon).T @ f.v_l for f in fixes])
    return fixes, p_n, v_n


def test_a_perfect_receiver_tells_the_truth_of_the_valid_time(trajectory):
    settings = GnssSettings(sigma_h=0.0, sigma_v=0.0, sigma_speed=0.0, latency=0.12)
    fixes, p_n, v_n = receive(settings, trajectory, 40)
    t = np.array([f.t_us - START_US for f in fixes]) / 1e6
    valid = trajectory.at(t - 0.12)
    np.testing.assert_allclose(p_n, valid.p_n, atol=1e-8)
    np.testing.assert_allclose(v_n, valid.v_n, atol=1e-9)
    assert np.linalg.norm(p_n - trajectory.at(t).p_n, axis=1).max() > 0.5


def test_the_antenna_is_where_the_lever_puts_it(trajectory):
    lever = (0.3, -0.2, -0.5)
    settings = GnssSettings(sigma_h=0.0, sigma_v=0.0, sigma_speed=0.0, lever_arm=lever)
    fixes, p_n, v_n = receive(settings, trajectory, 100)
    t = np.array([f.t_us - START_US for f in fixes]) / 1e6

    def antenna(s):
        k = trajectory.at(s)
        return k.p_n + quats_to_dcms(k.q_nb) @ lever

    np.testing.assert_allclose(p_n, antenna(t), atol=1e-8)
    rate = (antenna(t + 1e-4) - antenna(t - 1e-4)) / 2e-4
    np.testing.assert_allclose(v_n, rate, atol=1e-6)
    assert np.abs(v_n - trajectory.at(t).v_n).max() > 0.1


def test_white_gnss_noise_and_claims(trajectory):
    settings = GnssSettings(rate=10, sigma_h=0.4, sigma_v=0.9, sigma_speed=0.2)
    fixes, p_n, v_n = receive(settings, trajectory, 1000)
    k = trajectory.at(np.array([f.t_us - START_US for f in fixes]) / 1e6)
    np.testing.assert_allclose((p_n - k.p_n).std(axis=0), [0.4, 0.4, 0.9], rtol=0.04)
    np.testing.assert_allclose((v_n - k.v_n).std(axis=0), 0.2, rtol=0.04)
    assert (fixes[0].sigma_h, fixes[0].sigma_v, fixes[0].sigma_speed) == (0.4, 0.9, 0.2)
    assert (fixes[0].fix_type, fixes[0].satellites) == (3, 14)


def test_claims_hold_the_markov_part_or_what_they_are_told(trajectory):
    markov = MarkovSettings(sigma=0.3)
    fixes, *_ = receive(GnssSettings(sigma_h=0.4, markov_position=markov), trajectory, 1)
    assert fixes[0].sigma_h == pytest.approx(0.5)
    told = GnssSettings(reported=ReportedSettings(sigma_h=9.0))
    assert receive(told, trajectory, 1)[0][0].sigma_h == 9.0


def test_an_outage_freezes_the_numbers_and_comes_every_cycle(trajectory):
    settings = GnssSettings(outages=((20.0, 25.0),))
    fixes, *_ = receive(settings, trajectory, int(trajectory.period) + 30)
    seconds = np.array([f.t_us - START_US for f in fixes]) / 1e6 % trajectory.period
    out = (seconds >= 20.0) & (seconds < 25.0)
    assert out.sum() == 50
    assert [f.fix_type == NO_FIX for f in fixes] == out.tolist()
    frozen = {(f.lat, f.lon, f.alt, f.v_l) for f in fixes[100:125]}
    last = fixes[99]
    assert frozen == {(last.lat, last.lon, last.alt, last.v_l)}
    assert len({f.t_us for f in fixes[100:125]}) == 25


def test_an_outage_draws_as_much_as_a_fix_does(trajectory):
    with_outage, *_ = receive(GnssSettings(outages=((20.0, 25.0),)), trajectory, 60)
    without, *_ = receive(GnssSettings(), trajectory, 60)
    assert with_outage[200:] == without[200:]


def test_the_compass_has_noise_and_a_bias_and_wraps():
    generator = rng()
    compass = Compass(HeadingSettings(sigma_deg=2.0, bias_deg=5.0), generator)
    t_us = np.arange(20_000, dtype=np.int64)
    headings = compass.measure(t_us, np.full(20_000, math.pi), generator)
    yaw = np.array([h.yaw for h in headings])
    assert np.all(np.abs(yaw) <= math.pi)
    error = np.degrees((yaw - math.pi + math.pi) % (2 * math.pi) - math.pi)
    assert error.std() == pytest.approx(2.0, rel=0.03)
    biases = [Compass(HeadingSettings(bias_deg=5.0), rng(s))._bias for s in range(2000)]
    assert np.degrees(np.std(biases)) == pytest.approx(5.0, rel=0.06)
    assert headings[0].sigma == math.radians(2.0)
