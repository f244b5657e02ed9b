"""The configuration: what is refused, how it is said, and that it survives the way to YAML."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest
from annotated_types import Ge, Gt, Interval, Le
from hypothesis import given
from hypothesis import strategies as st

from mavins import config, typed_settings, yaml_text
from mavins.documented import Doc
from mavins.errors import ConfigError


@dataclass(frozen=True, slots=True)
class Gate:
    """When a fix is believed."""

    chi2: Annotated[float, Interval(gt=0, le=1), Doc("Probability of the gate.")] = 0.999
    timeout: Annotated[float, Gt(0), Doc("Reset after so long a rejection.", unit="s")] = 7.0


@dataclass(frozen=True, slots=True)
class Gnss:
    """The GNSS receiver."""

    delay: Annotated[Literal["auto"] | float, Doc("Age of a fix.", unit="s")] = "auto"
    lever_arm: Annotated[tuple[float, float, float], Doc("Antenna in b.", unit="m")] = (
        0.0,
        0.0,
        0.0,
    )
    gate: Gate = Gate()


@dataclass(frozen=True, slots=True)
class Imu:
    gyro_noise: Annotated[float, Gt(0), Doc("Noise density.", unit="rad/s/sqrt(Hz)")] = 1e-05
    rotation: Annotated[tuple[float, ...], Doc("Euler angles.")] = ()
    heading: Literal["auto", "attitude", "off", "on"] = "off"
    sysid: Annotated[int, Ge(1), Le(255)] | None = None
    debug: bool = False
    name: Annotated[str, Doc("A label.")] = "no"


@dataclass(frozen=True, slots=True)
class Tree:
    """A configuration with every kind of setting."""

    gnss: Annotated[Gnss, Doc("Where we are.")] = Gnss()
    imu: Imu = field(default_factory=Imu)

    def __post_init__(self) -> None:
        if self.imu.debug and self.gnss.delay == "auto":
            raise ValueError("imu.debug needs a gnss.delay that is a number")


def build(text: str) -> Tree:
    return typed_settings.build(Tree, yaml_text.parse(text, "flight.yaml"), "flight.yaml")


def refused(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        build(text)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_an_empty_file_and_empty_sections_are_the_defaults() -> None:
    assert build("") == Tree()
    assert build("gnss:\nimu: {}\n") == Tree()


def test_values_reach_their_fields() -> None:
    tree = build(
        "gnss: {delay: -0.1, lever_arm: [1, 2.5, -3e-1], gate: {chi2: 1}}\nimu: {sysid: 7}"
    )
    assert tree.gnss == Gnss(-0.1, (1.0, 2.5, -0.3), Gate(chi2=1.0))
    assert tree.imu.sysid == 7
    assert isinstance(tree.gnss.lever_arm, tuple)
    assert isinstance(tree.gnss.gate.chi2, float)


@pytest.mark.parametrize("word", ["off", "on", "auto", "attitude"])
def test_choices_that_yaml_1_1_takes_for_booleans_need_no_quotes(word: str) -> None:
    assert build(f"imu: {{heading: {word}}}").imu.heading == word


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 1e-3),
        ("010", 10),
        ("+5", 5),
        (".5", 0.5),
        ("no", "no"),
        ("12:30", "12:30"),
        ("2026-01-01", "2026-01-01"),
        ("true", True),
        ("~", None),
        ("1.", 1.0),
        ("'1'", "1"),
        ("0x10", "0x10"),
        ("-.inf", -math.inf),
    ],
)
def test_scalars_follow_yaml_1_2(text: str, value: Any) -> None:
    parsed = yaml_text.parse(text)
    assert parsed == value
    assert type(parsed) is type(value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "gnss: {dely: 1}",
            "flight.yaml: gnss.dely: unknown key (did you mean delay?); "
            "allowed here: delay, lever_arm, gate",
        ),
        ("gps: 1", "flight.yaml: gps: unknown key; allowed here: gnss, imu"),
        ("1: 1", "flight.yaml: 1: unknown key; allowed here: gnss, imu"),
        (
            "gnss: {gate: {xyz: 1}}",
            "flight.yaml: gnss.gate.xyz: unknown key; allowed here: chi2, timeout",
        ),
        (
            "gnss: {delay: abc}",
            "flight.yaml: gnss.delay: 'abc' is not allowed; expected auto or a number in s",
        ),
        (
            "gnss: {delay: true}",
            "flight.yaml: gnss.delay: true is not allowed; expected auto or a number in s",
        ),
        (
            "gnss: {delay: .nan}",
            "flight.yaml: gnss.delay: nan is not finite; expected auto or a number in s",
        ),
        (
            "imu: {gyro_noise: -1}",
            "flight.yaml: imu.gyro_noise: -1 is not allowed; must be > 0",
        ),
        (
            "imu: {gyro_noise: .inf}",
            "flight.yaml: imu.gyro_noise: inf is not finite; "
            "expected a number in rad/s/sqrt(Hz), > 0",
        ),
        (
            "imu: {gyro_noise: '1'}",
            "flight.yaml: imu.gyro_noise: '1' is not allowed; "
            "expected a number in rad/s/sqrt(Hz), > 0",
        ),
        (
            "imu: {gyro_noise: false}",
            "flight.yaml: imu.gyro_noise: false is not allowed; "
            "expected a number in rad/s/sqrt(Hz), > 0",
        ),
        (
            "gnss: {gate: {chi2: 1.5}}",
            "flight.yaml: gnss.gate.chi2: 1.5 is not allowed; must be <= 1",
        ),
        (
            "gnss: {lever_arm: [1, 2]}",
            "flight.yaml: gnss.lever_arm: [1, 2] is not allowed; expected a list of 3 numbers in m",
        ),
        (
            "gnss: {lever_arm: [1, 2, x]}",
            "flight.yaml: gnss.lever_arm: 'x' is not allowed; expected a list of 3 numbers in m",
        ),
        (
            "imu: {heading: north}",
            "flight.yaml: imu.heading: 'north' is not allowed; expected auto, attitude, off or on",
        ),
        ("imu: {debug: 1}", "flight.yaml: imu.debug: 1 is not allowed; expected true or false"),
        ("imu: {sysid: 256}", "flight.yaml: imu.sysid: 256 is not allowed; must be <= 255"),
        (
            "imu: {sysid: 1.5}",
            "flight.yaml: imu.sysid: 1.5 is not allowed; "
            "expected an integer, >= 1 and <= 255 or null",
        ),
        (
            "gnss: 5",
            "flight.yaml: gnss: 5 is not allowed; "
            "expected a section with the keys delay, lever_arm, gate",
        ),
        (
            "just words",
            "flight.yaml: 'just words' is not allowed; expected a section with the keys gnss, imu",
        ),
        ("imu: {debug: true}", "flight.yaml: imu.debug needs a gnss.delay that is a number"),
    ],
)
def test_a_mistake_is_named_with_its_path_and_what_is_allowed(text: str, message: str) -> None:
    assert refused(text) == message


@pytest.mark.parametrize(
    ("text", "start"),
    [
        ("gnss: {delay: [1\nimu: 2", "flight.yaml:2:4: not valid YAML: "),
        ("gnss:\n\tdelay: 1", "flight.yaml:2:1: not valid YAML: "),
        ("gnss: {}\ngnss: {}", "flight.yaml:2:1: not valid YAML: the key 'gnss' is written twice"),
        ("a: &x [1]\nb: *x", "flight.yaml:2:4: not valid YAML: aliases are not used here"),
        ("a: !!python/name:os.system x", "flight.yaml:1:4: not valid YAML: "),
        ("a: \x00", "flight.yaml: not valid YAML: "),
        ("a: 1\n---\nb: 2", "flight.yaml:2:1: not valid YAML: "),
        ("[" * 5000, "flight.yaml: not valid YAML: nested too deeply"),
    ],
)
def test_bad_syntax_names_line_and_column(text: str, start: str) -> None:
    assert refused(text).startswith(start)


def test_an_unreadable_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.yaml: cannot be read: No such file"):
        config.load(tmp_path / "none.yaml")
    with pytest.raises(ConfigError, match="cannot be read: Is a directory"):
        config.load(tmp_path)
    (tmp_path / "latin.yaml").write_bytes(b"a: \xe9\n")
    with pytest.raises(ConfigError, match=r"is not UTF-8 text \(byte 3\)"):
        config.load(tmp_path / "latin.yaml")


finite = st.floats(allow_nan=False, allow_infinity=False)
trees = st.builds(
    Tree,
    gnss=st.builds(
        Gnss,
        delay=finite,
        lever_arm=st.tuples(finite, finite, finite),
        gate=st.builds(Gate, chi2=st.floats(0, 1, exclude_min=True)),
    ),
    imu=st.builds(
        Imu,
        rotation=st.lists(finite, max_size=4).map(tuple),
        heading=st.sampled_from(["auto", "attitude", "off", "on"]),
        sysid=st.none() | st.integers(1, 255),
        debug=st.booleans(),
        name=st.text(st.characters(exclude_categories=["Cs"])),
    ),
)


@given(trees, st.booleans())
def test_a_configuration_comes_back_from_yaml(tree: Tree, commented: bool) -> None:
    assert build(config.to_yaml(tree, commented)) == tree


def test_comments_tell_meaning_unit_default_and_range() -> None:
    lines = config.to_yaml(Tree()).splitlines()
    assert lines[0].startswith("# mavins ")
    at = lines.index("  gyro_noise: 1e-05")
    assert lines[at - 1] == ("  # Noise density. [a number in rad/s/sqrt(Hz), > 0; default 1e-05]")
    assert lines[lines.index("gnss:") - 1] == "# Where we are."
    assert lines[lines.index("  gate:") - 1] == "  # When a fix is believed."
    assert "  heading: off" in lines
    assert max(map(len, lines)) <= 100


def test_plain_yaml_has_no_comments_but_the_version() -> None:
    lines = config.to_yaml(Tree(), commented=False).splitlines()
    assert [line for line in lines if "#" in line] == lines[:1]


def test_overrides_go_over_the_file_key_by_key() -> None:
    base = {"gnss": {"delay": 1, "gate": {"chi2": 0.5}}, "imu": None}
    over = {"gnss.gate.timeout": 3, "gnss": {"delay": 2}, "imu.sysid": 9}
    assert config.merged(base, over) == {
        "gnss": {"delay": 2, "gate": {"chi2": 0.5, "timeout": 3}},
        "imu": {"sysid": 9},
    }


def test_the_shipped_defaults_load_and_come_back(tmp_path: Path) -> None:
    path = tmp_path / "default.yaml"
    path.write_text(config.default_yaml(), encoding="utf-8")
    assert config.load(path) == config.Config() == config.load(None)


def test_an_override_that_is_wrong_is_called_so() -> None:
    with pytest.raises(ConfigError, match=r"^override: nonsense: unknown key"):
        config.load(None, {"nonsense": 1})
