"""The closed form against Van Loan's own: the exponential of a matrix of twice the size."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import expm

from mavins.filters import van_loan
from mavins.filters.van_loan import Noise
from mavins.types import FloatArray

SEEDS = range(4)
NOISES: list[Noise] = [(2e-4, 0.1, 1e-8, 1e-5), (0.3, 0.2, 0.1, 0.05)]


def filled(seed: int, n: int = 15) -> van_loan.Workspace:
    """A workspace with random dynamics that turn at 1 rad/s."""
    rng = np.random.default_rng(seed)
    work = van_loan.workspace(n)
    M = work[0]
    A = rng.normal(size=(3, 3))
    M[van_loan.A] = A / np.linalg.norm(A, 2)
    M[van_loan.B] = rng.normal(size=(3, 3)) * 5.0
    M[van_loan.C] = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    M[van_loan.BEFORE] = rng.normal(size=(3, 3))
    M[van_loan.AFTER] = rng.normal(size=(3, 3))
    return work


def by_exponential(M: FloatArray, h: float, noise: Noise, n: int) -> tuple[FloatArray, FloatArray]:
    """(Phi, Q) of n states, theta multiplied by BEFORE and AFTER."""
    F = np.zeros((n, n))
    F[0:3, 3:6] = np.eye(3)
    F[3:6, 6:9] = M[van_loan.B]
    F[3:6, 12:15] = -M[van_loan.C]
    F[6:9, 6:9] = M[van_loan.A]
    F[6:9, 9:12] = -np.eye(3)
    q_g, q_a, q_bg, q_ba = noise
    G = np.zeros((n, n))
    G[:15, :15] = np.diag(np.repeat([0.0, q_a, q_g, q_bg, q_ba], 3))
    E = expm(np.block([[-F, G], [np.zeros((n, n)), F.T]]) * h)
    Phi = E[n:, n:].T
    before, after = np.eye(n), np.eye(n)
    before[6:9, 6:9], after[6:9, 6:9] = M[van_loan.BEFORE], M[van_loan.AFTER]
    return after @ Phi @ before, after @ Phi @ E[:n, n:] @ after.T


@pytest.mark.parametrize("n", [15, 19])
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("h", [0.004, 0.02, 0.1])
def test_covariance_goes_as_the_transition_says(h: float, seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    work = filled(seed, n)
    Phi, _ = by_exponential(work[0], h, (0.0, 0.0, 0.0, 0.0), n)
    root = rng.normal(size=(n, n))
    P = root @ root.T
    P = 0.5 * (P + P.T)
    expected = Phi @ P @ Phi.T
    van_loan.predict(P, h, (0.0, 0.0, 0.0, 0.0), work)
    assert_allclose(P, expected, atol=1e-14 * expected.max())
    assert_array_equal(P, P.T)


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("h", "tolerance"), [(0.02, 1e-12), (0.1, 1e-8)])
def test_noise_is_that_of_the_exponential(
    h: float, tolerance: float, seed: int, noise: Noise
) -> None:
    """Beside the sigmas of its row and column; at 0.02 s both are exact to the exponential's rounding."""
    work = filled(seed)
    _, Q = by_exponential(work[0], h, noise, 15)
    P = np.zeros((15, 15))
    van_loan.predict(P, h, noise, work)
    sigma = np.sqrt(np.diag(Q))
    assert_allclose(P / sigma / sigma[:, None], Q / sigma / sigma[:, None], atol=tolerance)
    assert_array_equal(P, P.T)
