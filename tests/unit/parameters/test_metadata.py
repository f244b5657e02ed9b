"""The parameters' metadata, held against MAVLink's schema of it."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from mavins.config import Config, load
from mavins.parameters import AUTO, TABLE, get, metadata

CONFIG = load(None, {"gnss.gate": 4.0})
CONTENT = json.loads(metadata(CONFIG))
TYPES: dict[str, tuple[type, ...]] = {
    "name": (str,),
    "type": (str,),
    "shortDesc": (str,),
    "longDesc": (str,),
    "units": (str,),
    "default": (int, float),
    "decimalPlaces": (int,),
    "min": (int, float),
    "max": (int, float),
    "rebootRequired": (bool,),
    "group": (str,),
    "values": (list,),
}
"""The keys of the schema that are used here."""


def test_it_names_all_parameters_in_order() -> None:
    assert set(CONTENT) == {"version", "parameters"}
    assert CONTENT["version"] == 1
    assert [p["name"] for p in CONTENT["parameters"]] == list(TABLE)


@pytest.mark.parametrize("described", CONTENT["parameters"], ids=lambda d: d["name"])
def test_a_description_keeps_to_the_schema(described: dict[str, Any]) -> None:
    assert set(described) <= set(TYPES)
    for key, value in described.items():
        assert isinstance(value, TYPES[key]), key
    assert re.fullmatch(r"[.\-a-zA-Z0-9_{}]{1,16}", described["name"])
    assert described["type"] == "Float"
    assert described["default"] == get(CONFIG, described["name"])
    assert described.get("min", -1e40) <= described["default"] <= described.get("max", 1e40)
    assert described.get("rebootRequired", False) is not TABLE[described["name"]].live
    for value in described.get("values", []):
        assert set(value) == {"value", "description"}


def test_choices_are_spelt_out() -> None:
    by_name = {p["name"]: p for p in json.loads(metadata(Config()))["parameters"]}
    assert by_name["SRC_HEADING"]["values"] == [
        {"value": AUTO, "description": "auto"},
        {"value": 0, "description": "attitude"},
        {"value": 1, "description": "gps_yaw"},
        {"value": 2, "description": "off"},
    ]
    assert [v["description"] for v in by_name["ZUPT_ENABLE"]["values"]] == ["false", "true"]
    assert "values" not in by_name["GNSS_DELAY"]
