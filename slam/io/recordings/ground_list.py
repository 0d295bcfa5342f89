"""Lists of ground pictures in the layout of the HD Ground database: a line with a file, a line with its pose.

A pose is a 3 x 3 matrix row by row; one that begins with ``*`` is unreliable. The list states neither times
nor the unit and origin of the poses. Source: Schmid and others, "HD Ground - A database for ground texture
based localization", ICRA 2022.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from slam.core.messages import warning
from slam.core.progress import Progress
from slam.io.files import check_inside, read_text, refusal
from slam.io.recordings.picture_list import assumed_camera, listed_pictures
from slam.io.recordings.recording import Content, Offer, Recording

_MAX_BYTES = 1 << 28
_STEP_NS = 10**9
_NOTE = warning("the list has no times: one picture a second assumed")


def open_recording(path: Path) -> Recording:
    """Open a list. Raises ``InputError`` where it names a file outside of its folder."""
    text, remarks = read_text(path, path.parent, _MAX_BYTES)
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    names, poses = tuple(lines[0::2]), lines[1::2]
    for k, pose in enumerate(poses):
        if len(pose.replace("*", " ").split()) != 9:
            raise refusal(path, f"has no pose of nine numbers for {names[k]}", "complete the list")
    for name in names:
        check_inside(path.parent / name, path.parent)
    stamps_ns = np.arange(len(names), dtype=np.int64) * _STEP_NS

    def read(chosen: Sequence[Offer], progress: Progress) -> Content:
        pictures = listed_pictures(path, stamps_ns, names, assumed_camera, (_NOTE,))
        return Content(pictures=pictures, warnings=tuple(remarks))

    offer = Offer(stream="cam0", channel=path.name, kind="list of pictures", rows=len(names), reading="8 bit")
    return Recording(
        path=path,
        name=path.stem,
        description="a list of ground pictures",
        offers=(offer,),
        others=(("poses, of an unknown unit", "3 x 3", len(poses)),),
        read=read,
    )
