"""Elements of XML files with text, and their writing."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

NO_TIME = "the stamps count from the start of the recorder: the track has no times"
"""Note of the formats whose times are those of the calendar."""


def child(parent: ET.Element, tag: str, text: str | None = None) -> ET.Element:
    """Add an element with text, or with none yet, and return it."""
    element = ET.SubElement(parent, tag)
    element.text = text
    return element


def write_xml(root: ET.Element, target: Path) -> None:
    """Write a document in UTF-8 with indentation."""
    ET.indent(root)
    ET.ElementTree(root).write(target, encoding="UTF-8", xml_declaration=True)
