"""Reports of real and simulated flights in a real browser: no error, every figure drawn, no false alarm."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mavins.cli.main import main
from mavins.config import Config, to_yaml
from mavins.estimator.estimator import Estimator, Outputs
from mavins.evaluation.evidence import FILE, write_evidence
from mavins.evaluation.findings import findings
from mavins.evaluation.result_folder import read_result
from mavins.evaluation.witness import Witness
from mavins.examples.scenarios import flight, matched
from mavins.outcome import outcome_of
from mavins.results import ResultWriter, write_json, write_text
from sitl.gnss import MarkovSettings
from sitl.imu import TriadSettings
from sitl.scenario import Scenario, load

pytestmark = [pytest.mark.slow, pytest.mark.jit]
pytest.importorskip("plotly")

SECONDS = 100.0


@pytest.fixture
def chromium() -> str:
    names = ("chromium", "chromium-browser", "google-chrome")
    program = next((found for name in names if (found := shutil.which(name))), None)
    if program is None:
        pytest.skip("the browser Chromium is not installed: apt-get install chromium")
    return program


def shown(chromium: str, page: Path, scratch: Path) -> str:
    """The page as the browser has it once its scripts are done; fails where the console has an error."""
    done = subprocess.run(
        [
            chromium,
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            f"--user-data-dir={scratch}",
            "--window-size=1280,2000",
            "--virtual-time-budget=120000",
            "--enable-logging=stderr",
            "--dump-dom",
            page.resolve().as_uri(),
        ],
        capture_output=True,
        text=True,
        timeout=240,
    )
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    assert console == []
    return done.stdout


def judge(dom: str) -> None:
    """Every figure has been drawn, and each of its panels has something in it."""
    (root,) = re.findall(r"<html[^>]*>", dom)
    assert 'data-errors="0"' in root
    assert 'data-done="yes"' in root
    plots = re.split(r'<div class="plot[^"]*" id="plot-', dom)[1:]
    assert f'data-drawn="{len(plots)}"' in root
    assert len(plots) >= 12
    for plot in plots:
        name = plot.partition('"')[0]
        assert re.search(r'<path class="(js-line|point)"[^>]* d="M', plot), f"{name} is empty"


@pytest.mark.parametrize(
    "log",
    [
        "recordings/ap_copter_square_circle.tlog.xz",
        "recordings/px4_quad_mission.tlog.xz",
        "data/flights/quad_apm_122a",
    ],
)
@pytest.mark.timeout(600)
def test_a_recorded_flight(
    log: str, chromium: str, shared: Callable[[str], Path], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    assert main(["-q", "replay", str(shared(log)), "--out", str(out), "--rate", "25"]) == 0
    page = out / "report.html"
    assert page.stat().st_size < 15e6
    judge(shown(chromium, page, tmp_path / "profile"))


def white(scenario: Scenario) -> Scenario:
    """The scenario with white noises and biases only."""
    import dataclasses

    def linear(triad: TriadSettings) -> TriadSettings:
        return dataclasses.replace(triad, scale_factor=0.0, quantum=0.0, full_scale=None)

    imu = dataclasses.replace(
        scenario.imu, gyro=linear(scenario.imu.gyro), accel=linear(scenario.imu.accel)
    )
    gnss = dataclasses.replace(
        scenario.gnss, markov_position=MarkovSettings(), markov_velocity=MarkovSettings()
    )
    return dataclasses.replace(scenario, imu=imu, gnss=gnss)


def flown(scenario: Scenario, config: Config, out: Path, seed: int = 3) -> None:
    """A simulated flight into a result folder."""
    tape, truth = flight(config, scenario, seed, SECONDS)
    folder = out / config.filter
    with ResultWriter(folder, config.states.layout()) as writer:
        estimator = Estimator(
            config, config.filter, Outputs(20_000, writer.write_rows, writer.write_decision)
        )
        witness = Witness(estimator)
        for name, what in tape.feeds:
            getattr(witness, name)(what)
        estimator.finish()
    write_text(folder / "config.yaml", to_yaml(config))
    write_evidence(folder / FILE, witness.evidence(truth), np.empty((0, 6)))
    write_json(out / "summary.json", {"filter": config.filter, **outcome_of(estimator)})


@pytest.mark.parametrize("name", ["quad_mission", "figure8"])
def test_no_false_alarm_on_a_clean_flight(name: str, tmp_path: Path) -> None:
    scenario = white(load(name))
    flown(scenario, matched(Config(), scenario), tmp_path)
    told = findings(read_result(tmp_path))
    assert [f for f in told if f.level != "fine"] == []
    assert len(told) >= 8


def test_what_was_set_wrong_is_found(tmp_path: Path) -> None:
    import dataclasses

    scenario = white(load("quad_mission"))
    config = matched(Config(), scenario)
    quiet = dataclasses.replace(config.imu, gyro_noise=config.imu.gyro_noise / 4.0)
    flown(scenario, dataclasses.replace(config, imu=quiet), tmp_path)
    told = " ".join(f.text for f in findings(read_result(tmp_path)) if f.level == "wrong")
    assert "gyro noise is 4" in told or "gyro noise is 3.9" in told or "gyro noise is 4.1" in told


def test_a_delay_that_was_not_set_is_found(shared: Callable[[str], Path], tmp_path: Path) -> None:
    """The recording's fixes are 0.18 s old."""
    log = shared("recordings/ap_copter_square_circle.tlog.xz")
    yaml = tmp_path / "late.yaml"
    yaml.write_text("gnss: {delay: 0.0}\nstates: {gnss_delay: fixed}\n")
    out = tmp_path / "out"
    options = ["--config", str(yaml), "--out", str(out), "--no-report"]
    assert main(["-q", "replay", str(log), *options]) == 0
    assert not (out / "report.html").exists()
    (found,) = (f for f in findings(read_result(out)) if "lags the IMU" in f.text)
    told = re.search(r"by (\d+) ms", found.text)
    assert told is not None
    assert float(told[1]) == pytest.approx(182, abs=45)
    assert found.level == "wrong"
