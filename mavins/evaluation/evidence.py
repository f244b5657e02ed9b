"""What a report needs of a log beside the estimates: kept in the result folder, so that the log itself is not."""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

import numpy as np

from mavins.errors import LogFormatError, OutputError
from mavins.evaluation.spectrum import Spectrum
from mavins.logs.truth import Truth
from mavins.types import FloatArray, IntArray

FILE: Final = "evidence.npz"
_SPACING_US: Final = 9_000
"""A truth is thinned to this: about 100 Hz, far below what interpolation needs."""
_TRUTHS: Final = ("truth", "reference")
_PARTS: Final = ("t_us", "lla", "v_l", "q_lb")


@dataclass(frozen=True, slots=True)
class Gnss:
    """GNSS fixes as they came: `lla` (N, 3) in rad and m, `v_l` (N, 3) m/s with nan for what was not measured.

    `sigmas` (N, 3) are the receiver's claims: horizontal and vertical position in m, velocity in m/s; nan: none.
    """

    t_us: IntArray
    lla: FloatArray
    v_l: FloatArray
    fix_type: IntArray
    satellites: FloatArray
    sigmas: FloatArray


@dataclass(frozen=True, slots=True)
class ImuSeconds:
    """The IMU second by second: its start, how many samples, the longest interval, the spread, samples at the limit.

    `spread` (S, 6) is the standard deviation of gyro (rad/s) and accelerometer (m/s^2) within the second. `intervals`
    (M,) counts the intervals of the whole log in steps of 0.1 ms, the last one with all that are longer.
    """

    t_us: IntArray
    count: IntArray
    longest_us: IntArray
    spread: FloatArray
    clipped: IntArray
    intervals: IntArray


@dataclass(frozen=True, slots=True)
class Evidence:
    """What an estimator was fed, as far as a report shows it, and what to judge it by.

    `yaw` are headings in rad; of baro and mag only the stamps.
    """

    gnss: Gnss
    imu: ImuSeconds
    spectrum: Spectrum | None
    heading_us: IntArray
    yaw: FloatArray
    mag_us: IntArray
    baro_us: IntArray
    truth: Truth | None = None
    reference: Truth | None = None


def thinned(truth: Truth | None) -> Truth | None:
    """A truth with samples of at least 9 ms between them."""
    if truth is None or not len(truth):
        return None
    slot = truth.t_us // _SPACING_US
    kept = np.flatnonzero(np.diff(slot, prepend=slot[0] - 1) > 0)
    return Truth(truth.t_us[kept], truth.lla[kept], truth.v_l[kept], truth.q_lb[kept], truth.source)


def write_evidence(path: Path, evidence: Evidence, bias_sigmas: FloatArray) -> None:
    """Write the file, aside and then renamed into place, with thinned truths. Raises OutputError.

    `bias_sigmas` (N, 6) are 1-sigma of b_g in rad/s and b_a in m/s^2 at the N estimates, which estimates.csv lacks.
    """
    arrays: dict[str, Any] = {
        "heading_us": evidence.heading_us,
        "yaw": evidence.yaw,
        "mag_us": evidence.mag_us,
        "baro_us": evidence.baro_us,
        "bias_sigmas": bias_sigmas.astype(np.float32),
    }
    arrays |= _flat("gnss", evidence.gnss) | _flat("imu", evidence.imu)
    if evidence.spectrum is not None:
        arrays |= _flat("spectrum", evidence.spectrum)
    for name in _TRUTHS:
        truth = thinned(getattr(evidence, name))
        if truth is not None:
            arrays |= {f"{name}.{part}": getattr(truth, part) for part in _PARTS}
            arrays[f"{name}.source"] = np.array(truth.source)
    aside = path.with_name(path.name + ".part")
    try:
        with aside.open("wb") as file:
            np.savez(file, **arrays)
        aside.replace(path)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror}") from error


def read_evidence(path: Path) -> tuple[Evidence, FloatArray] | None:
    """Read the file, evidence and sigmas; None where there is none. Raises LogFormatError for a damaged one."""
    if not path.exists():
        return None
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
            arrays = {name: file[name] for name in file.files}
        spectrum = None
        if "spectrum.psd" in arrays:
            spectrum = Spectrum(
                arrays["spectrum.frequency"],
                arrays["spectrum.psd"],
                int(arrays["spectrum.segments"]),
                float(arrays["spectrum.rate"]),
            )
        evidence = Evidence(
            Gnss(*_parts("gnss", Gnss, arrays)),
            ImuSeconds(*_parts("imu", ImuSeconds, arrays)),
            spectrum,
            arrays["heading_us"],
            arrays["yaw"],
            arrays["mag_us"],
            arrays["baro_us"],
            _truth("truth", arrays),
            _truth("reference", arrays),
        )
        return evidence, arrays["bias_sigmas"].astype(np.float64)
    except (KeyError, ValueError, EOFError, OSError, zipfile.BadZipFile) as error:
        raise LogFormatError(f"{path} is damaged: {error}") from error


def _truth(name: str, arrays: dict[str, Any]) -> Truth | None:
    if f"{name}.t_us" not in arrays:
        return None
    t_us, lla, v_l, q_lb = (arrays[f"{name}.{part}"] for part in _PARTS)
    return Truth(t_us, lla, v_l, q_lb, str(arrays[f"{name}.source"]))


def _flat(name: str, table: Any) -> dict[str, Any]:
    return {f"{name}.{f.name}": np.asarray(getattr(table, f.name)) for f in fields(table)}


def _parts(name: str, kind: Any, arrays: dict[str, Any]) -> list[Any]:
    return [arrays[f"{name}.{f.name}"] for f in fields(kind)]
