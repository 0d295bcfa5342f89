"""A table whose rows name pictures in files beside it, with the times of their exposures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam.core.progress import Progress
from slam.io.files import check_inside
from slam.io.photos.search import SUFFIXES
from slam.io.recordings.picture_list import assumed_camera, listed_pictures
from slam.io.recordings.recording import Content, Offer, Recording


def with_pictures(recording: Recording, stamps_ns: NDArray[np.int64], names: Sequence[str]) -> Recording:
    """Return the recording of a table with the pictures that its rows name; without any, as it is.

    ``stamps_ns`` (n,) and ``names`` (n) are those of the rows; a name without the suffix of a picture is
    none. Raises ``InputError`` for a picture out of the folder.
    """
    rows = np.array([k for k, name in enumerate(names) if Path(name).suffix.lower() in SUFFIXES], dtype=int)
    listed = tuple(names[k] for k in rows)
    folder = recording.path.parent
    for name in listed:
        check_inside(folder / name, folder)
    count = len(listed)
    if not any(_is_file(folder / name) for name in listed):
        filled = sum(map(bool, names))
        if filled == 0:
            return recording
        return replace(
            recording, others=(*recording.others, ("picture", "column, without its files", filled))
        )
    channel = f"{recording.path.name}: pictures"
    offer = Offer(stream="cam0", channel=channel, kind="list of pictures", rows=count, reading="8 bit")

    def read(chosen: Sequence[Offer], progress: Progress) -> Content:
        content = recording.read([each for each in chosen if each.channel != channel], progress)
        if not any(each.channel == channel for each in chosen):
            return content
        return replace(
            content, pictures=listed_pictures(recording.path, stamps_ns[rows], listed, assumed_camera)
        )

    return replace(recording, offers=(offer, *recording.offers), read=read)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name that no file can have
        return False
