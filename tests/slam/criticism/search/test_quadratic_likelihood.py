"""The likelihood of flights as others predict it is the average over what those leave open."""

from __future__ import annotations

import numpy as np
import pytest

from slam.criticism.kalman.kernel_inputs import Perturbation
from slam.criticism.search.effects import Effect
from slam.criticism.search.information import FisherInformation
from slam.criticism.search.quadratic_likelihood import NINE_OF_TEN, Maximum, QuadraticLikelihood


def test_predicted_is_the_average_over_the_answers_uncertainty():
    rng = np.random.default_rng(4)
    root = rng.standard_normal((3, 5))
    one = np.zeros(1, dtype=int)
    fisher = FisherInformation(
        ("a", "b", "c"), one, (root @ root.T)[None], rng.standard_normal((1, 3)), np.zeros(1)
    )
    quadratic = QuadraticLikelihood(fisher, None, None, ())
    half = 0.3 * rng.standard_normal((2, 2))
    free, whole = np.array([0, 2]), np.array([0.2, 0.0, -0.1])
    covariance = half @ half.T
    other = Maximum(0.0, ("a", "c"), whole[free], covariance, whole, covariance)
    drawn = rng.standard_normal((200_000, 2)) @ half.T
    steps = np.tile(whole, (len(drawn), 1))
    steps[:, free] += drawn
    nats = steps @ quadratic.score - 0.5 * np.einsum("ni,ij,nj->n", steps, quadratic.information, steps)
    assert quadratic.predicted(other) == pytest.approx(np.log(np.mean(np.exp(nats))), abs=0.01)


def test_without_segments_a_shown_size_is_the_threshold_in_standard_errors():
    direction = Perturbation("gyro_bias.x", "sensor", 0)
    one = np.zeros(1, dtype=int)
    fisher = FisherInformation(("gyro_bias.x",), one, np.array([[[4.0]]]), np.zeros((1, 1)), np.zeros(1))
    quadratic = QuadraticLikelihood(fisher, None, None, ())
    sizes = quadratic.shown_sizes(Effect("gyro_bias", (direction,)), 3.7)
    assert sizes == pytest.approx([(3.7 + NINE_OF_TEN) * 0.5])
