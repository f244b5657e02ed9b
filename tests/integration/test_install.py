"""What is shipped for companion computers, against the program: the systemd unit and its page."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from mavins.cli import serve, warmup
from mavins.cli.main import _parser
from mavins.config import load
from mavins.status_socket import SYSTEM_FOLDER
from mavins.transports.base import parse_address
from mavins.transports.urls import parse_url

DOCS = Path(__file__).resolve().parents[2] / "docs"
UNIT = DOCS / "install" / "mavins.service"
PAGE = DOCS / "tutorials" / "companion-computer.md"
PROGRAM = "/opt/mavins/bin/mavins"


def values(key: str) -> list[str]:
    """All values of a key of the unit."""
    return re.findall(rf"^{key}=(.*)$", UNIT.read_text("utf-8"), re.MULTILINE)


def words(key: str) -> list[str]:
    """The command of a key, as systemd parts it: no shell, no globbing."""
    (line,) = values(key)
    assert not re.search(r"[%$\\]", line)
    program, *rest = shlex.split(line)
    assert program == PROGRAM
    return rest


def test_the_service_starts_what_there_is() -> None:
    name, *options = words("ExecStart")
    args = _parser(name, serve).parse_args([name, *options])
    assert [parse_url(text).kind for text in args.link] == ["serial"]
    assert [parse_address(text) for text in args.udp] == [("", 14550)]
    assert args.route
    (state,) = values("StateDirectory")
    assert args.config.parent == Path("/var/lib") / state == Path(*values("WorkingDirectory"))


def test_it_compiles_first_and_into_its_own_cache() -> None:
    name, *options = words("ExecStartPre")
    assert name == "warmup"
    _parser(name, warmup).parse_args([name, *options])
    (cache,) = values("CacheDirectory")
    assert values("Environment") == [f"MAVINS_CACHE=/var/cache/{cache}"]
    assert values("MemoryDenyWriteExecute") == []


def test_its_status_is_where_it_is_looked_for() -> None:
    assert [Path("/run") / folder for folder in values("RuntimeDirectory")] == [SYSTEM_FOLDER]
    assert values("RuntimeDirectoryMode") == ["0700"]


def test_systemd_takes_it_without_a_remark(tmp_path: Path) -> None:
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("systemd-analyze is not installed")
    unit = tmp_path / "mavins.service"
    unit.write_text(UNIT.read_text("utf-8").replace(PROGRAM, sys.executable), "utf-8")
    done = subprocess.run(
        [analyze, "verify", "--man=no", "--recursive-errors=no", str(unit)],
        capture_output=True,
        text=True,
        timeout=60.0,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.parametrize("number", [0, 1])
def test_the_configurations_of_the_page_are_taken(number: int, tmp_path: Path) -> None:
    blocks = re.findall(r"^```yaml\n(.*?)^```", PAGE.read_text("utf-8"), re.DOTALL | re.MULTILINE)
    assert len(blocks) == 2
    file = tmp_path / "mavins.yaml"
    file.write_text(blocks[number], "utf-8")
    config = load(file, {})
    assert config.mavlink.persona == "companion"
    assert config.sources.gnss == ("auto", "gps2_raw")[number]
