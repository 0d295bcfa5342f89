"""Order of elimination and sparsity pattern of the normal equations of a refinement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import K as CALIBRATION
from gtsam.symbol_shorthand import X as POSE
from numpy.typing import NDArray

from backend.bundle.exposure_motion import READOUT
from backend.bundle.observations import FloorObservations
from backend.bundle.schur import block_pattern
from backend.sparse_cholesky import Elimination, analyse

Index = NDArray[np.int64]


@dataclass(frozen=True)
class Structure:
    """Order of elimination of the pose side, and pattern of the reduced camera system."""

    variable: dict[int, int]
    """Number of each key of the pose side, 0.. by key."""
    elimination: Elimination
    observations: FloorObservations
    camera: Index
    """(m,) camera of each observation. Cameras are keyframes, numbered in the order of elimination."""
    by_camera: Index
    """(m,) observations, sorted by camera."""
    at: Index
    """(n + 1,) begin of each camera's observations among these."""
    row: Index
    """(n + 1,) begin of each camera's blocks, and..."""
    column: Index
    """(blocks,) ...the camera of each block's columns."""
    of_cameras: Index
    """(6n,) columns of the cameras."""
    of_calibration: Index
    """(q,) columns of the calibration, and of the read-out time; none of what is fixed."""

    @staticmethod
    def of(
        graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, n: int, observations: FloorObservations
    ) -> Structure:
        """Analyse the pattern of a pose-side graph and the observations of its ``n`` keyframes."""
        dims = values.dims()
        variable = {key: k for k, key in enumerate(sorted(dims))}
        keyframes = np.array([variable[POSE(k)] for k in range(n)])
        common = [variable[key] for key in (CALIBRATION(0), READOUT) if key in variable]
        lens = np.array(common, dtype=np.int64)
        by_camera, at = _sorted_by(observations.keyframe, n)
        row, column = block_pattern(
            observations.keyframe, observations.track, observations.first, by_camera, at
        )
        pairs = np.column_stack([np.repeat(np.arange(n), np.diff(row)), column])
        everywhere = np.array([(k, v) for v in lens for k in keyframes], dtype=np.int64).reshape(-1, 2)
        together = np.array(list(combinations(common, 2)), dtype=np.int64).reshape(-1, 2)
        ties = np.vstack([_pairs_of(graph, variable), keyframes[pairs], everywhere, together])
        widths = np.array([dims[key] for key in variable], dtype=np.int64)
        elimination = analyse(np.unique(ties[ties[:, 0] != ties[:, 1]], axis=0), widths)
        order = np.argsort(elimination.begin[keyframes])
        rank = np.empty(n, dtype=np.int64)
        rank[order] = np.arange(n)
        camera = rank[observations.keyframe]
        pairs = np.sort(rank[pairs], axis=1)
        return Structure(
            variable,
            elimination,
            observations,
            camera,
            *_sorted_by(camera, n),
            row=np.concatenate([[0], np.cumsum(np.bincount(pairs[:, 0], minlength=n))]),
            column=pairs[np.lexsort(pairs.T[::-1]), 1],
            of_cameras=elimination.columns(keyframes[order]),
            of_calibration=elimination.columns(lens),
        )

    def columns(self, key: int) -> slice:
        """Return the columns of a variable of the pose side."""
        v = self.variable[key]
        begin = int(self.elimination.begin[v])
        return slice(begin, begin + int(self.elimination.widths[v]))

    def columns_of(self, keys: Sequence[int]) -> Index:
        """Return the columns (k, d) of variables with as many numbers each."""
        variables = np.array([self.variable[key] for key in keys])
        return self.elimination.columns(variables).reshape(len(keys), -1)

    @cached_property
    def by_key(self) -> Index:
        """Place among the columns by key of each column in the order of elimination."""
        at = np.empty(self.elimination.size, dtype=np.int64)
        at[self.elimination.columns(np.arange(len(self.variable)))] = np.arange(len(at))
        return at


def _sorted_by(number: Index, n: int) -> tuple[Index, Index]:
    begin = np.concatenate([[0], np.cumsum(np.bincount(number, minlength=n))])
    return np.argsort(number, kind="stable"), begin


def _pairs_of(graph: gtsam.NonlinearFactorGraph, variable: dict[int, int]) -> Index:
    """Return the pairs (p, 2) of variables that share a factor."""
    found = {
        pair
        for factor in (graph.at(k) for k in range(graph.size()))
        for pair in combinations(sorted(variable[key] for key in factor.keys()), 2)  # noqa: SIM118
    }
    return np.array(sorted(found), dtype=np.int64).reshape(-1, 2)
