"""The one decorator of the hot mathematics, and the cache its compiled code lives in.

A kernel is a free function on float64 arrays: no configuration, no logging, no fastmath, so that the same
input gives the same bits. numba's own file cache does not notice that a *called* function of another
file has changed; ours lies in a folder named by a hash of every kernel source, so a stale entry
cannot be found. `MAVINS_CACHE` moves the folder.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])

_PACKAGE: Final = Path(__file__).resolve().parent.parent
_KEPT_CACHES: Final = 4
# numba looks for compiled code by where its source lies: another copy of the package finds none of it
_COMPLETE: Final = f"complete-{hashlib.sha256(str(_PACKAGE).encode()).hexdigest()[:8]}"


def cache_root() -> Path:
    """The folder under which every version of the kernel cache lies: $MAVINS_CACHE or the user's cache folder."""
    configured = os.environ.get("MAVINS_CACHE")
    if configured:
        return Path(configured).expanduser()
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "mavins"


def source_hash(package: Path = _PACKAGE) -> str:
    """A hash of every source file that holds kernels, of the numba version and of this CPU's features."""
    digest = hashlib.sha256(numba.__version__.encode())
    digest.update(_cpu_features().encode())
    for path in sorted(package.rglob("*.py")):
        text = path.read_bytes()
        if b"@kernel" in text:
            digest.update(path.relative_to(package).as_posix().encode())
            digest.update(text)
    return digest.hexdigest()[:16]


def _cpu_features() -> str:
    from llvmlite import binding

    return f"{binding.get_host_cpu_name()} {binding.get_host_cpu_features().flatten()}"


def _writable_cache() -> Path | None:
    root = cache_root()
    folder = root / f"kernels-{source_hash()}"
    try:
        fresh = not folder.exists()
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK | os.X_OK):
            return None
        if fresh:
            _prune(root)
    except OSError:
        return None
    return folder


def _prune(root: Path) -> None:
    """Forget all but the newest few caches: each edit of a kernel makes a new one."""
    caches = sorted(root.glob("kernels-*"), key=lambda path: path.stat().st_mtime, reverse=True)
    for stale in caches[_KEPT_CACHES:]:
        shutil.rmtree(stale, ignore_errors=True)


CACHE: Final = _writable_cache()
"""This version's cache folder, or None where none can be written (the kernels then compile at each start)."""


def kernel(function: F) -> F:
    """Compile `function` with numba on its first call and keep the result on disk."""
    if CACHE is None:
        return cast(F, numba.njit(error_model="numpy")(function))
    # numba reads its cache folder while it decorates; putting the setting back leaves other users of
    # numba in this process alone.
    config: Any = numba.config
    before = config.CACHE_DIR
    config.CACHE_DIR = str(CACHE)
    try:
        return cast(F, numba.njit(cache=True, error_model="numpy")(function))
    finally:
        config.CACHE_DIR = before


def compiles() -> bool:
    """True where kernels are compiled, and not left as Python (NUMBA_DISABLE_JIT=1)."""
    config: Any = numba.config
    return not config.DISABLE_JIT


def is_cached(name: str) -> bool:
    """True where an earlier start has compiled every kernel that is used with the filter `name`."""
    return CACHE is not None and (CACHE / f"{_COMPLETE}-{name}").exists()


def mark_cached(name: str) -> None:
    """Note that every kernel that is used with the filter `name` has been compiled."""
    if CACHE is not None:
        (CACHE / f"{_COMPLETE}-{name}").touch()
