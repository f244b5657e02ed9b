"""The truth of every scenario: exact derivatives, rest, seamless cycles, an INS that agrees."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mavins.errors import ScenarioError
from mavins.nav import so3
from mavins.nav.earth import gravity_n
from mavins.nav.rotations import euler_to_quats, quat_product, quats_to_dcms, yaws_of
from mavins.types import Origin
from sitl import scenario
from sitl.plan import Go, Hover, commanded, travel_time, travelled
from sitl.trajectory import Plan, build, tilt

NAMES = scenario.names()


@pytest.fixture(params=NAMES, scope="module")
def trajectory(request):
    return scenario.load(request.param).trajectory()


def fourth_order(f, t, h):
    """f' by central differences of fourth order."""
    return (8.0 * (f(t + h) - f(t - h)) - (f(t + 2 * h) - f(t - 2 * h))) / (12.0 * h)


def instants(trajectory, n=400):
    return np.random.default_rng(5).uniform(0.0, trajectory.period, n)


def test_the_five_scenarios_are_there():
    assert NAMES == ["figure8", "gnss_outage", "hover", "quad_mission", "square_spiral"]


def test_velocity_and_acceleration_are_derivatives(trajectory):
    t = instants(trajectory)
    k = trajectory.at(t)
    v = fourth_order(lambda s: trajectory.at(s).p_n, t, 1e-3)
    a = fourth_order(lambda s: trajectory.at(s).v_n, t, 1e-3)
    np.testing.assert_allclose(k.v_n, v, atol=1e-8)
    np.testing.assert_allclose(k.a_n, a, atol=1e-8)


def test_rates_are_the_attitude_s_derivative(trajectory):
    t, h = instants(trajectory), 1e-3

    def angle(d):
        q0, q1 = trajectory.at(t).q_nb, trajectory.at(t + d).q_nb
        return np.array(
            [so3.quat_log(so3.quat_mul(so3.quat_conj(a), b)) for a, b in zip(q0, q1, strict=True)]
        )

    rates = (8.0 * (angle(h) - angle(-h)) - (angle(2 * h) - angle(-2 * h))) / (12.0 * h)
    np.testing.assert_allclose(trajectory.at(t).w_nb_b, rates, atol=1e-8)


def test_it_stands_still_and_then_moves(trajectory):
    k = trajectory.at(np.linspace(0.0, 6.0, 601))
    for still in (k.p_n, k.v_n, k.a_n, k.w_nb_b):
        assert np.all(still == 0.0)
    assert np.ptp(k.q_nb, axis=0).max() < 1e-15
    assert np.linalg.norm(trajectory.at(np.array([10.0])).p_n) > 0.1


def test_the_cycles_join_without_a_seam(trajectory):
    assert trajectory.period == int(trajectory.period)
    end = trajectory.at(np.array([trajectory.period - 1e-6]))
    begin = trajectory.at(np.array([trajectory.period]))
    for name in ("p_n", "v_n", "a_n", "w_nb_b"):
        np.testing.assert_allclose(getattr(end, name), getattr(begin, name), atol=1e-9)
    assert abs(np.sum(end.q_nb * begin.q_nb)) == pytest.approx(1.0, abs=1e-14)
    t = instants(trajectory, 50)
    later = trajectory.at(t + 3.0 * trajectory.period)
    np.testing.assert_allclose(trajectory.at(t).p_n, later.p_n, atol=1e-9)


def test_position_is_smooth_to_the_fourth_derivative(trajectory):
    k = trajectory.at(np.arange(0.0, trajectory.period, 0.01))
    jerk = np.diff(k.a_n, axis=0) / 0.01
    snap = np.diff(jerk, axis=0) / 0.01
    assert np.abs(np.diff(snap, axis=0)).max() < 0.2 * np.abs(snap).max() + 1e-6


def test_a_perfect_ins_comes_back_to_the_truth(trajectory):
    """Integrate the mechanization of DESIGN with the ideal readings over 2 s of motion."""
    frame, begin, end = trajectory.frame, 21.0, 23.0

    def derivative(t, x):
        k = trajectory.at(np.array([t]))
        w, f = (rows[0] for rows in trajectory.inertial(k))
        q = x[6:] / np.linalg.norm(x[6:])
        C = so3.quat_to_dcm(q)
        v = x[3:6]
        a = C @ f + gravity_n(x[:3], frame.r0_e, frame.C_ne) - 2.0 * np.cross(frame.w_ie_n, v)
        w_nb_b = w - C.T @ frame.w_ie_n
        return np.concatenate([v, a, 0.5 * so3.quat_mul(q, np.append(0.0, w_nb_b))])

    first, last = (trajectory.at(np.array([t])) for t in (begin, end))
    x0 = np.concatenate([first.p_n[0], first.v_n[0], first.q_nb[0]])
    x = solve_ivp(derivative, (begin, end), x0, "DOP853", rtol=1e-10, atol=1e-11, max_step=0.05)
    np.testing.assert_allclose(x.y[:3, -1], last.p_n[0], atol=1e-6)
    np.testing.assert_allclose(x.y[3:6, -1], last.v_n[0], atol=1e-7)
    assert abs(x.y[6:, -1] @ last.q_nb[0]) == pytest.approx(1.0, abs=1e-12)


