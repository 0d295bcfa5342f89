"""Whether covariances tell the truth: NEES over four hundred made flights of each kind.

Made are the measurements (`tests.backend.made_floor`: followed floor points, attitudes, ranges, fixes, each
with its own Gaussian noise); the refinement is the real one. Of each flight one keyframe counts, the one that
lies farthest out, so that the flights are independent and the band is that of a chi-square.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from backend.bundle.refinement import refine
from backend.measurements import FloorTracks
from tests.backend.made_floor import Made, Scene, aligned, make, nees
from tests.benchmarks.metric import Metric, told, within

FLIGHTS = 400
CHANCE = 0.05
KINDS = {
    "no loops": Scene(keyframes=32),
    "loops": Scene(),
    "GPS": Scene(position_std_m=(0.05, 0.08)),
    "sonar only": Scene(attitude_std_rad=None),
    "sonar of unknown gain": Scene(range_gain_std=0.05),
}

Array = np.ndarray


def measure() -> list[Metric]:
    """Each kind of flight."""
    low, high = (float(chi2.ppf(q, 6 * FLIGHTS)) / FLIGHTS for q in (CHANCE / 2, 1 - CHANCE / 2))
    metrics = []
    for kind in KINDS:
        found = np.array([flight(kind, seed) for seed in range(FLIGHTS)])
        metrics.append(
            within(f"{kind}: mean NEES of {FLIGHTS} flights", found.mean(), "", (low, high), "6 expected")
        )
        beyond = float(np.mean(found > chi2.ppf(1 - CHANCE, 6)))
        metrics.append(told(f"{kind}: share of flights beyond 95 %", beyond, "", "0.05 expected"))
    return metrics


def flight(kind: str, seed: int) -> float:
    """NEES of one keyframe of one flight."""
    scene = KINDS[kind]
    # A gain is unknown by as much as it is told to be.
    gain = 1 + scene.range_gain_std * np.random.default_rng([seed, 1]).standard_normal()
    made = make(replace(scene, range_gain=float(gain)), seed)
    turn = (scene.keyframes + 1) // 2
    if kind == "no loops":
        made = _first(made, turn)
    found = refine(made.measurements, made.start, made.floor_z_m)
    hat = found.w_T_b if scene.position_std_m is not None else aligned(found.w_T_b, made.w_T_b)
    k = slice(turn - 1, turn)
    return float(nees(hat[k], made.w_T_b[k], found.covariances[k])[0])


def _first(made: Made, count: int) -> Made:
    """The way out alone: nothing is seen twice."""
    measured, tracks = made.measurements, made.measurements.tracks
    assert tracks is not None
    out = tracks.keyframe < count
    out &= np.bincount(tracks.track, out)[tracks.track] >= 2
    track = np.unique(tracks.track[out], return_inverse=True)[1]
    measured = replace(
        measured,
        stamps_s=measured.stamps_s[:count],
        attitudes=tuple(a for a in measured.attitudes if a.k < count),
        ranges=tuple(r for r in measured.ranges if r.k < count),
        tracks=FloorTracks(tracks.keyframe[out], track, tracks.pixel[out], tracks.std_px[out]),
    )
    return Made(measured, made.start[:count], made.w_T_b[:count], made.floor_z_m)
