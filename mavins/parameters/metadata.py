"""The table of parameters in the JSON that ground stations read: MAVLink's component metadata of type parameter.

Source: the MAVLink developer guide, component metadata protocol.
"""

from __future__ import annotations

import json
import math
from typing import Any

from mavins.config import Config
from mavins.parameters.table import AUTO, TABLE, Parameter, get


def metadata(config: Config) -> bytes:
    """The file's content; the defaults are those of `config`."""
    described = [_described(parameter, config) for parameter in TABLE.values()]
    content = {"version": 1, "parameters": described}
    return json.dumps(content, ensure_ascii=False, separators=(",", ":")).encode()


def _described(parameter: Parameter, config: Config) -> dict[str, Any]:
    made: dict[str, Any] = {
        "name": parameter.name,
        "type": "Float",
        "group": parameter.path.partition(".")[0],
        "shortDesc": parameter.path,
        "longDesc": f"{parameter.text} Allowed: {parameter.allowed}.",
        "default": get(config, parameter.name),
    }
    if parameter.unit:
        made["units"] = parameter.unit
    # AUTO lies outside the range, and a ground station holds people to a range
    low = min(AUTO, parameter.low) if parameter.automatic else parameter.low
    made |= {k: v for k, v in (("min", low), ("max", parameter.high)) if math.isfinite(v)}
    values = [{"value": k, "description": word} for k, word in enumerate(_words(parameter))]
    if values:
        auto = [{"value": AUTO, "description": "auto"}] if parameter.automatic else []
        made["values"] = [*auto, *values]
        made["decimalPlaces"] = 0
    if not parameter.live:
        made["rebootRequired"] = True
    return made


def _words(parameter: Parameter) -> tuple[str, ...]:
    return ("false", "true") if parameter.kind == "switch" else parameter.choices
