"""Steps between pictures as readings of the filter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from backend import se3
from backend.ekf import records as ekf_records
from backend.ekf.track import track
from tests.backend.made_motion import KNOWN, as_the_flight_moves, fly, read, seen_steps, start_of

AT_S = np.arange(0.5, 12.0, 0.25)


def test_steps_of_pictures_hold_the_position():
    """Without any measure of speed the position runs away; steps between pictures hold it."""
    off = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        flight = fly(rng)
        model = as_the_flight_moves(flight, KNOWN)
        readings = replace(read(flight, model, rng, seconds=12.0), velocity_m_s=None)
        start = start_of(flight, readings, rng)
        seen = replace(readings, steps=seen_steps(flight, AT_S, rng))
        with_, without = (track(r, AT_S, start, model).smoothed for r in (seen, readings))
        xi = se3.log(se3.inverse(with_.w_T_b) @ flight.w_T_b(AT_S))
        off.append(np.einsum("na,nab,nb->n", xi, np.linalg.inv(with_.covariances), xi)[-1])
        assert np.trace(with_.covariances[-1, 3:, 3:]) < 0.1 * np.trace(without.covariances[-1, 3:, 3:])
    low, high = chi2.ppf([0.0005, 0.9995], 6 * len(off))
    assert low < sum(off) < high


def test_steps_of_pictures_are_foreseen_as_well_as_told_and_a_wrong_one_counts():
    rng = np.random.default_rng(5)
    flight = fly(rng)
    model = as_the_flight_moves(flight, KNOWN)
    readings = read(flight, model, rng, seconds=12.0)
    start = start_of(flight, readings, rng)
    steps = list(seen_steps(flight, AT_S, rng))
    found = track(replace(readings, steps=tuple(steps)), AT_S, start, model).channels["pictures"]
    assert found.nis.shape == (len(steps), 6)
    low, high = chi2.ppf([0.0005, 0.9995], found.nis.size)
    assert low < found.nis.sum() < high
    off = np.array([0.0, 0.0, 0.0, 0.5, 0.0, 0.0])
    steps[9] = replace(steps[9], i_T_j=steps[9].i_T_j @ se3.exp(off[None])[0])
    wrong = track(replace(readings, steps=tuple(steps)), AT_S, start, model).channels["pictures"]
    assert (wrong.status[9] == ekf_records.REJECTED).all()
    assert wrong.count(ekf_records.REJECTED) == 6
    assert wrong.log_likelihood < found.log_likelihood - 5.0


def test_the_way_across_a_stretch_without_pictures_is_as_uncertain_as_told():
    """Steps before and after tell the speed; between them the accelerometer carries on for two seconds."""
    scores, std_m = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        flight = fly(rng)
        model = as_the_flight_moves(flight, KNOWN)
        readings = replace(read(flight, model, rng, seconds=12.0), velocity_m_s=None)
        asked_s = np.concatenate([np.arange(0.5, 5.0, 0.25), np.arange(7.0, 12.0, 0.25)])
        j = int(np.searchsorted(asked_s, 7.0))
        steps = tuple(step for step in seen_steps(flight, asked_s, rng) if step.j != j)
        found = track(
            replace(readings, steps=steps), asked_s, start_of(flight, readings, rng), model
        ).smoothed
        ends = flight.w_T_b(asked_s[j - 1 : j + 1])
        i_T_j = se3.inverse(ends[:1]) @ ends[1:]
        xi = se3.log(se3.inverse(found.clone_T_b[j : j + 1]) @ i_T_j)[0]
        scores.append(xi @ np.linalg.solve(found.clone_T_b_covariances[j], xi))
        std_m.append(np.sqrt(found.clone_T_b_covariances[j][3, 3]))
    low, high = chi2.ppf([0.0005, 0.9995], 6 * len(scores))
    assert low < sum(scores) < high
    assert 0.005 < np.mean(std_m) < 0.1
