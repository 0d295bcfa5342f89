"""Wrong arguments of the back end's public functions are refused in one line."""

from __future__ import annotations

import io

import numpy as np
import pytest

import backend


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: backend.solve(3), "measurements: expected Measurements, got int"),
        (lambda: backend.solve_pose_graph(3), "graph: expected PoseGraph, got int"),
        (
            lambda: backend.solve_pose_graph("a.g2o"),
            r"graph: expected PoseGraph, got the path 'a.g2o'; read it first: backend.read_g2o\(path\)",
        ),
        (lambda: backend.certify(None, None), "graph: expected PoseGraph, got NoneType"),
        (lambda: backend.write_g2o(io.StringIO(), 3), "graph: expected PoseGraph, got int"),
        (lambda: backend.track(3, np.zeros(1), None), "readings: expected Readings, got int"),
    ],
)
def test_another_object_is_refused(call, message):
    with pytest.raises(TypeError, match=f"^{message}$"):
        call()
