"""The kernel cache: an edit of a called kernel is seen, and what is compiled is found again."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import mavins
from mavins.nav import kernels

pytestmark = pytest.mark.jit

PACKAGE = Path(mavins.__file__).parent
ASK = """
import numpy as np
from mavins.nav import earth, kernels
print(repr(float(earth.gravity_n(np.zeros(3), np.array([6378137.0, 0, 0]), np.eye(3))[0])))
print(kernels.CACHE)
print(sum(earth.gravity_n.stats.cache_hits.values()), sum(earth.gravity_n.stats.cache_misses.values()))
"""


def ask(copy: Path, cache: Path) -> tuple[float, Path, list[int]]:
    """(g, cache folder, [cache hits, misses]) of gravity_n, asked of the package copy in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(copy), "MAVINS_CACHE": str(cache)}
    environment["PYTHONDONTWRITEBYTECODE"] = "1"
    got = subprocess.run(
        [sys.executable, "-c", ASK],
        env=environment,
        cwd=copy,
        capture_output=True,
        text=True,
        check=True,
    )
    lines = got.stdout.splitlines()
    return float(lines[0]), Path(lines[1]), [int(n) for n in lines[2].split()]


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A package with what `gravity_n` needs: its own file, and those that it imports."""
    root = tmp_path / "copy"
    for name in ("__init__.py", "types.py", "nav/__init__.py", "nav/kernels.py", "nav/earth.py"):
        (root / "mavins" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(PACKAGE / name, root / "mavins" / name)
    return root


def test_an_edited_callee_is_seen(copy: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    # the callee into a file of its own, which is what numba's cache by itself does not look at
    earth = copy / "mavins" / "nav" / "earth.py"
    text = earth.read_text(encoding="utf-8")
    start = text.index("@kernel\ndef normal_gravity")
    end = text.index("@kernel\n", start + 1)
    called = text[start:end]
    callee = copy / "mavins" / "nav" / "callee.py"
    constants = text[text.index("SEMI_MAJOR: Final") : text.index("@kernel\ndef lla_to_ecef")]
    head = "import math\nfrom typing import Final\nfrom mavins.nav.kernels import kernel\n"
    callee.write_text(head + constants + called, encoding="utf-8")
    moved = text[:start] + "from mavins.nav.callee import normal_gravity\n\n\n" + text[end:]
    earth.write_text(moved, encoding="utf-8")

    first, folder, _ = ask(copy, cache)
    again, same_folder, (hits, misses) = ask(copy, cache)
    assert again == first
    assert same_folder == folder
    assert (hits, misses) == (1, 0)

    edited = callee.read_text(encoding="utf-8").replace("return g0 * (", "return 2.0 * g0 * (")
    callee.write_text(edited, encoding="utf-8")
    doubled, other_folder, _ = ask(copy, cache)
    assert doubled == pytest.approx(2.0 * first, rel=1e-14)
    assert other_folder != folder


def test_the_cache_lies_where_it_is_told(copy: Path, tmp_path: Path) -> None:
    _, folder, _ = ask(copy, tmp_path / "elsewhere")
    assert folder.parent == tmp_path / "elsewhere"
    assert list(folder.rglob("*.nbi"))


def test_old_versions_are_forgotten(copy: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    for age in range(8):
        old = cache / f"kernels-{age}"
        old.mkdir(parents=True)
        os.utime(old, (1e9 + age, 1e9 + age))
    _, folder, _ = ask(copy, cache)
    left = {path.name for path in cache.iterdir()}
    assert folder.name in left
    assert "kernels-0" not in left
    assert len(left) <= 5


def test_the_hash_covers_every_kernel_source() -> None:
    before = kernels.source_hash()
    assert before == kernels.source_hash()
    assert len(before) == 16
