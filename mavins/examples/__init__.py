"""The examples: each reproduces an article's system on data, and judges itself by stated figures.

One file per example with `run(data, out, say)`, one line here each. They are imported when they are asked for.
"""

from __future__ import annotations

from typing import Final

REGISTRY: Final[dict[str, tuple[str, str]]] = {
    "square-spiral": (
        "mavins.examples.square_spiral",
        "the Euler-angle filter matches its original, the manifold filters beat it",
    ),
    "foot-mounted": (
        "mavins.examples.foot_mounted",
        "an IMU on a foot, zero velocity at each step (article 002)",
    ),
    "no-magnetometer": (
        "mavins.examples.no_magnetometer",
        "a heading wrong by 45 deg, found from GNSS in motion (article 003)",
    ),
    "iterated": (
        "mavins.examples.iterated",
        "a start off by 60 deg and 100 m: iterating converges sooner (article 001)",
    ),
    "lever-and-delay": (
        "mavins.examples.lever_and_delay",
        "the antenna's place and the delay of GNSS, found in flight (article 004)",
    ),
    "flights": ("mavins.examples.flights", "three real flights through every filter"),
}
"""Name -> (module, one line for the overview)."""
