"""The map without loops, beside which the report puts the result."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from slam.mapping import build_estimate


@pytest.mark.parametrize(("component", "known"), [((0, 0, 0), 3), ((0, 0, 1), 2)])
def test_what_only_loops_connect_has_no_place_without_them(component, known, monkeypatch):
    """The second of two flights would stand at any place, and so would the landmarks that it sees."""
    monkeypatch.setattr(build_estimate, "chain", lambda *_: np.tile(np.eye(4), (3, 1, 1)))
    odometry = SimpleNamespace(
        component=np.array(component),
        w_T_b=np.tile(np.eye(4), (3, 1, 1)),
        edges=SimpleNamespace(heights=SimpleNamespace(height_m=np.ones(3))),
    )
    context = SimpleNamespace(
        setup=SimpleNamespace(camera=None, readings=SimpleNamespace(roll_pitch_rad=None)),
        flight=SimpleNamespace(gps=None),
        bridges=SimpleNamespace(edges=tuple, join=lambda made: made),
    )
    map_ = SimpleNamespace(odometry=odometry, observations=SimpleNamespace(links=()))
    _, poses = build_estimate._lesser_maps(context, map_)
    assert np.isfinite(poses).all(axis=(1, 2)).sum() == known
