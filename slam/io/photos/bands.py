"""Choice of one band of a camera whose lenses take pictures of the same place at once: colours, or heat."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence

from slam.core.errors import InputError
from slam.io.photos.exif import PhotoTags

COLOUR = "RGB"
"""Name of the band of colour photographs."""

THERMAL = "Thermal"
"""Name of the band of thermal photographs, which have less detail than all others."""

_NAMES = {
    "rgb": COLOUR, "red,green,blue": COLOUR,
    "b": "Blue", "blue": "Blue", "g": "Green", "gre": "Green", "green": "Green", "r": "Red", "red": "Red",
    "re": "Red edge", "reg": "Red edge", "rededge": "Red edge", "nir": "NIR",
    "t": THERMAL, "thrm": THERMAL, "thermal": THERMAL, "lwir": THERMAL, "infraredcamera": THERMAL,
}  # fmt: skip
"""Names of the makers, without spaces and hyphens, and one name for each band."""
_PREFERRED = ("Green", "Red", "Blue", "Red edge", "NIR", THERMAL)
"""Order of the choice among bands with equally many photographs."""
_IN_FILE_NAME = (
    re.compile(r"_(RGB|GRE|NIR|RED|REG)\.\w+$", re.IGNORECASE),  # Parrot Sequoia
    re.compile(r"_MS_(B|G|R|RE|NIR)\.tiff?$", re.IGNORECASE),  # DJI Mavic 3 Multispectral
    re.compile(r"^DJI_\d{3}([1-5])\.tiff?$", re.IGNORECASE),  # DJI Phantom 4 Multispectral
    re.compile(r"^IMG_\d{4}_(\d{1,2})\.tiff?$", re.IGNORECASE),  # MicaSense RedEdge, Altum
    re.compile(r"^DJI_\d.*_(T|THRM)\.\w+$", re.IGNORECASE),  # DJI H20T, M30T, Mavic 3 Thermal
)
_COLOUR_SHARE = 0.5
"""Colour photographs are chosen if they are at least this share of the photographs of the largest band. All
lenses are released together, so fewer of them are another camera's."""


def band_of(name: str, tags: PhotoTags) -> str:
    """Return the band of a photograph from its tags, else from the maker's file name; ``COLOUR`` if neither
    contains it.
    """
    if tags.band:
        return canonical(tags.band)
    found = next((match[1] for pattern in _IN_FILE_NAME if (match := pattern.search(name))), "")
    return f"band {found}" if found.isdecimal() else canonical(found or COLOUR)


def canonical(band: str) -> str:
    """Return the usual name of a band, or the given one if it is not a usual band."""
    return _NAMES.get(re.sub(r"[\s_-]", "", band).casefold(), band.strip())


def chosen_band(bands: Sequence[str], wanted: str | None) -> str:
    """Return the band to use among those of all photographs (at least one).

    It is the wanted one, else colour, else the one with the most photographs. Raises ``InputError`` if no
    photograph has the wanted band.
    """
    counts = Counter(bands)
    if wanted is not None:
        name = canonical(f"band {wanted.strip()}" if wanted.strip().isdecimal() else wanted)
        found = next((b for b in counts if b.casefold() == name.casefold()), None)
        if found is None:
            raise InputError(f"no photograph of band {wanted}; choose one of {', '.join(sorted(counts))}")
        return found
    if counts[COLOUR] and counts[COLOUR] >= _COLOUR_SHARE * max(counts.values()):
        return COLOUR
    ranks = {band: rank for rank, band in enumerate(_PREFERRED)}
    return min(counts, key=lambda band: (-counts[band], ranks.get(band, len(ranks)), band))
