"""Pictures of a flight, found by the names that other programs write for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath


@dataclass(frozen=True)
class PictureNames:
    """The names of the pictures of a flight, in any case of letters, with or without folder and ending."""

    by_ending: Mapping[str, str]
    """Lower-case name, file name or its stem -> name; empty where several have it."""

    @staticmethod
    def of(names: Sequence[str]) -> PictureNames:
        """Return the table of names."""
        found: dict[str, str] = {}
        for name in names:
            for key in {name.lower(), file_name(name).lower(), PurePosixPath(name).stem.lower()}:
                found[key] = name if key not in found or key == name.lower() else ""
        return PictureNames(found)

    def find(self, written: str) -> str | None:
        """Return the flight's name of a picture, empty where several have the one that is written, None for
        none.

        Photographs of one name in several folders have the folders in their names, joined by ``_``
        (`slam.io.photos.search`).
        """
        parts = parts_of(written)
        endings = (written.lower(), *("_".join(parts[k:]) for k in range(len(parts))))
        return next((self.by_ending[ending] for ending in endings if ending in self.by_ending), None)

    def is_ambiguous(self, written: str) -> bool:
        """Return whether pictures of several folders have a name that is written without a folder."""
        if file_name(written) != written:
            return False
        found, ending = self.find(written), f"_{written.lower()}"
        return found == "" or (
            found is None and sum(name.lower().endswith(ending) for name in {*self.by_ending.values()}) > 1
        )


def parts_of(written: str) -> tuple[str, ...]:
    """Return the folders and the name of a picture in small letters, also of a path of Windows."""
    return PurePosixPath(written.lower().replace("\\", "/")).parts


def file_name(written: str) -> str:
    """Return the name of a picture without its folders."""
    return PurePosixPath(written.replace("\\", "/")).name
