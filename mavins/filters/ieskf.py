"""The iterated error-state Kalman filter: the error-state filter with every update linearized where it leads to.

Sources: Bell and Cathey, "The iterated Kalman filter update as a Gauss-Newton method" (1993); Qin et al., "LINS"
(2020); Xu and Zhang, "FAST-LIO" (2021), for the manifold. Theory: docs/theory/ieskf.md.
"""

from __future__ import annotations

from mavins.filters.iterated import J_L, J_R, N_P, N_V, Iterated, write_gravity_block
from mavins.nav.kernels import kernel
from mavins.nav.layout import boxplus
from mavins.nav.so3 import write_right_jacobian
from mavins.types import FloatArray, IntArray


@kernel
def manifold_step(x: FloatArray, s: FloatArray, columns: IntArray, G: FloatArray) -> None:
    """X <- x [+] s; G <- its derivative by s: Jr(theta) on the attitude, the like on gravity, else the identity."""
    for i in range(3):
        for j in range(3):
            G[J_L, i, j] = 1.0 if i == j else 0.0
            G[N_P, i, j] = 0.0
            G[N_V, i, j] = 0.0
    write_right_jacobian(G[J_R], s[6], s[7], s[8])
    write_gravity_block(G, x, s)
    boxplus(x, s, columns)


class Ieskf(Iterated):
    """The iterated filter behind the estimator's `Filter` interface."""

    step = staticmethod(manifold_step)
