"""A result folder is of one piece, and what it replaces stays until then."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from mavins.errors import OutputError
from mavins.whole_folder import written_whole

MARK = "summary.json"


def contents(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): path.read_text()
        for path in folder.rglob("*")
        if path.is_file()
    }


def write(folder: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


@pytest.fixture
def former(tmp_path: Path) -> Path:
    """A result of an earlier run, with files of the user beside it."""
    out = tmp_path / "result"
    files = {MARK: "old", "eskf/estimates.csv": "old", "eskf/smoothed.csv": "old"}
    write(out, files | {"notes.txt": "mine", "eskf/notes.txt": "mine", "iekf/estimates.csv": "old"})
    return out


def test_files_come_into_place_at_the_end(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "result"
    with written_whole(out, MARK) as aside:
        write(aside, {MARK: "new", "eskf/estimates.csv": "new"})
        assert not (out / MARK).exists()
        assert not (out / "eskf").exists()
    assert contents(out) == {MARK: "new", "eskf/estimates.csv": "new"}


def test_what_it_replaces_goes_and_all_else_stays(former: Path) -> None:
    with written_whole(former, MARK, ["eskf/smoothed.csv"]) as aside:
        write(aside, {MARK: "new", "eskf/estimates.csv": "new"})
    assert contents(former) == {
        MARK: "new",
        "eskf/estimates.csv": "new",
        "notes.txt": "mine",
        "eskf/notes.txt": "mine",
        "iekf/estimates.csv": "old",
    }


@pytest.mark.parametrize(
    "failure", [KeyboardInterrupt(), OutputError("no"), OSError(errno.ENOSPC, "full"), ValueError()]
)
def test_a_failure_leaves_a_former_result_as_it_was(former: Path, failure: BaseException) -> None:
    before = contents(former)
    kept = OutputError if isinstance(failure, OSError) else type(failure)
    with pytest.raises(kept), written_whole(former, MARK, ["eskf/smoothed.csv"]) as aside:  # noqa: PT012
        write(aside, {MARK: "new", "eskf/estimates.csv": "half"})
        raise failure
    assert contents(former) == before
    assert not list(former.glob(".*"))


def test_a_failure_leaves_no_folder_where_there_was_none(tmp_path: Path) -> None:
    out = tmp_path / "result"
    with pytest.raises(KeyboardInterrupt), written_whole(out, MARK) as aside:  # noqa: PT012
        write(aside, {"eskf/estimates.csv": "half"})
        raise KeyboardInterrupt
    assert not out.exists()


def test_a_failed_move_leaves_no_mark(former: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is half old and half new does not pass for a result."""
    moved = Path.replace

    def full(self: Path, target: Path) -> Path:
        if self.name == MARK:
            raise OSError(errno.EDQUOT, "Disk quota exceeded", str(target))
        return moved(self, target)

    monkeypatch.setattr(Path, "replace", full)
    with (
        pytest.raises(OutputError, match="quota"),
        written_whole(former, MARK) as aside,
    ):
        write(aside, {MARK: "new", "eskf/estimates.csv": "new"})
    assert not (former / MARK).exists()
    assert (former / "notes.txt").read_text() == "mine"


def test_a_message_names_the_place_that_the_user_knows(tmp_path: Path) -> None:
    out = tmp_path / "result"
    with pytest.raises(OutputError) as caught, written_whole(out, MARK) as aside:
        raise OutputError(f"cannot write {aside / 'eskf' / 'estimates.csv'}: full")
    assert str(caught.value) == f"cannot write {out / 'eskf' / 'estimates.csv'}: full"


def test_an_error_of_reading_is_not_taken_for_one_of_writing(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), written_whole(tmp_path / "result", MARK):
        (tmp_path / "no.tlog").read_bytes()


def test_a_file_in_the_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "result"
    out.write_text("mine")
    with pytest.raises(OutputError, match=r"cannot write into .*result"), written_whole(out, MARK):
        pass
    assert out.read_text() == "mine"
