"""Parameters that differ between runs: what is drawn, where it goes, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mavins.campaign.vary import Spread, drawn, read_spreads, varied
from mavins.config import Config
from mavins.errors import ConfigError
from sitl.scenario import load

NOISE = Spread("scenario.imu.gyro.noise", "loguniform", (1e-4, 1e-2))


def test_a_draw_depends_on_seed_run_and_name_alone() -> None:
    other = Spread("config.gnss.delay", "uniform", (0.0, 1.0))
    alone, both = drawn([NOISE], 3, 7), drawn([other, NOISE], 3, 7)
    assert alone[NOISE.path] == both[NOISE.path]
    assert alone == drawn([NOISE], 3, 7)
    assert alone != drawn([NOISE], 3, 8)
    assert alone != drawn([NOISE], 4, 7)
    renamed = Spread("scenario.imu.accel.noise", "loguniform", (1e-4, 1e-2))
    assert alone[NOISE.path] != renamed.draw(3, 7)


@pytest.mark.parametrize(
    ("kind", "values", "middle"),
    [
        ("uniform", (2.0, 4.0), 3.0),
        ("normal", (2.0, 0.5), 2.0),
        ("loguniform", (1e-4, 1e-2), 1e-3),
    ],
)
def test_distributions(kind: str, values: tuple[float, float], middle: float) -> None:
    found = np.array([Spread("config.x", kind, values).draw(0, run) for run in range(4000)])
    assert np.median(found) == pytest.approx(middle, rel=0.15 if kind == "loguniform" else 0.02)
    if kind == "normal":
        assert found.std() == pytest.approx(values[1], rel=0.05)
    else:
        assert values[0] <= found.min() < found.max() <= values[1]


def test_choice_takes_all_of_its_values() -> None:
    spread = Spread("config.x", "choice", ("a", 2, True))
    assert {spread.draw(0, run) for run in range(50)} == {"a", 2, True}


def test_values_go_where_their_path_says() -> None:
    scenario, config = load("quad_mission"), Config()
    values = {
        "scenario.imu.gyro.noise": 5e-3,
        "scenario.gnss.lever_arm.1": 0.25,
        "scenario.motion.segments.0.height": 15,
        "config.gnss.delay": 0.1,
    }
    flown, settings = varied(scenario, config, values)
    assert flown.imu.gyro.noise == 5e-3
    assert flown.gnss.lever_arm == (0.0, 0.25, 0.0)
    assert flown.motion.segments[0].height == 15.0
    assert flown.imu.accel == scenario.imu.accel
    assert settings.gnss.delay == 0.1
    assert settings.imu == config.imu
    assert varied(scenario, config, {}) == (scenario, config)
    track = load("square_spiral")
    assert varied(track, config, {"scenario.gnss.rate": 10})[0].motion == track.motion


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"scenario.imu.gyro.nose": 1.0}, "there is no scenario.imu.gyro.nose"),
        ({"scenario.gnss.lever_arm.3": 1.0}, "there is no scenario.gnss.lever_arm.3"),
        ({"config": 1.0}, "there is no config|expected"),
        ({"scenario.imu.gyro.noise": -1.0}, "noise = -1.0.*noise"),
        ({"config.gnss.delay": "soon"}, "delay = soon.*gnss.delay"),
    ],
)
def test_what_cannot_be_flown(values: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        varied(load("quad_mission"), Config(), values)


def test_a_file(tmp_path: Path) -> None:
    path = tmp_path / "vary.yaml"
    path.write_text(
        "scenario.imu.gyro.noise: {loguniform: [1e-4, 1.0e-2]}\n"
        "config.filters.x: {choice: [a, 1]}\n"
    )
    assert read_spreads(path) == (NOISE, Spread("config.filters.x", "choice", ("a", 1)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected lines like"),
        ("[1]", "expected lines like"),
        ("a: {b", "not valid YAML"),
        ("imu.noise: {uniform: [0, 1]}", "begins with neither"),
        ("config.a: 1", "expected one of uniform"),
        ("config.a: {uniform: [0, 1], normal: [0, 1]}", "expected one of uniform"),
        ("config.a: {gamma: [0, 1]}", "unknown distribution 'gamma'"),
        ("config.a: {uniform: 1}", "takes a list"),
        ("config.a: {choice: []}", "takes a list"),
        ("config.a: {uniform: [0]}", "takes two numbers"),
        ("config.a: {uniform: [0, x]}", "takes two numbers"),
        ("config.a: {uniform: [0, .inf]}", "finite"),
        ("config.a: {uniform: [1, 0]}", r"takes \[low, high\]"),
        ("config.a: {normal: [1, -1]}", "sigma of 0 or above"),
        ("config.a: {loguniform: [0, 1]}", "above 0"),
    ],
)
def test_files_that_say_nothing_of_use(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "vary.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        read_spreads(path)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        read_spreads(tmp_path / "none.yaml")
