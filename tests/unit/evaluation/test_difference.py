"""How far one result is from another, and `mavins diff` that says so."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mavins.cli.diff import lines_of
from mavins.cli.main import main
from mavins.config import Config, to_yaml
from mavins.errors import LogFormatError
from mavins.estimates import Estimates, Innovations, Result
from mavins.evaluation.difference import difference
from mavins.nav.earth import TangentFrame
from mavins.nav.layout import Layout
from mavins.results import ESTIMATES, INNOVATIONS, write_json, write_text
from mavins.types import Origin

N = 100
SIGMAS = [f"sd_{bias}_{axis}" for bias in ("b_g", "b_a") for axis in "xyz"]
ORIGIN = {"lat_deg": 47.4, "lon_deg": 8.5, "alt_m": 500.0}
FRAME = TangentFrame.at(Origin(math.radians(47.4), math.radians(8.5), 500.0))


def estimates(**columns: Any) -> Estimates:
    """Zeros with sigmas of 0.1, at 10 Hz from 1 s on; `columns` are put in their place."""
    names = [*ESTIMATES.split(",")[1:], *SIGMAS]
    table = np.tile([0.1 if name.startswith("sd_") else 0.0 for name in names], (N, 1))
    for name, value in columns.items():
        table[:, names.index(name)] = value
    return Estimates(1_000_000 + 100_000 * np.arange(N), table, Layout.of())


def innovations(accepted: int, rejected: int) -> dict[str, Innovations]:
    n = accepted + rejected
    fused = np.arange(n) < accepted
    words, numbers = np.full(n, ""), np.zeros(n)
    t_us = np.arange(n)
    found = Innovations(
        t_us, t_us, words, fused, words, numbers, numbers[:, None], numbers[:, None]
    )
    return {"heading": found}


def result(found: Estimates | None = None, config: Config | None = None, **summary: Any) -> Result:
    found = found or estimates()
    return Result(
        found.t_us,
        found.table,
        found.layout,
        config or Config(),
        innovations(7, 3),
        evidence=None,
        errors=None,
        smoothed=None,
        summary={"filter": "eskf", "origin": ORIGIN} | summary,
    )


def test_nothing_moved() -> None:
    found = difference(result(), result())
    assert (found.common, found.only_a, found.only_b) == (N, 0, 0)
    assert found.sigmas == 0.0
    assert found.is_within(0.0)
    assert not found.settings
    assert not found.figures


def test_by_how_much_and_where() -> None:
    east = np.zeros(N)
    east[40:50] = -0.3
    found = difference(result(), result(estimates(p_e=east, b_a_z=0.02)))
    moved = {m.component: m for m in found.moved}
    assert moved["p_e"].largest == pytest.approx(0.3)
    assert moved["p_e"].rms == pytest.approx(0.3 * math.sqrt(0.1))
    assert moved["p_e"].at_s == pytest.approx(5.0)
    assert moved["p_e"].largest_sigmas == pytest.approx(3.0)
    assert moved["p_e"].rms_sigmas == pytest.approx(3.0 * math.sqrt(0.1))
    assert moved["b_a_z"].largest_sigmas == pytest.approx(0.2)
    assert moved["p_n"].largest == 0.0
    assert found.sigmas == pytest.approx(3.0)
    assert found.is_within(3.1)
    assert not found.is_within(2.9)


def test_an_angle_takes_the_short_way() -> None:
    found = difference(
        result(estimates(yaw=math.pi - 0.01)), result(estimates(yaw=-math.pi + 0.01))
    )
    yaw = next(m for m in found.moved if m.component == "yaw")
    assert yaw.largest == pytest.approx(math.degrees(0.02))
    assert yaw.largest_sigmas == pytest.approx(0.2)


def test_other_sigmas_are_a_difference() -> None:
    found = difference(result(), result(estimates(sd_v_d=0.15)))
    assert next(m for m in found.moved if m.component == "v_d").widened == pytest.approx(0.5)
    assert not found.is_within(0.4)
    assert found.is_within(0.6)


def test_without_a_sigma_any_difference_counts() -> None:
    """A state that is held, or a file of an older version."""
    a, b = estimates(sd_b_g_x=0.0), estimates(sd_b_g_x=0.0, b_g_x=1e-3)
    assert difference(result(a), result(a)).is_within(0.0)
    assert not difference(result(a), result(b)).is_within(1e6)


def test_missing_instants_are_a_difference() -> None:
    whole = estimates()
    part = Estimates(whole.t_us[:90], whole.table[:90], whole.layout)
    found = difference(result(whole), result(part))
    assert (found.common, found.only_a, found.only_b) == (90, 10, 0)
    assert not found.is_within(1e6)


def test_nothing_in_common_is_an_error() -> None:
    later = dataclasses.replace(estimates(), t_us=estimates().t_us + 7)
    with pytest.raises(LogFormatError, match="no instant in common"):
        difference(result(), result(later))


def test_positions_are_compared_in_one_frame() -> None:
    """The same places, told from another origin."""
    lat, lon, alt = FRAME.to_lla(np.array([100.0, 50.0, -10.0]))
    place = {"lat_deg": lat, "lon_deg": lon, "alt_m": alt}  # a table is in rad
    a = estimates(p_n=100.0, p_e=50.0, p_d=-10.0, **place)
    b = estimates(**place)
    origin = {"lat_deg": math.degrees(lat), "lon_deg": math.degrees(lon), "alt_m": alt}
    found = difference(result(a), result(b, origin=origin))
    assert max(m.largest for m in found.moved if m.quantity == "position") < 1e-6


def test_settings_and_figures() -> None:
    config = Config()
    other = dataclasses.replace(config, gnss=dataclasses.replace(config.gnss, gate=7.0))
    judged = {"truth": {"rms": {"pos_m": [1.0, 2.0, 3.0]}}, "cpu_s": 1.0}
    worse = {"truth": {"rms": {"pos_m": [1.0, 2.0, 4.0]}}, "cpu_s": 9.0}
    found = difference(result(**judged), result(config=other, **worse))
    assert found.settings == {"gnss.gate": (config.gnss.gate, 7.0)}
    assert found.figures == {"truth.pos_m": ([1.0, 2.0, 3.0], [1.0, 2.0, 4.0])}
    text = "\n".join(lines_of(found))
    assert "gnss.gate: 5   7" in text
    assert "truth.pos_m: 1/2/3   1/2/4" in text


def test_rejected_measurements_are_counted() -> None:
    b = dataclasses.replace(result(), innovations=innovations(5, 5))
    found = difference(result(), b)
    assert found.decisions == {"heading": ((7, 3), (5, 5))}
    assert "heading: fused 7 and 5, rejected 3 and 5   <- differs" in "\n".join(lines_of(found))


def folder(path: Path, p_n: float = 0.0, first: int = 0) -> Path:
    """A result folder of three rows."""
    header = ESTIMATES.split(",")
    rows = []
    for k in range(first, first + 3):
        row = dict.fromkeys(header, "0.1") | {"t_us": str(1000 * k), "p_n": str(p_n)}
        rows.append(",".join(row[name] for name in header))
    write_text(path / "eskf" / "estimates.csv", "\n".join([ESTIMATES, *rows]) + "\n")
    write_text(path / "eskf" / "innovations.csv", INNOVATIONS + "\n")
    write_text(path / "eskf" / "config.yaml", to_yaml(Config()))
    write_json(path / "summary.json", {"filter": "eskf"})
    return path


@pytest.mark.parametrize(
    ("p_n", "options", "status"),
    [
        (0.0, (), 0),
        (0.05, (), 0),
        (0.0, ("--tolerance", "0"), 0),
        (0.05, ("--tolerance", "0"), 1),
        (0.05, ("--tolerance", "0.4"), 1),
        (0.05, ("--tolerance", "0.6"), 0),
        (0.0, ("--filters", "eskf,eskf", "--tolerance", "0"), 0),
    ],
)
def test_exit_status(
    p_n: float,
    options: tuple[str, ...],
    status: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    a, b = folder(tmp_path / "a"), folder(tmp_path / "b", p_n)
    assert main(["diff", str(a), str(b), *options]) == status
    said = capsys.readouterr().out
    assert "instants in both: 3, in A only: 0, in B only: 0" in said
    assert ("differ by more than" in said) == (status == 1)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--tolerance", "-1"), "makes no sense"),
        (("--filters", "eskf"), "give two"),
        (("--filters", "eskf,iekf"), "no iekf/estimates.csv"),
    ],
)
def test_what_cannot_be_compared(
    options: tuple[str, ...], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    a, b = folder(tmp_path / "a"), folder(tmp_path / "b")
    assert main(["diff", str(a), str(b), *options]) == 2
    assert said in capsys.readouterr().err


def test_what_is_no_result(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a = folder(tmp_path / "a")
    for other in (tmp_path, tmp_path / "nowhere", folder(tmp_path / "later", first=100)):
        assert main(["diff", str(a), str(other)]) == 2
        err = capsys.readouterr().err
        assert err.startswith("mavins: ")
        assert err.count("\n") == 1
