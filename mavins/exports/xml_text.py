"""XML written as it comes, so that a long track is never held as a tree."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from xml.sax.saxutils import XMLGenerator
from xml.sax.xmlreader import AttributesImpl


@contextmanager
def element(xml: XMLGenerator, name: str, **attributes: str) -> Iterator[None]:
    """An element around what the block writes, on lines of its own."""
    xml.startElement(name, AttributesImpl(attributes))
    xml.characters("\n")
    yield
    xml.endElement(name)
    xml.characters("\n")


def leaf(xml: XMLGenerator, name: str, text: str) -> None:
    """An element that holds text."""
    xml.startElement(name, AttributesImpl({}))
    xml.characters(text)
    xml.endElement(name)
    xml.characters("\n")


def raw(xml: XMLGenerator, text: str) -> None:
    """XML as it stands: numbers need no escaping, and there are many of them."""
    xml.ignorableWhitespace(text)
