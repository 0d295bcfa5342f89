"""Pictures of a flight, found by the names that other programs write for them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import PurePosixPath


@dataclass(frozen=True)
class PictureNames:
    """The names of the pictures of a flight, in any case of letters, with or without folder and ending."""

    by_ending: Mapping[str, str]
    """Lower-case name, file name or its stem -> name; empty where several have it."""
    by_path: Mapping[tuple[str, ...], str] = field(default_factory=dict)
    """Parts of a path below the folder of the flight, in small letters -> name; empty where none is known."""

    @staticmethod
    def of(names: Sequence[str], paths: Iterable[str] = ()) -> PictureNames:
        """Return the table of names, and of paths in the order of the names if these are known."""
        found: dict[str, str] = {}
        for name in names:
            for key in {name.lower(), file_name(name).lower(), PurePosixPath(name).stem.lower()}:
                found[key] = name if key not in found or key == name.lower() else ""
        return PictureNames(found, dict(zip(map(parts_of, paths), names, strict=False)))

    def find(self, written: str) -> str | None:
        """Return the flight's name of a picture, empty where several have the one that is written, None for
        none.

        Photographs of one name in several folders have the folders in their names, joined by ``_``
        (`slam.io.photos.search`).
        """
        parts = parts_of(written)
        if exact := self.by_path.get(parts):
            return exact
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

    def matched(self, written: Iterable[str], flight_name: str) -> NameMatches:
        """Return which pictures all names of a file mean.

        Where names in several folders lead to one picture of the flight, by their file name alone, it is the
        one whose folder is known to be the flight's: by the flight's name, or in the picture's own name.
        Where paths are known, a name that is the exact path comes first. A name in another folder is then one
        of no picture.
        """
        path_of = {name: parts for parts, name in self.by_path.items()}
        ambiguous, unknown, pairs = list[str](), list[str](), dict[str, list[str]]()
        for each in dict.fromkeys(written):
            if self.is_ambiguous(each):
                ambiguous.append(each)
            elif (name := self.find(each)) and _may_be(parts_of(each), path_of.get(name, ())):
                pairs.setdefault(name, []).append(each)
            else:
                unknown.append(each)
        picture, unclear = dict[str, str](), list[str]()
        for name, several in pairs.items():
            exact = [each for each in several if parts_of(each) == path_of.get(name)]
            if own := exact or _of_own_folder(name, several, flight_name):
                picture |= dict.fromkeys(own, name)
                unknown += [each for each in several if each not in own]
            else:
                unclear.append(name)
        return NameMatches(picture, tuple(ambiguous), tuple(unknown), tuple(unclear))


@dataclass(frozen=True)
class NameMatches:
    """Names in a file, and which pictures of a flight they mean."""

    picture: Mapping[str, str]
    """Written name -> the flight's name."""
    ambiguous: tuple[str, ...]
    """Written names, each of which several pictures have in different folders."""
    unknown: tuple[str, ...]
    """Written names of no picture of the flight."""
    unclear: tuple[str, ...]
    """The flight's names of pictures that are written in several folders, none of them known as its own."""


def _may_be(written: tuple[str, ...], path: tuple[str, ...]) -> bool:
    """Return whether two paths may be of one file: the folders next to it agree where both have one."""
    return len({parts[-2] for parts in (written, path) if len(parts) > 1}) <= 1


def _of_own_folder(name: str, written: Sequence[str], flight_name: str) -> list[str]:
    """Return those written names of one picture that are not in a folder of other pictures."""
    folders = {each: parts[-2] for each in written if len(parts := parts_of(each)) > 1}
    if len({*folders.values()}) < 2:
        return list(written)
    known = {flight_name.lower(), *PurePosixPath(name.lower()).parts[:-1]}
    strange = {
        each for each, folder in folders.items() if folder not in known and folder + "_" not in name.lower()
    }
    return [] if len(strange) == len(folders) else [each for each in written if each not in strange]


def parts_of(written: str) -> tuple[str, ...]:
    """Return the folders and the name of a picture in small letters, also of a path of Windows."""
    return PurePosixPath(written.lower().replace("\\", "/")).parts


def file_name(written: str) -> str:
    """Return the name of a picture without its folders."""
    return PurePosixPath(written.replace("\\", "/")).name
