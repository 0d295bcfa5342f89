"""Vertical datums of altitudes, as EPSG codes of systems of heights, as far as their sources state them."""

from __future__ import annotations

import re

UNKNOWN = ""
ELLIPSOID = "EPSG:4979"
"""WGS 84 with ellipsoidal heights."""
SEA_LEVEL = "EPSG:5773"
"""Orthometric heights by EGM96, the model of sea level that receivers of autopilots hold (u-blox M8 protocol
specification, UBX-NAV-POSLLH: ``hMSL``)."""
_NAMES = {ELLIPSOID: "the WGS 84 ellipsoid", SEA_LEVEL: "mean sea level by EGM96"}
_WORDS = {"ellipsoid": ELLIPSOID, "sea level": SEA_LEVEL}
_CODE = re.compile(r"EPSG:\d{4,6}", re.IGNORECASE)


def height_system(written: str) -> str | None:
    """Return the code of ``ellipsoid``, ``sea level`` or a code; None for another text."""
    if written.lower() in _WORDS:
        return _WORDS[written.lower()]
    return written.upper() if _CODE.fullmatch(written) else None


def height_system_text(code: str) -> str:
    """Return a known system in words, with its code."""
    return f"{_NAMES[code]} ({code})" if code in _NAMES else f"the height system {code}"
