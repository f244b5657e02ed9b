"""The frame of the command line: lazy, and one clear line for every user's error."""

from __future__ import annotations

import subprocess
import sys
import types
from collections.abc import Callable
from typing import Any

import pytest

from mavins.cli import main as frame
from mavins.errors import MavinsError


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[Any], int]], None]:
    """Register a command `try` that runs the given function."""

    def register(run: Callable[[Any], int]) -> None:
        module = types.ModuleType("trial")
        members = {
            "SUMMARY": "A trial.",
            "EPILOG": "examples:\n  mavins try",
            "add_arguments": lambda parser: parser.add_argument("--value", type=int, default=3),
            "run": run,
        }
        vars(module).update(members)
        monkeypatch.setitem(sys.modules, "trial", module)
        monkeypatch.setitem(frame.COMMANDS, "try", ("trial", "a trial"))

    return register


def raising(error: BaseException) -> Callable[[Any], int]:
    def run(args: Any) -> int:
        raise error

    return run


def test_the_exit_status_is_the_commands(command: Any) -> None:
    command(lambda args: args.value)
    assert frame.main(["try"]) == 3
    assert frame.main(["try", "--value", "5"]) == 5


@pytest.mark.parametrize(
    ("arguments", "verbosity"),
    [
        (["try"], 0),
        (["-v", "try"], 1),
        (["try", "-v"], 1),
        (["-v", "try", "-v"], 2),
        (["-q", "try"], -1),
        (["try", "--quiet"], -1),
    ],
)
def test_verbosity_counts_before_and_after_the_command(
    command: Any, arguments: list[str], verbosity: int
) -> None:
    command(lambda args: 10 + args.verbosity)
    assert frame.main(arguments) == 10 + verbosity


def test_a_users_error_is_one_line_and_exit_2(
    command: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    command(raising(MavinsError("port 14550 is in use;\n use another")))
    assert frame.main(["try"]) == 2
    assert capsys.readouterr().err == "mavins: port 14550 is in use; use another\n"


def test_a_file_that_cannot_be_written_is_one_line(
    command: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    command(raising(PermissionError(13, "Permission denied", "/out")))
    assert frame.main(["try"]) == 2
    assert capsys.readouterr().err == "mavins: /out: Permission denied\n"


def test_ctrl_c_ends_with_130(command: Any) -> None:
    command(raising(KeyboardInterrupt()))
    assert frame.main(["try"]) == 130


@pytest.mark.parametrize(("module", "extra"), [("mavsdk", "mavins[acceptance]"), ("foo", "mavins")])
def test_a_missing_extra_is_named(
    command: Any, capsys: pytest.CaptureFixture[str], module: str, extra: str
) -> None:
    command(raising(ModuleNotFoundError("no", name=f"{module}.part")))
    assert frame.main(["try"]) == 2
    message = f"the module '{module}' is not installed; install it with: pip install '{extra}'"
    assert capsys.readouterr().err == f"mavins: {message}\n"


def test_our_own_missing_module_is_a_bug_and_not_hidden(command: Any) -> None:
    command(raising(ModuleNotFoundError("no", name="mavins.nowhere")))
    with pytest.raises(ModuleNotFoundError):
        frame.main(["try"])


def test_a_reader_that_goes_away_is_no_traceback() -> None:
    done = subprocess.run(
        f"{sys.executable} -m mavins config --default | true",
        shell=True,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stderr == ""


@pytest.mark.parametrize("arguments", [["--version"], ["--help"], ["demo", "--help"]])
def test_help_and_version_import_nothing_heavy(arguments: list[str]) -> None:
    """Not a matter of taste: numba alone would take longer than anybody waits for a help text."""
    code = (
        "import sys; from mavins.cli.main import main\n"
        "try: main(sys.argv[1:])\n"
        "except SystemExit: pass\n"
        "heavy = {'numpy', 'numba', 'scipy', 'pydantic', 'pymavlink', 'rich', 'yaml'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)"
    )
    subprocess.run(
        [sys.executable, "-c", code, *arguments], check=True, stdout=subprocess.DEVNULL, timeout=60
    )


def test_help_names_every_command_and_the_examples(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        frame.main(["--help"])
    text = capsys.readouterr().out
    assert all(name in text for name in frame.COMMANDS)
    assert "examples:" in text


def test_an_unknown_command_is_refused_with_the_choices(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit) as stop:
        frame.main(["fly"])
    assert stop.value.code == 2
    assert "invalid choice: 'fly'" in capsys.readouterr().err


def test_config_prints_what_load_reads_back(
    capsys: pytest.CaptureFixture[str], tmp_path: Any
) -> None:
    from mavins.config import Config, load

    assert frame.main(["config", "--default"]) == 0
    path = tmp_path / "mavins.yaml"
    path.write_text(capsys.readouterr().out, encoding="utf-8")
    assert load(path) == Config()
    assert frame.main(["config", "--config", str(path), "--plain"]) == 0
    assert load(path) == Config()


def test_config_checks_a_file(capsys: pytest.CaptureFixture[str], tmp_path: Any) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text("nonsense: 1\n", encoding="utf-8")
    assert frame.main(["config", "--config", str(path)]) == 2
    assert f"mavins: {path}: nonsense: unknown key" in capsys.readouterr().err


def test_warmup_reports_each_step(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = types.ModuleType("mavins.warmup")
    vars(fake)["compile_all"] = lambda report, name: report(f"compiling {name}")
    monkeypatch.setitem(sys.modules, "mavins.warmup", fake)
    assert frame.main(["warmup"]) == 0
    assert capsys.readouterr().err.startswith("compiling eskf\n")
    assert frame.main(["-q", "warmup"]) == 0
    assert capsys.readouterr().err == ""
