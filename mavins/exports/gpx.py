"""The track as GPX 1.1: estimate and GNSS, altitudes above mean sea level, with UTC where the vehicle told it."""

from __future__ import annotations

from pathlib import Path
from typing import Final
from xml.sax.saxutils import XMLGenerator

from mavins import __version__
from mavins.estimates import Result
from mavins.exports.places import Stretch, tracks, utc_offset_us, utc_texts
from mavins.exports.xml_text import element, leaf, raw

FILES: Final = ("track.gpx",)
NEEDS: Final = ()
NAMESPACE: Final = "http://www.topografix.com/GPX/1/1"


def write(result: Result, folder: Path) -> None:
    """Write track.gpx."""
    offset_us = utc_offset_us(result)
    with (folder / FILES[0]).open("w", encoding="utf-8", newline="\n") as file:
        xml = XMLGenerator(file, "utf-8", short_empty_elements=True)
        xml.startDocument()
        head = {"xmlns": NAMESPACE, "version": "1.1", "creator": f"mavins {__version__}"}
        with element(xml, "gpx", **head):
            for name, parts in tracks(result):
                with element(xml, "trk"):
                    leaf(xml, "name", name)
                    for part in parts:
                        _segment(xml, part, offset_us)
        xml.endDocument()


def _segment(xml: XMLGenerator, part: Stretch, offset_us: int | None) -> None:
    with element(xml, "trkseg"):
        times = utc_texts(part.t_us, offset_us)
        for time, (lat, lon, alt) in zip(times, part.degrees.tolist(), strict=True):
            said = f"<time>{time}</time>\n" if time else ""
            point = f"<ele>{alt:.3f}</ele>\n{said}"
            raw(xml, f'<trkpt lat="{lat:.8f}" lon="{lon:.8f}">\n{point}</trkpt>\n')
