"""The state of every filter: a nominal array `x`, and which error states a covariance is over.

The nominal state is one contiguous array with a fixed place for each quantity:

    x = [p_n (3) | v_n (3) | q_nb (4) | b_g (3) | b_a (3) | l_b (3) | tau (1) | b_baro (1) | b_m (3) | g_n (2)]

The canonical errors are additive, except two: that of the attitude is local, q_true = q (x) Exp(theta_b), and that of
gravity's direction lies on the sphere (s2.py). A `Layout` says which of their blocks a filter has, and where; blocks
it does not have keep their nominal value.
Theory: docs/theory/error_state.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavins.nav.kernels import kernel
from mavins.nav.s2 import difference, moved
from mavins.nav.so3 import exponential, product, quat_conj, quat_log, quat_mul
from mavins.types import FloatArray, IntArray

X_P: Final = slice(0, 3)
X_V: Final = slice(3, 6)
X_Q: Final = slice(6, 10)
X_BG: Final = slice(10, 13)
X_BA: Final = slice(13, 16)
X_L: Final = slice(16, 19)
X_TAU: Final = 19
X_BARO: Final = 20
X_BM: Final = slice(21, 24)
X_G: Final = slice(24, 26)
X_SIZE: Final = 26
"""Places in the nominal state array."""

P_N: Final = slice(0, 3)
V_N: Final = slice(3, 6)
THETA_B: Final = slice(6, 9)
B_G: Final = slice(9, 12)
B_A: Final = slice(12, 15)
L_B: Final = slice(15, 18)
TAU: Final = slice(18, 19)
B_BARO: Final = slice(19, 20)
B_M: Final = slice(20, 23)
G_N: Final = slice(23, 25)
CANONICAL_SIZE: Final = 25
"""Places among the canonical errors, which are the columns of every aiding Jacobian."""

BLOCKS: Final = {
    "p_n": P_N,
    "v_n": V_N,
    "theta_b": THETA_B,
    "b_g": B_G,
    "b_a": B_A,
    "l_b": L_B,
    "tau": TAU,
    "b_baro": B_BARO,
    "b_m": B_M,
    "g_n": G_N,
}
"""In the order in which every layout has them: where gravity is estimated, its errors are the last two."""
CORE: Final = ("p_n", "v_n", "theta_b", "b_g", "b_a")


def size_of(block: str) -> int:
    """The number of a block's error states."""
    return BLOCKS[block].stop - BLOCKS[block].start


@dataclass(frozen=True, slots=True)
class Layout:
    """Which error blocks a filter has. `columns[i]` is the canonical index of its i-th error state."""

    blocks: tuple[str, ...]
    columns: IntArray

    @classmethod
    def of(cls, blocks: Iterable[str] = CORE) -> Layout:
        """The layout with the given blocks, in the order of `BLOCKS`, of which the core ones must be there."""
        names = tuple(blocks)
        if names[: len(CORE)] != CORE or names != tuple(b for b in BLOCKS if b in names):
            raise ValueError(f"a layout begins with {CORE}, then some of {tuple(BLOCKS)}: {names}")
        columns = [i for name in names for i in range(BLOCKS[name].start, BLOCKS[name].stop)]
        return cls(names, np.array(columns, dtype=np.int64))

    @property
    def size(self) -> int:
        """The number of error states."""
        return len(self.columns)

    @property
    def has_gravity(self) -> bool:
        """True where gravity's direction is estimated."""
        return "g_n" in self.blocks

    def sigmas(self, P: FloatArray) -> FloatArray:
        """sqrt(diag P) (..., 25) over all canonical errors, zero where the layout does not have one; P (..., n, n)."""
        out = np.zeros((*P.shape[:-2], CANONICAL_SIZE))
        out[..., self.columns] = np.sqrt(np.maximum(np.diagonal(P, axis1=-2, axis2=-1), 0.0))
        return out


GRAVITY = 23
"""The first of both canonical errors of gravity's direction."""


@kernel
def boxplus(x: FloatArray, d: FloatArray, columns: IntArray) -> None:
    """X <- x [+] d, in place: the errors `d` of the layout with `columns` are added to the nominal state."""
    t0 = t1 = t2 = 0.0
    for i in range(len(columns)):
        c = columns[i]
        if c < 6:
            x[c] += d[i]
        elif c == 6:
            t0 = d[i]
        elif c == 7:
            t1 = d[i]
        elif c == 8:
            t2 = d[i]
        elif c == GRAVITY:
            x[24], x[25] = moved((x[24], x[25]), d[i], d[i + 1])
        elif c != GRAVITY + 1:
            x[c + 1] += d[i]
    q = product((x[6], x[7], x[8], x[9]), exponential(t0, t1, t2))
    n = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    if q[0] < 0.0:
        n = -n
    x[6] = q[0] / n
    x[7] = q[1] / n
    x[8] = q[2] / n
    x[9] = q[3] / n


@kernel
def boxminus(a: FloatArray, b: FloatArray, columns: IntArray) -> FloatArray:
    """A [-] b: the errors d of the layout with b [+] d = a."""
    theta = quat_log(quat_mul(quat_conj(b[6:10]), a[6:10]))
    d = np.empty(len(columns))
    for i in range(len(columns)):
        c = columns[i]
        if c < 6:
            d[i] = a[c] - b[c]
        elif c < 9:
            d[i] = theta[c - 6]
        elif c == GRAVITY:
            d[i], d[i + 1] = difference((a[24], a[25]), (b[24], b[25]))
        elif c != GRAVITY + 1:
            d[i] = a[c + 1] - b[c + 1]
    return d
