"""The track as KML 2.2: estimate and GNSS, at their altitudes above mean sea level.

Where the vehicle told the time of day, a track can be played; otherwise it is a line.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final
from xml.sax.saxutils import XMLGenerator

from mavins.estimates import Result
from mavins.exports.places import Stretch, tracks, utc_offset_us, utc_texts
from mavins.exports.xml_text import element, leaf, raw

FILES: Final = ("track.kml",)
NEEDS: Final = ()
NAMESPACE: Final = "http://www.opengis.net/kml/2.2"
EXTENSIONS: Final = "http://www.google.com/kml/ext/2.2"
COLOURS: Final = {"estimate": "ff00a5ff", "GNSS": "ffff9060"}
"""Opacity, blue, green, red."""


def write(result: Result, folder: Path) -> None:
    """Write track.kml."""
    offset_us = utc_offset_us(result)
    with (folder / FILES[0]).open("w", encoding="utf-8", newline="\n") as file:
        xml = XMLGenerator(file, "utf-8", short_empty_elements=True)
        xml.startDocument()
        root = {"xmlns": NAMESPACE, "xmlns:gx": EXTENSIONS}
        with element(xml, "kml", **root), element(xml, "Document"):
            leaf(xml, "name", f"mavins {result.filter}")
            for name, colour in COLOURS.items():
                with element(xml, "Style", id=name), element(xml, "LineStyle"):
                    leaf(xml, "color", colour)
                    leaf(xml, "width", "2")
            for name, parts in tracks(result):
                with element(xml, "Folder"):
                    leaf(xml, "name", name)
                    for part in parts:
                        _placemark(xml, name, part, offset_us)
        xml.endDocument()


def _placemark(xml: XMLGenerator, name: str, part: Stretch, offset_us: int | None) -> None:
    places = part.degrees[:, [1, 0, 2]].tolist()
    with element(xml, "Placemark"):
        leaf(xml, "name", name)
        leaf(xml, "styleUrl", f"#{name}")
        if offset_us is None:
            with element(xml, "LineString"):
                leaf(xml, "altitudeMode", "absolute")
                lines = "\n".join(f"{lon:.8f},{lat:.8f},{alt:.3f}" for lon, lat, alt in places)
                leaf(xml, "coordinates", lines)
            return
        with element(xml, "gx:Track"):
            leaf(xml, "altitudeMode", "absolute")
            for time in utc_texts(part.t_us, offset_us):
                raw(xml, f"<when>{time}</when>\n")
            for lon, lat, alt in places:
                raw(xml, f"<gx:coord>{lon:.8f} {lat:.8f} {alt:.3f}</gx:coord>\n")
