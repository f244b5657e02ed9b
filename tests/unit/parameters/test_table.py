"""The table of parameters: every setting is in it, and no value changes on its way over the wire."""

from __future__ import annotations

import dataclasses
import math
import struct
from operator import attrgetter
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavins.config import Config, load
from mavins.errors import ParameterError
from mavins.estimator.reconfigure import FIXED, applicable
from mavins.parameters import AUTO, TABLE, Parameter, get, put, wire
from mavins.parameters.names import EXCLUDED, NAMES, NEEDS_RESTART, within
from mavins.parameters.table import leaves

PARAMETERS = list(TABLE.values())
PATHS = [path for path, _ in leaves(Config)]
OTHER = load(
    None,
    {
        "imu.gyro_noise": 0.0123456789,
        "gnss.delay": 0.18,
        "gnss.lever_arm": [0.1, -0.2, 1 / 3],
        "magnetometer.enabled": False,
        "magnetometer.rotation": [0.1, 0.2, 0.3],
        "magnetometer.hard_iron": [-12.5, 0.3, 7.0],
        "estimator.max_position_sigma": 1e300,
        "sources.heading": "off",
        "mavlink.sysid": 7,
        "filter": "iekf",
    },
)
"""A configuration with numbers that no 32-bit float is equal to."""


def some_other(parameter: Parameter, value: float) -> float:
    """A value that the parameter takes and does not have."""
    if parameter.kind in ("switch", "choice"):
        return 1.0 if value == 0.0 else 0.0
    if parameter.kind == "integer":
        return parameter.low + (value == parameter.low)
    low = parameter.low if math.isfinite(parameter.low) else -1.0
    high = parameter.high if math.isfinite(parameter.high) else low + 1.0
    other = wire(low + 0.3 * (high - low))
    return other if other != value else wire(low + 0.4 * (high - low))


def test_every_setting_is_a_parameter_or_excluded_with_a_reason() -> None:
    assert [p for p in PATHS if p not in NAMES and not within(p, EXCLUDED)] == []
    assert [p for p in NAMES if p not in PATHS] == []
    assert [p for p in NAMES if within(p, EXCLUDED)] == []
    assert all(EXCLUDED.values())


@pytest.mark.parametrize("place", [*NEEDS_RESTART, *EXCLUDED])
def test_a_place_that_a_rule_names_exists(place: str) -> None:
    assert any(within(path, {place: ""}) for path in PATHS)


def test_names_are_valid_and_each_is_there_once() -> None:
    given_names = [
        n for names in NAMES.values() for n in ([names] if isinstance(names, str) else names)
    ]
    assert list(TABLE) == given_names
    for name in TABLE:
        assert 1 <= len(name) <= 16
        assert name.replace("_", "").isalnum()
        assert name == name.upper()
        assert name.isascii()


@pytest.mark.parametrize("parameter", PARAMETERS, ids=lambda p: p.name)
def test_it_says_what_it_is(parameter: Parameter) -> None:
    assert parameter.text
    assert parameter.allowed
    assert parameter.low < parameter.high
    if parameter.automatic and math.isfinite(parameter.low):
        assert parameter.low > AUTO


@pytest.mark.parametrize("config", [Config(), OTHER], ids=["defaults", "others"])
@pytest.mark.parametrize("name", TABLE)
def test_a_value_that_comes_back_changes_nothing(name: str, config: Config) -> None:
    assert put(config, name, wire(get(config, name))) is config


@pytest.mark.parametrize("config", [Config(), OTHER], ids=["defaults", "others"])
@pytest.mark.parametrize("parameter", PARAMETERS, ids=lambda p: p.name)
def test_another_value_is_taken_and_nothing_else_changes(
    parameter: Parameter, config: Config
) -> None:
    value = some_other(parameter, get(config, parameter.name))
    changed = put(config, parameter.name, value)
    assert wire(get(changed, parameter.name)) == value
    assert changed != config
    before = attrgetter(parameter.path)(config)
    restored = _with(changed, parameter.path.split("."), before)
    assert restored == config
    # a file that is written and read again gives the same
    assert load(None, dataclasses.asdict(changed)) == changed


