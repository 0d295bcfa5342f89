"""Links between keyframes as lines of a scene, coloured by verdict."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from backend.measurements import CONTRADICTED, UNPROVEN
from slam.core.errors import one_line
from slam.core.estimate import Estimate
from slam.io.exports.foxglove import messages

Array = NDArray[np.float64]
Message = Any

COLOURS = {
    "neighbours": (138, 143, 152),
    "kept": (0, 158, 115),
    CONTRADICTED: (213, 94, 0),
    UNPROVEN: (204, 121, 167),
}
"""Verdict -> colour of Okabe and Ito, which colour-blind readers can distinguish."""
MOST_ENTITIES = 2000
"""Links of a verdict: each is an object that a viewer draws, and that can be clicked."""


def link_entities(estimate: Estimate, shown: NDArray[np.int64], stamp_ns: int) -> tuple[list[Message], str]:
    """Return the links between the keyframes ``shown``, and a note if these are too many for a viewer.

    Links of neighbours in time are one entity. Each link between two visits of a place is one, with its
    verdict, its reason and the names of both pictures.
    """
    at, known = estimate.w_T_b[:, :3, 3], np.isin(np.arange(len(estimate.w_T_b)), shown)
    neighbours = [(e.i, e.j) for e in estimate.relative_poses if e.kind == "odometry"]
    kept = [(e.i, e.j, "") for e in estimate.relative_poses if e.kind == "loop"]
    rejected = {
        finding: [(v.i, v.j, v.reason) for v in estimate.loops if v.finding == finding]
        for finding in (CONTRADICTED, UNPROVEN)
    }
    pairs = np.array([p for p in neighbours if known[list(p)].all()], dtype=np.int64).reshape(-1, 2)
    entities = [messages.lines(stamp_ns, "neighbours", at[pairs], COLOURS["neighbours"])] * bool(len(pairs))
    notes = []
    for verdict, found in {"kept": kept, **rejected}.items():
        placed = [link for link in found if known[[link[0], link[1]]].all()]
        step = max(1, -(-len(placed) // MOST_ENTITIES))
        if step > 1:
            notes.append(f"{len(placed[::step])} of {len(placed)} {verdict} links")
        for i, j, reason in placed[::step]:
            about = {"verdict": verdict, "from": estimate.frame_names[i], "to": estimate.frame_names[j]}
            about |= {"reason": reason} if reason else {}
            plain = {key: one_line(value) for key, value in about.items()}
            ends = at[np.array([[i, j]])]
            entities.append(messages.lines(stamp_ns, f"{verdict} {i}-{j}", ends, COLOURS[verdict], plain))
    return entities, f"drawn: {', '.join(notes)}; loops.csv has all" if notes else ""
