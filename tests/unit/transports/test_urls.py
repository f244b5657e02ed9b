"""The URL of a link: what each names, and what is told about one that does not parse."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mavins.errors import TransportError
from mavins.transports.base import address_text, parse_address
from mavins.transports.urls import EXAMPLES, LinkUrl, parse_url


@pytest.mark.parametrize(
    ("text", "link"),
    [
        ("udp://:14550", LinkUrl("udp", "", 14550)),
        ("udp://14550", LinkUrl("udp", "", 14550)),
        ("udp://127.0.0.1:14540/", LinkUrl("udp", "127.0.0.1", 14540)),
        ("udp://[::1]:14550", LinkUrl("udp", "::1", 14550)),
        ("udp://[::]:0", LinkUrl("udp", "::", 0)),
        ("udpout://station:14550", LinkUrl("udpout", "station", 14550)),
        ("tcp://:5760", LinkUrl("tcp", "", 5760)),
        ("tcpin://[fe80::1%eth0]:5760", LinkUrl("tcpin", "fe80::1%eth0", 5760)),
        ("serial:///dev/ttyUSB0", LinkUrl("serial", device="/dev/ttyUSB0", baud=57600)),
        (
            "serial:///dev/ttyAMA0?baud=921600&trusted=1",
            LinkUrl("serial", device="/dev/ttyAMA0", baud=921600, trusted=True),
        ),
        ("udpmcast://239.1.2.3:14550", LinkUrl("udpmcast", "239.1.2.3", 14550)),
        (
            "udpmcast://239.1.2.3:14550?interface=10.0.0.2",
            LinkUrl("udpmcast", "239.1.2.3", 14550, interface="10.0.0.2"),
        ),
        ("udp://:14550?unsigned=none", LinkUrl("udp", "", 14550, unsigned="none")),
        (
            "serial:///dev/ttyUSB0?trusted=1&unsigned=all",
            LinkUrl("serial", device="/dev/ttyUSB0", trusted=True, unsigned="all"),
        ),
    ],
)
def test_what_a_url_names(text: str, link: LinkUrl) -> None:
    assert parse_url(text) == link


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "not a link"),
        ("14550", "not a link"),
        ("udp:14550", "not a link"),
        ("http://station:80", "not a link"),
        ("UDP://:14550", "not a link"),
        ("udp://", "HOST:PORT"),
        ("udp://station", "HOST:PORT"),
        ("udp://:70000", "HOST:PORT"),
        ("udp://::1:14550", "[IPV6]:PORT"),
        ("udp://:14550?baud=5", "no option 'baud'"),
        ("udp://:14550?unsigned=yes", "unsigned is none, local or all"),
        ("tcp://station:0", "port of the other side"),
        ("serial://ttyUSB0", "full path"),
        ("serial://", "full path"),
        ("serial:///dev/ttyUSB0?baud=fast", "baud"),
        ("serial:///dev/ttyUSB0?baud=0", "baud"),
        ("serial:///dev/ttyUSB0?baud=99999999", "baud"),
        ("serial:///dev/ttyUSB0?trusted=yes", "trusted"),
        ("serial:///dev/ttyUSB0?rate=57600", "'rate', only baud, trusted, unsigned"),
        ("serial:///dev/ttyUSB0?baud", "NAME=VALUE"),
        ("udpmcast://192.168.1.1:14550", "224.0.0.0"),
        ("udpmcast://[ff02::1]:14550", "224.0.0.0"),
        ("udpmcast://239.1.2.3:14550?interface=eth0", "interface an IPv4"),
    ],
)
def test_one_that_does_not_parse_is_shown_an_example(text: str, told: str) -> None:
    with pytest.raises(TransportError) as caught:
        parse_url(text)
    message = str(caught.value)
    assert told in message
    assert any(example in message for example in EXAMPLES.values())
    assert "\n" not in message


@pytest.mark.parametrize("kind", sorted(EXAMPLES))
def test_every_example_parses(kind: str) -> None:
    assert parse_url(EXAMPLES[kind]).kind == kind


@given(st.sampled_from(sorted(EXAMPLES)), st.text(max_size=30))
def test_no_text_raises_anything_else(kind: str, rest: str) -> None:
    for text in (rest, f"{kind}://{rest}", f"{EXAMPLES[kind]}?{rest}", f"{EXAMPLES[kind]}&{rest}"):
        with contextlib.suppress(TransportError):
            assert parse_url(text).kind in EXAMPLES


@pytest.mark.parametrize("address", [("127.0.0.1", 1), ("::1", 14550), ("fe80::1%eth0", 0)])
def test_addresses_are_written_as_they_are_read(address: tuple[str, int]) -> None:
    assert parse_address(address_text(address)) == address
