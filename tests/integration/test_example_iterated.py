"""`mavins example iterated`: its figures hold, it needs no data, and the start is off by what it says."""

from __future__ import annotations

import math
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from mavins.cli.main import main
from mavins.examples.drawing import HINT
from mavins.examples.iterated import BEGIN, CLOSE, IMU_RATE, converged_after, flown, start
from mavins.nav.so3 import quat_to_euler, wrap_pi
from sitl.simulation import simulate

pytestmark = [pytest.mark.slow, pytest.mark.jit]


def test_figures_hold(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["example", "iterated", "--out", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "all 2 figures hold" in printed
    assert "50 seeds" in printed
    pictures = {path.name for path in tmp_path.iterdir()}
    if find_spec("matplotlib") is None:
        assert HINT in printed
        assert pictures == set()
    else:
        assert pictures == {"iterated.png"}


def test_the_start_is_off_by_sixty_degrees_and_a_hundred_metres() -> None:
    scenario = flown()
    m = simulate(scenario, 0, BEGIN + 1.0)
    k = round(BEGIN * IMU_RATE)
    rng = np.random.default_rng(1)
    signs = set()
    for _ in range(10):
        state = start(m, k, scenario, rng)
        assert np.linalg.norm(state.x[:3] - m.truth.p_n[k]) == pytest.approx(100.0)
        yaw = wrap_pi(quat_to_euler(state.x[6:10])[2] - quat_to_euler(m.truth.q_nb[k])[2])
        assert abs(yaw) == pytest.approx(math.radians(60.0), abs=math.radians(3.0))
        signs.add(math.copysign(1.0, yaw))
        assert np.linalg.eigvalsh(state.P)[0] > 0.0
    assert signs == {-1.0, 1.0}


def test_converged_is_close_to_the_end() -> None:
    near, far = (0.5 * CLOSE[0], 0.5 * CLOSE[1]), (2.0 * CLOSE[0], 0.5 * CLOSE[1])
    lost = (0.5 * CLOSE[0], 2.0 * CLOSE[1])

    def seconds(*errors: tuple[float, float]) -> float:
        return converged_after(np.array([(0.1 * k, *e) for k, e in enumerate(errors, start=1)]))

    assert seconds(near, near) == 0.1
    assert seconds(far, near, lost, near, near) == pytest.approx(0.4)
    assert seconds(near, far) == math.inf
