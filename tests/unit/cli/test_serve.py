"""`mavins serve` for a user who asks for what cannot be: one line that says what to do, exit status 2."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from mavins.cli.main import main
from mavins.cli.serve import _with_stations
from mavins.transports.urls import LinkUrl, parse_url


@pytest.fixture
def busy() -> Iterator[int]:
    """A port that another program holds."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        yield sock.getsockname()[1]


def refused(capsys: pytest.CaptureFixture[str], *options: str) -> str:
    """What is said: one line on stderr, nothing on stdout, exit status 2."""
    assert main(["serve", *options]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith("mavins: ")
    assert said.err.count("\n") == 1
    assert "Traceback" not in said.err
    return said.err


def test_a_port_in_use_names_the_way_out(busy: int, capsys: pytest.CaptureFixture[str]) -> None:
    said = refused(capsys, "--udp", f"127.0.0.1:{busy}")
    assert f"127.0.0.1:{busy} is in use" in said
    assert "serve --udp 14540 --gcs 127.0.0.1:14550" in said


@pytest.mark.parametrize("option", ["--out", "--record"])
def test_a_place_that_cannot_be_written(
    option: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("not a folder")
    place = tmp_path / "file" / "below" / "flight.tlog"
    said = refused(capsys, "--udp", "127.0.0.1:0", option, str(place))
    assert str(tmp_path / "file") in said
    assert "choose another" in said


@pytest.mark.jit
def test_a_recording_that_is_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["serve", "-q", "--udp", "127.0.0.1:0", "--record", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert str(tmp_path) in said


@pytest.mark.parametrize("text", ["fourteen", "127.0.0.1:", "127.0.0.1:99999", "14550x", ""])
@pytest.mark.parametrize("option", ["--udp", "--gcs"])
def test_an_address_that_is_none(
    option: str, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--udp", text] if option == "--udp" else ["--udp", "127.0.0.1:0", "--gcs", text]
    assert "HOST:PORT" in refused(capsys, *options)


def test_a_host_that_does_not_exist(capsys: pytest.CaptureFixture[str]) -> None:
    assert "no-such-host.invalid" in refused(capsys, "--udp", "no-such-host.invalid:14550")
    said = refused(capsys, "--udp", "127.0.0.1:0", "--gcs", "no-such-host.invalid:14550")
    assert "no-such-host.invalid" in said


@pytest.mark.parametrize(
    "url",
    ["14550", "udp:14550", "tcp://", "serial://ttyAMA0", "serial:///dev/ttyAMA0?baud=fast", "x://"],
)
def test_a_link_that_does_not_parse(url: str, capsys: pytest.CaptureFixture[str]) -> None:
    said = refused(capsys, "--udp", "127.0.0.1:0", "--link", url)
    assert f"'{url}'" in said
    assert "for example" in said


@pytest.mark.parametrize(
    ("url", "named"),
    [
        ("tcp://no-such-host.invalid:5760", "no-such-host.invalid"),
        ("tcpin://192.0.2.1:5760", "no interface"),
        ("udp://no-such-host.invalid:14550", "no-such-host.invalid"),
        ("serial:///dev/no-such-device", "serial /dev/no-such-device: "),
    ],
)
def test_a_link_that_cannot_be_opened(
    url: str, named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert named in refused(capsys, "--link", url)


def test_nowhere_to_listen(capsys: pytest.CaptureFixture[str]) -> None:
    assert "--udp 14550" in refused(capsys)


def test_ground_stations_are_sent_to_from_where_we_listen() -> None:
    tcp, four, six = (
        parse_url("tcp://:5760"),
        parse_url("udp://:14540"),
        parse_url("udp://[::]:14541"),
    )
    stations = [("192.168.1.20", 14550), ("fd00::2", 14550)]
    links, named = _with_stations([tcp, four, four, six], stations)
    assert links == [tcp, four, four, six]
    assert named == [(1, "192.168.1.20", 14550), (3, "fd00::2", 14550)]
    # where there is no such port, each has a link of its own
    links, named = _with_stations([tcp, four], stations)
    assert links == [tcp, four, LinkUrl("udpout", "fd00::2", 14550)]
    assert named == [(1, "192.168.1.20", 14550)]


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("gnss:\n  delai: 0.1\n", "gnss.delai"),
        ("gnss:\n  delay: soon\n", "gnss.delay"),
        ("mavlink:\n  peer_timeout: -1\n", "mavlink.peer_timeout"),
        ("gnss: [1, 2\n", "settings.yaml"),
        ("- just\n- a list\n", "settings.yaml"),
        ("\x00\x01", "settings.yaml"),
    ],
)
def test_bad_settings(
    text: str, named: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "settings.yaml"
    path.write_text(text)
    assert named in refused(capsys, "--udp", "127.0.0.1:0", "--config", str(path))


def test_settings_that_are_not_there_and_an_unknown_filter(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "none.yaml" in refused(
        capsys, "--udp", "127.0.0.1:0", "--config", str(tmp_path / "none.yaml")
    )
    assert "eskf" in refused(capsys, "--udp", "127.0.0.1:0", "--filter", "particle")
