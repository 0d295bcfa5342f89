"""Reading of a picture's XMP packet with the names of drone makers, in two families.

``drone`` is DJI's names (``drone-dji:GimbalYawDegree``) and those of makers that copy them under their own
namespace. ``camera`` is Pix4D's names (``Camera:Yaw``), used by Parrot, senseFly, Autel, MicaSense and
others. Values are attributes, elements, lists or members of structures; all are read. Source: Adobe, XMP
Specification Part 1 (2012), section 7; Pix4D, "Specifications of xmp.camera tags".
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal
from xml.etree.ElementTree import Element, ParseError

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import fromstring

Family = Literal["drone", "camera"]

_LARGEST_BYTES = 1 << 20
_LARGEST_DEPTH = 20
_LIST_ITEM = "{http://www.w3.org/1999/02/22-rdf-syntax-ns#}li"


@dataclass(frozen=True)
class Xmp:
    """Values of one packet as text, by family and name."""

    values: dict[tuple[Family, str], str] = field(default_factory=dict)
    """A member of a structure has the structure's name before its own: ``CameraOrientationNED.Yaw``. Items of
    a list are joined by commas."""
    damaged: bool = False
    """Whether a packet was present but could not be read."""

    def text(self, family: Family, *names: str) -> str:
        """Return the value of the first name that has one; empty if none has."""
        return next((v for n in names if (v := self.values.get((family, n), "").strip())), "")


def parse_xmp(packet: bytes) -> Xmp:
    """Read a packet. A damaged packet, or one with XML entities, is only marked as damaged."""
    # Padding and stray bytes around the document are common and are not XML.
    start, end = packet.find(b"<x:xmpmeta"), packet.rfind(b"</x:xmpmeta>")
    document = packet[start : end + len(b"</x:xmpmeta>")] if 0 <= start < end else packet.strip(b"\0 \r\n\t")
    if not document:
        return Xmp()
    if len(document) > _LARGEST_BYTES:
        return Xmp(damaged=True)
    try:
        root = fromstring(document, forbid_dtd=True)
    except (ParseError, DefusedXmlException, ValueError, LookupError):
        return Xmp(damaged=True)
    return Xmp({(family, name): value for family, name, value in _named_values(root, "", 0)})


def _named_values(element: Element, structure: str, depth: int) -> Iterator[tuple[Family, str, str]]:
    """Yield the values inside an element; ``structure`` is the beginning of their names."""
    for tag, value in element.attrib.items():
        family, name = _split(tag)
        if family is not None and value.strip():
            yield family, structure + name, value
    for child in element if depth < _LARGEST_DEPTH else ():
        family, name = _split(str(child.tag))
        items = [item.text or "" for item in child.iter(_LIST_ITEM)]
        value = ",".join(items) if items else child.text or ""
        if family is not None and value.strip():
            yield family, structure + name, value
        yield from _named_values(child, structure if family is None else f"{structure}{name}.", depth + 1)


def _split(tag: str) -> tuple[Family | None, str]:
    uri, _, name = tag.removeprefix("{").rpartition("}")
    return family_of(uri), name


def family_of(uri: str) -> Family | None:
    """Return the family of the names in a namespace; None for other namespaces."""
    uri = uri.casefold()
    if "pix4d.com/camera" in uri or "sensefly.com/camera" in uri:
        return "camera"
    return "drone" if "drone" in uri else None