def test_increments_are_the_integrals(trajectory):
    begin = 20.0 + 0.01 * np.arange(100)
    dtheta, dv = trajectory.increments(begin, 0.01)
    fine = 20.0 + 1e-4 * (np.arange(10_000) + 0.5)
    w, f = trajectory.inertial(trajectory.at(fine))
    np.testing.assert_allclose(dtheta, w.reshape(100, 100, 3).mean(1) * 0.01, atol=1e-11)
    np.testing.assert_allclose(dv, f.reshape(100, 100, 3).mean(1) * 0.01, atol=1e-9)
    more, _ = trajectory.increments(begin, 0.01, nodes=8)
    np.testing.assert_allclose(dtheta, more, atol=1e-13)


@pytest.mark.parametrize("name", ["quad_mission", "figure8", "gnss_outage", "hover"])
def test_a_multicopter_thrusts_along_its_own_axis(name):
    trajectory = scenario.load(name).trajectory()
    k = trajectory.at(np.arange(0.0, trajectory.period, 0.05))
    _, f_b = trajectory.inertial(k)
    assert np.abs(f_b[:, :2]).max() < 0.02
    assert f_b[:, 2].max() < -5.0


def test_the_local_level_frame_is_the_earth_s():
    trajectory = scenario.load("square_spiral").trajectory()
    k = trajectory.at(np.array([3.0, 200.0]))
    lla, v_l, q_lb = trajectory.local_level(k)
    for i in range(2):
        np.testing.assert_allclose(lla[i], trajectory.frame.to_lla(k.p_n[i]), rtol=1e-14)
        C_ln = trajectory.frame.local_level(lla[i, 0], lla[i, 1])
        np.testing.assert_allclose(v_l[i], C_ln @ k.v_n[i], atol=1e-12)
        C_lb = C_ln @ so3.quat_to_dcm(k.q_nb[i])
        np.testing.assert_allclose(so3.quat_to_dcm(q_lb[i]), C_lb, atol=1e-14)


def test_rows_of_quaternions_agree_with_so3():
    rng = np.random.default_rng(3)
    euler = rng.uniform(-1.5, 1.5, (50, 3))
    p, q = euler_to_quats(euler), euler_to_quats(euler[::-1])
    for i in range(50):
        assert abs(so3.euler_to_quat(*euler[i]) @ p[i]) == pytest.approx(1.0)
        np.testing.assert_allclose(quats_to_dcms(p)[i], so3.quat_to_dcm(p[i]), atol=1e-15)
        np.testing.assert_allclose(quat_product(p, q)[i], so3.quat_mul(p[i], q[i]), atol=1e-15)
    np.testing.assert_allclose(yaws_of(p), euler[:, 2], atol=1e-12)


def test_tilt_turns_the_thrust_into_the_acceleration():
    a_n = np.array([[3.0, -2.0, 0.5]])
    euler = tilt(a_n, np.array([0.7]), 9.81)
    C = quats_to_dcms(euler_to_quats(euler))[0]
    thrust = a_n[0] - [0.0, 0.0, 9.81]
    np.testing.assert_allclose(C.T @ thrust, [0.0, 0.0, -np.linalg.norm(thrust)], atol=1e-12)


def test_travel_is_a_trapezoid_in_speed():
    total = travel_time(100.0, 8.0, 2.0)
    assert total == pytest.approx(100.0 / 8.0 + 4.0)
    s = travelled(np.linspace(0.0, total, 10_001), 100.0, 8.0, 2.0)
    assert s[0] == 0.0
    assert s[-1] == pytest.approx(100.0)
    assert np.diff(s).max() * 10_000 / total == pytest.approx(8.0)
    assert travelled(np.array([99.0]), 1.0, 8.0, 2.0)[0] == pytest.approx(1.0)  # never at top speed


def test_a_plan_must_come_home():
    with pytest.raises(ScenarioError, match="must end where and as it began"):
        commanded([Go("go", 10.0, 0.0)], 0.25)
    with pytest.raises(ScenarioError, match="turned by 90"):
        commanded([Go("go", 10.0, 0.0), Go("go", 0.0, 0.0, turn_deg=90.0)], 0.25)


def test_a_plan_stands_as_long_as_it_is_told():
    plan = Plan("plan", (Go("go", 5.0, 0.0), Hover("hover", 2.0), Go("go", 0.0, 0.0)), stand=20.0)
    trajectory = build(plan, Origin(0.9, 0.2, 100.0))
    assert np.all(trajectory.at(np.linspace(0.0, 20.0, 100)).v_n == 0.0)
    assert trajectory.at(np.array([23.0])).p_n[0, 0] > 0.1
    assert build(dataclasses.replace(plan), Origin(0.9, 0.2, 100.0)) is trajectory
