"""A result folder of one piece: its files are written aside, within it, and take their places together at the end."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mavins.errors import OutputError


@contextmanager
def written_whole(out: Path, mark: str | None = None, own: Collection[str] = ()) -> Iterator[Path]:
    """A folder to write into, whose files move to the same places in `out` once the block has ended well.

    Until then the files of `out` stay as they were, and where the block fails or is interrupted nothing is left of it.
    The file `mark` goes first and comes last: a folder that has it is of one piece. Of what was in `out`, files of the
    same names are replaced, those named in `own` (paths within it) go, and everything else stays: it is the user's.
    """
    created = not out.exists()
    try:
        out.mkdir(parents=True, exist_ok=True)
        # not beside it: `out` may be a file system of its own, into which nothing can be renamed
        aside = Path(tempfile.mkdtemp(prefix=".part-", dir=out))
    except OSError as error:
        raise _refusal(out, error) from error
    whole = False
    try:
        yield aside
        _install(aside, out, mark, own)
        whole = True
    except OutputError as error:
        raise OutputError(str(error).replace(str(aside), str(out))) from error
    except OSError as error:
        if error.filename is not None and not str(error.filename).startswith(str(aside)):
            raise
        raise _refusal(out, error) from error
    finally:
        shutil.rmtree(aside, ignore_errors=True)
        if created and not whole:
            with suppress(OSError):
                out.rmdir()


def _install(aside: Path, out: Path, mark: str | None, own: Collection[str]) -> None:
    """Move all files from `aside` into `out`."""
    marks = [] if mark is None else [mark]
    new = [str(path.relative_to(aside)) for path in sorted(aside.rglob("*")) if path.is_file()]
    new.sort(key=lambda name: name in marks)
    try:
        for name in (*marks, *(name for name in own if name not in new)):
            (out / name).unlink(missing_ok=True)
        for name in new:
            (out / name).parent.mkdir(parents=True, exist_ok=True)
            (aside / name).replace(out / name)
    except OSError as error:
        raise _refusal(out, error) from error


def _refusal(out: Path, error: OSError) -> OutputError:
    return OutputError(f"cannot write into {out}: {error.strerror}; choose another folder")
