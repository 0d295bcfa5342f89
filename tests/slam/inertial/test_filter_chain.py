"""The paper's map with inertia: each picture where the filter has the vehicle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slam.evaluation import evaluate
from slam.inertial.filter_chain import filter_chain
from slam.mapping.pipeline import optimize
from tests.slam.small_flight import flown


@pytest.mark.slow
def test_filter_chain_matches_the_true_poses():
    """The paper's map with inertia: from the instruments alone, each pose from what was read until then."""
    flight = flown(0)
    estimate = optimize(flight)
    poses = filter_chain(flight, estimate.stamps_s)
    chained = evaluate(replace(estimate, w_T_b=poses, floor_z_m=0.0), flight)
    assert chained.ate_m.rmse < 0.1
    before = filter_chain(flight, np.array([-5.0, 1.0, 2.0, 1e3]))
    assert np.isnan(before[[0, 3]]).all()
    assert np.isfinite(before[1:3]).all()
