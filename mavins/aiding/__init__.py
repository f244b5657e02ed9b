"""The aidings: one file per measurement, one line here each."""

from typing import Final

from mavins.aiding.base import Measurement, Model

REGISTRY: Final = {
    "gnss_position": "mavins.aiding.gnss_position:model",
    "gnss_velocity": "mavins.aiding.gnss_velocity:model",
    "heading": "mavins.aiding.heading:model",
    "zero_velocity": "mavins.aiding.zero_velocity:model",
    "magnetometer": "mavins.aiding.magnetometer:model",
    "zero_rate": "mavins.aiding.zero_rate:model",
    "baro": "mavins.aiding.baro:model",
    "gravity_tilt": "mavins.aiding.gravity_tilt:model",
    "nonholonomic": "mavins.aiding.nonholonomic:model",
}

__all__ = ["REGISTRY", "Measurement", "Model"]
