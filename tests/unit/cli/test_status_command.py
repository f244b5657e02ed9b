"""`mavins status` with services that are there, that end, and that are not there."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator

import pytest

from mavins import status_socket
from mavins.cli.main import main
from mavins.errors import TransportError
from mavins.status import StatusSnapshot, from_json


@pytest.fixture
def found(monkeypatch: pytest.MonkeyPatch) -> list[dict[int, StatusSnapshot]]:
    """What is found each time that is looked, the last one for good."""
    rounds: list[dict[int, StatusSnapshot]] = []

    def running(pid: int | None = None) -> dict[int, StatusSnapshot]:
        now = rounds.pop(0) if len(rounds) > 1 else rounds[0]
        return {number: s for number, s in now.items() if pid in (None, number)}

    monkeypatch.setattr(status_socket, "running", running)
    monkeypatch.setattr(status_socket, "hidden", lambda: False)
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    return rounds


def of(pid: int, uptime: float = 5.0) -> StatusSnapshot:
    return StatusSnapshot(uptime, 1, 20, 30, pid=pid)


def test_one_line_where_there_is_no_terminal(
    found: list[dict[int, StatusSnapshot]], capsys: pytest.CaptureFixture[str]
) -> None:
    found.append({7: of(7)})
    assert main(["status"]) == 0
    assert capsys.readouterr().out == (
        "     5 s  waiting for a vehicle's IMU; 1 peer, 20 packets in, 30 out\n"
    )


def test_json_is_a_snapshot_that_names_its_process(
    found: list[dict[int, StatusSnapshot]], capsys: pytest.CaptureFixture[str]
) -> None:
    found.append({7: of(7), 9: of(9)})
    assert main(["status", "--json"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [from_json(line) for line in lines] == [of(7), of(9)]
    assert [json.loads(line)["pid"] for line in lines] == [7, 9]
    assert main(["status", "--json", "--pid", "9"]) == 0
    assert from_json(capsys.readouterr().out) == of(9)


def test_several_are_told_apart(
    found: list[dict[int, StatusSnapshot]], capsys: pytest.CaptureFixture[str]
) -> None:
    found.append({7: of(7), 9: of(9)})
    assert main(["status"]) == 0
    assert capsys.readouterr().out.splitlines()[::2] == ["service 7", "service 9"]


def test_watching_until_it_ends(
    found: list[dict[int, StatusSnapshot]], capsys: pytest.CaptureFixture[str]
) -> None:
    found += [{7: of(7, 1.0)}, {7: of(7, 1.0)}, {7: of(7, 2.0)}, {}]
    assert main(["status", "--watch", "--json"]) == 2
    said = capsys.readouterr()
    assert [from_json(line).uptime for line in said.out.splitlines()] == [1.0, 2.0]
    assert said.err == "mavins: the service 7 has ended\n"


@pytest.mark.parametrize(
    ("options", "hidden", "way_out"),
    [
        ([], False, "mavins serve --udp 14550"),
        ([], True, "sudo mavins status"),
        (["--json", "--watch"], False, "mavins serve --udp 14550"),
        (["--pid", "8"], False, "'mavins status' shows all"),
    ],
)
def test_nobody_there_is_one_line_with_the_way_out(
    found: list[dict[int, StatusSnapshot]],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    hidden: bool,
    way_out: str,
) -> None:
    found.append({})
    monkeypatch.setattr(status_socket, "hidden", lambda: hidden)
    assert main(["status", *options]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    assert way_out in said.err


def test_one_that_does_not_answer(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def running(pid: int | None) -> Iterator[None]:
        raise TransportError("the service 7 does not answer")

    monkeypatch.setattr(status_socket, "running", running)
    assert main(["status"]) == 2
    assert "does not answer" in capsys.readouterr().err
