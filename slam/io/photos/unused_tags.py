"""Remarks on tags that are present but not used."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence

from backend.wording import counted
from slam.core.messages import Message, parsed
from slam.core.names import listed


def unused_tags(what: str, faults: Sequence[tuple[str, Sequence[str]]]) -> list[Message]:
    """Return one line for each kind of fault of tags of position or attitude, with its photographs.

    ``faults`` has the name of each photograph and the reasons for which its tags are not used. Reasons that
    differ in their numbers alone are of one kind.
    """
    found: dict[str, list[tuple[str, str]]] = defaultdict(list)
    for name, reasons in faults:
        for reason in reasons:
            found[re.sub(r"[-+\d.]+(e[-+]?\d+)?", "#", reason)].append((name, reason))
    lines = []
    for those in found.values():
        example = those[0][1] + (" (the first)" if len({reason for _, reason in those}) > 1 else "")
        names = listed([name for name, _ in those])
        where = counted(len(those), "photograph")
        lines.append(parsed(f"{what} tags not used in {where}: {example} ({names})"))
    return lines