def _with(node: Any, path: list[str], value: Any) -> Any:
    name, *rest = path
    if rest:
        value = _with(getattr(node, name), rest, value)
    return dataclasses.replace(node, **{name: value})


@pytest.mark.parametrize("parameter", PARAMETERS, ids=lambda p: p.name)
@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_what_is_no_number_is_refused(parameter: Parameter, wrong: float) -> None:
    with pytest.raises(ParameterError, match=parameter.name) as error:
        put(Config(), parameter.name, wrong)
    assert parameter.allowed in str(error.value)


@pytest.mark.parametrize("parameter", PARAMETERS, ids=lambda p: p.name)
def test_what_lies_beyond_the_range_is_refused_and_the_range_named(parameter: Parameter) -> None:
    for end, step in ((parameter.low, -1.0), (parameter.high, 1.0)):
        if math.isfinite(end):
            with pytest.raises(ParameterError) as error:
                put(Config(), parameter.name, end + step)
            assert str(error.value).startswith(f"{parameter.name}: {end + step:g} is not allowed")
            assert parameter.allowed in str(error.value)


@pytest.mark.parametrize(
    "parameter", [p for p in PARAMETERS if p.kind != "number"], ids=lambda p: p.name
)
def test_what_is_not_whole_is_refused(parameter: Parameter) -> None:
    with pytest.raises(ParameterError, match="is not allowed"):
        put(Config(), parameter.name, parameter.low + 0.5)


@pytest.mark.parametrize("parameter", PARAMETERS, ids=lambda p: p.name)
def test_only_those_with_an_auto_take_it(parameter: Parameter) -> None:
    start = OTHER if parameter.automatic else Config()
    if parameter.automatic:
        changed = put(start, parameter.name, AUTO)
        assert attrgetter(parameter.path)(changed) == "auto"
        assert get(changed, parameter.name) == AUTO
    elif math.isfinite(parameter.low):
        with pytest.raises(ParameterError):
            put(start, parameter.name, AUTO)


def test_a_component_of_an_automatic_vector_makes_the_others_zero() -> None:
    config = put(Config(), "MAG_IRON_Y", 3.5)
    assert config.magnetometer.hard_iron == (0.0, 3.5, 0.0)
    assert put(config, "MAG_IRON_X", -2.0).magnetometer.hard_iron == (-2.0, 3.5, 0.0)


@pytest.mark.parametrize("name", ["", "NO_SUCH", "GNSS_DELAY_", "gnss_delay", "\ufffd" * 16])
def test_an_unknown_name_is_refused(name: str) -> None:
    for call in (lambda: get(Config(), name), lambda: put(Config(), name, 1.0)):
        with pytest.raises(ParameterError, match="no parameter"):
            call()


@given(st.floats(width=32, min_value=2.0**-10, max_value=8.0))
def test_a_32_bit_number_comes_back_as_it_was_set(value: float) -> None:
    config = put(Config(), "IMU_GYRO_NOISE", value)
    assert struct.pack("<f", get(config, "IMU_GYRO_NOISE")) == struct.pack("<f", value)


@pytest.mark.parametrize("meant", [0.02, 0.1, 1e-3, 0.123456, 9.87654])
def test_the_number_that_a_person_meant_is_kept(meant: float) -> None:
    assert put(Config(), "IMU_GYRO_NOISE", wire(meant)).imu.gyro_noise == meant


@pytest.mark.parametrize("parameter", PARAMETERS, ids=lambda p: p.name)
def test_what_needs_a_restart_is_what_an_estimator_refuses_to_change(parameter: Parameter) -> None:
    changed = put(Config(), parameter.name, some_other(parameter, get(Config(), parameter.name)))
    assert (applicable(Config(), changed) == changed) == (not within(parameter.path, FIXED))
    assert parameter.live == (not within(parameter.path, NEEDS_RESTART))
