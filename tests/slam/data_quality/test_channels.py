"""Noise as a recording states it, beside what its readings show."""

from __future__ import annotations

from dataclasses import replace

import pytest

from slam.data_quality import misstated_noise, with_scattering_noise
from slam.data_quality.channels import noise_ratio, streams_of
from slam.simulation import simulate
from tests.slam.small_flight import recipe


@pytest.mark.parametrize(
    ("factor", "told"),
    [
        (0.2, "larger than stated: velocity"),
        (0.5, "larger than stated: velocity"),
        (1.0, ""),
        (5.0, "smaller than stated, as behind a filter: velocity"),
    ],
)
def test_a_misstated_noise_is_told_and_does_not_make_readings_more_certain(factor: float, told: str):
    flight = simulate(recipe(), seed=1)
    velocity = flight.velocity
    assert velocity is not None
    ahead, left = velocity.noise_std_m_s
    stated = replace(velocity, noise_std_m_s=(factor * ahead, factor * left))
    lines = misstated_noise([replace(flight, velocity=stated)])
    assert [told in line for line in lines] == [True] * bool(told)
    known = with_scattering_noise(replace(flight, velocity=stated))
    ratios = {stream.name: noise_ratio(stream) for stream in streams_of(known)}
    # Noise that is twice the stated one is told, and judged as stated.
    assert ratios["velocity"] == pytest.approx(1.0 if factor == 0.2 else 1.0 / factor, rel=0.3)


@pytest.mark.parametrize(("factor", "told"), [(0.2, "larger than assumed: velocity"), (0.5, ""), (5.0, "")])
def test_a_noise_that_nobody_states_is_not_called_stated(factor: float, told: str):
    flight = simulate(recipe(), seed=1)
    velocity = flight.velocity
    assert velocity is not None
    ahead, left = velocity.noise_std_m_s
    assumed = replace(velocity, noise_std_m_s=(factor * ahead, factor * left), assumed=("noise_std",))
    lines = misstated_noise([replace(flight, velocity=assumed)])
    assert [told in line for line in lines] == [True] * bool(told)
