"""Every kind of link by its URL."""

from __future__ import annotations

from mavins.transports.base import Admits, Link, Say, everyone
from mavins.transports.urls import LinkUrl


def open_link(url: LinkUrl, say: Say, admits: Admits = everyone) -> Link:
    """Open a link; `say` is told when one that opens itself again is lost, and when it is back.

    `admits` is asked about the clients of a TCP server and the members of a multicast group.

    TransportError where that cannot be done.
    """
    match url.kind:
        case "udp":
            from mavins.transports.udp import UdpTransport

            return UdpTransport.bind(url.host, url.port)
        case "udpout":
            from mavins.transports.udp import UdpTransport

            return UdpTransport.client(url.host, url.port)
        case "udpmcast":
            from mavins.transports.multicast import MulticastTransport

            return MulticastTransport(url.host, url.port, url.interface, admits)
        case "tcp":
            from mavins.transports.tcp import TcpClient

            return TcpClient(url.host, url.port, say)
        case "tcpin":
            from mavins.transports.tcp import TcpServer

            return TcpServer(url.host, url.port, say, admits)
        case "serial":
            from mavins.transports.serial import SerialTransport

            return SerialTransport(url.device, url.baud, say, url.trusted)
    raise AssertionError(url.kind)
