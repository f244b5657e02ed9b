"""The slope of a likelihood, and how much the innovations know of each parameter, from runs at neighbouring values.

    dl/di = sum -w r^T S^-1 dr_i + w/2 r^T S^-1 dS_i S^-1 r - 1/2 tr(S^-1 dS_i),   w = rho'(NIS)
    I_ij  = sum dr_i^T S^-1 dr_j + 1/2 tr(S^-1 dS_i S^-1 dS_j)

Source: Gupta and Mehra (1974); White (1982) for the intervals of a model that is wrong. Theory: docs/theory/tuning.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mavins.evaluation.likelihood import Flight, Innovations
from mavins.types import FloatArray

BLOCK_US: Final = 5_000_000
"""Scores are summed over so long: within it, errors that the filter takes for white may last."""


@dataclass(frozen=True, slots=True)
class Scores:
    """Of n parameters: the slope of log p (n,), Fisher's information (n, n), and the slope's parts (B, n) by time."""

    gradient: FloatArray
    information: FloatArray
    blocks: FloatArray

    def sigmas(self) -> FloatArray:
        """1-sigma (n,) of each parameter: what the information allows, or White's where the parts scatter more."""
        inverse = np.linalg.pinv(self.information)
        parts = self.blocks - self.blocks.mean(axis=0)
        sandwich = inverse @ (parts.T @ parts) @ inverse
        largest = np.maximum(np.diag(inverse), np.diag(sandwich))
        unknown = np.diag(self.information) <= 0.0
        return np.where(unknown, np.inf, np.sqrt(np.maximum(largest, 0.0)))


def scores_of(
    flights: Sequence[Flight], moved: Sequence[Sequence[Flight]], steps: FloatArray
) -> Scores:
    """The scores at `flights`, from the same with each parameter in turn `moved` by its step."""
    n = len(steps)
    information = np.zeros((n, n))
    blocks: list[FloatArray] = []
    for k, flight in enumerate(flights):
        by_time: dict[int, FloatArray] = {}
        for key, part in flight.items():
            if not len(part.stamps):
                continue
            terms, known = _of_part(part, [other[k][key] for other in moved], steps)
            information += known
            for block, row in zip((part.stamps // BLOCK_US).tolist(), terms, strict=True):
                by_time[block] = by_time.get(block, 0.0) + row
        blocks += by_time.values()
    rows = np.array(blocks)
    return Scores(rows.sum(axis=0), information, rows)


def _of_part(
    part: Innovations, moved: Sequence[Innovations], steps: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """The slope's terms (N, n) of one aiding, and its information (n, n)."""
    r, S = part.r, part.S
    inverse = np.linalg.inv(S)
    y = np.einsum("kab,kb->ka", inverse, r)
    nis = np.einsum("ka,ka->k", r, y)
    w = np.minimum(1.0, part.bend() / np.maximum(nis, 1e-12))
    d_r = np.array([(other.r - r) / h for other, h in zip(moved, steps, strict=True)])
    d_S = np.array([(other.S - S) / h for other, h in zip(moved, steps, strict=True)])
    A = np.einsum("kab,ikbc->ikac", inverse, d_S)
    terms = (
        -w * np.einsum("ka,ika->ik", y, d_r)
        + 0.5 * w * np.einsum("ka,ikab,kb->ik", y, d_S, y)
        - 0.5 * np.einsum("ikaa->ik", A)
    )
    information = np.einsum("ika,kab,jkb->ij", d_r, inverse, d_r, optimize=True) + 0.5 * np.einsum(
        "ikab,jkba->ij", A, A, optimize=True
    )
    return terms.T, information
