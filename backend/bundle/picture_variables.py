"""Three more variables of each picture, added to a linear system that is solved without them.

All other variables are eliminated, as in a Schur complement: they follow.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array

from backend.bundle.reduced_system import LinearSystem, ReducedSystem

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PictureVariables:
    """Normal equations of the variables of k pictures, with all others eliminated."""

    pictures: NDArray[np.int64]
    """(k,)."""
    gradient: Array
    """(3k,) J'b."""
    information: Array
    """(3k, 3k)."""
    follow: Array
    """(size + 3t, 3k) how all others change with each, with the opposite sign."""


def picture_variables(
    linear: LinearSystem,
    reduced: ReducedSystem,
    pictures: NDArray[np.int64],
    derivative: Array,
    at_once: int,
) -> Iterator[PictureVariables]:
    """Yield the equations of variables of the ``pictures``, about ``at_once`` of them at a time.

    ``derivative`` (m, 2, 3) is that of all floor observations by the variables of their picture.
    """
    if not len(pictures):
        return
    keyframe, size = linear.structure.observations.keyframe, reduced.size
    jacobian, right = linear.jacobian()
    right = right - jacobian @ np.concatenate(reduced.solve(*linear.gradient))
    for some in np.array_split(pictures, -(-len(pictures) // at_once)):
        mine = np.flatnonzero(np.isin(keyframe, some))
        columns = 3 * np.searchsorted(some, keyframe[mine])[:, None] + np.arange(3)
        rows = (2 * mine[:, None] + np.arange(2)).ravel()
        entries = derivative[mine].ravel(), (np.repeat(rows, 3), np.repeat(columns, 2, axis=0).ravel())
        own = csr_array(coo_array(entries, shape=(len(right), 3 * len(some))))
        mixed = (jacobian.T @ own).toarray()
        follow = np.vstack(reduced.solve(mixed[:size], mixed[size:]))
        information = (own.T @ own).toarray() - mixed.T @ follow
        yield PictureVariables(some, np.asarray(own.T @ right), information, follow)
