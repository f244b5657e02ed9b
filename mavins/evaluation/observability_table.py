"""An observability analysis as lines of text and as a dictionary."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from mavins.evaluation.observability import Analysis, Segment
from mavins.types import FloatArray

SHARE: Final = 0.1
"""A state with at least this share of a unit vector's square is named with the direction."""
COLUMNS: Final = 8
"""At most so many instants are shown for each state."""
UNITS: Final = {
    "p_n": "m",
    "v_n": "m/s",
    "theta_b": "rad",
    "b_g": "rad/s",
    "b_a": "m/s^2",
    "l_b": "m",
    "tau": "s",
}


def direction(vector: FloatArray, states: tuple[str, ...]) -> str:
    """The states that dominate a direction, with their components; the largest is positive."""
    order = np.argsort(-np.abs(vector))
    signed = vector * np.sign(vector[order[0]])
    return " ".join(f"{states[i]} {signed[i]:+.2f}" for i in order if vector[i] ** 2 >= SHARE)


def table_lines(analysis: Analysis) -> Iterator[str]:
    """Two tables: the segments, each by itself, and the states, with all data up to an instant."""
    states, segments = analysis.states, analysis.segments
    begin_us = segments[0].start_us
    width = max(len(s.label) for s in segments) + 2
    yield f"{'from - to, s':<15}{'manoeuvre':<{width}}{'rank':>6}{'condition':>11}  weakest direction (its information)"
    for s in segments:
        bounds = f"{(s.start_us - begin_us) * 1e-6:5.1f} - {(s.end_us - begin_us) * 1e-6:5.1f}"
        yield (
            f"{bounds:<15}{s.label:<{width}}{f'{s.rank}/{len(states)}':>6}{s.condition:>11.1e}"
            f"  {direction(s.weakest, states)} ({s.values[-1]:.1e})"
        )
    yield "rank: directions in which the segment alone tells more than the prior; information: per prior variance"
    yield ""
    shown = [segments[i] for i in _spread(len(segments))]
    heads = "".join(f"{(s.end_us - begin_us) * 1e-6:>7.0f}" for s in shown)
    yield f"{'state':<11}{'prior':>9} {'':<7}{'visible':>9}  sigma / prior sigma after s:{heads}"
    for i, state in enumerate(states):
        visible = analysis.visible_us[i]
        when = "never" if visible < 0 else f"{(visible - begin_us) * 1e-6:.1f} s"
        unit = UNITS[state.partition(".")[0]]
        cells = "".join(f"{s.ratios[i]:>7.3f}" for s in shown)
        yield f"{state:<11}{analysis.prior[i]:>9.3g} {unit:<7}{when:>9}{'':<30}{cells}"


def _spread(count: int) -> list[int]:
    spread = np.linspace(0, count - 1, min(count, COLUMNS)).round()
    return [int(i) for i in np.unique(spread)]


def as_dict(analysis: Analysis) -> dict[str, Any]:
    """The analysis for JSON; times in s of the boot clock, information per prior variance."""
    states = analysis.states
    return {
        "states": [
            {
                "name": name,
                "unit": UNITS[name.partition(".")[0]],
                "prior_sigma": float(analysis.prior[i]),
                "visible_s": None if analysis.visible_us[i] < 0 else analysis.visible_us[i] * 1e-6,
                "final_ratio": float(analysis.ratios[-1, i]),
            }
            for i, name in enumerate(states)
        ],
        "segments": [_segment(s, states) for s in analysis.segments],
    }


def _segment(s: Segment, states: tuple[str, ...]) -> dict[str, Any]:
    return {
        "start_s": s.start_us * 1e-6,
        "end_s": s.end_us * 1e-6,
        "manoeuvre": s.label,
        "measurements": s.measurements,
        "rank": s.rank,
        "condition": s.condition,
        "singular_values": s.values.tolist(),
        "weakest": dict(zip(states, s.weakest.tolist(), strict=True)),
        "ratios": dict(zip(states, s.ratios.tolist(), strict=True)),
    }
