"""Calibration of covariances: NEES over hundreds of synthetic flights of each kind.

The measurements are synthetic (`tests.backend.made_floor`: tracked floor points, attitudes, ranges, fixes,
each with Gaussian noise); the refinement is the real one. One keyframe of each flight counts, the one
farthest from the start, so the flights are independent and the band is that of a chi-square. One landmark in
its picture counts too, with the covariance that the mosaic uses.

Flights across two seconds without features use the simulator's instruments and the real filter; the picture
steps before and after are synthetic.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from backend import se3
from backend.bundle.refinement import refine
from backend.ekf.inputs import VisualStep
from backend.measurements import FloorTracks
from slam.evaluation.association import poses_at
from slam.mapping.inertial.bridges import filtered_gaps
from slam.simulation import simulate
from slam.simulation.recipe import recipe_from
from tests.backend.made_floor import Made, Scene, aligned, make, mark_nees, nees
from tests.benchmarks.metric import Metric, reported, within

FLIGHTS = 400
CHANCE = 0.05
KINDS = {
    "no loops": Scene(keyframes=32),
    "loops": Scene(),
    "GPS": Scene(position_std_m=(0.05, 0.08)),
    "sonar only": Scene(attitude_std_rad=None),
    "sonar of unknown gain": Scene(range_gain_std=0.05),
}

BRIDGED = 150
BRIDGES = {
    "IMU bridging 2 s": False,
    "IMU and speed over ground bridging 2 s": True,
}
WRONG_SPEED_M_S = 0.03
BLIND_S = 4.0, 6.0
_STEP_STD = np.array([2e-3, 2e-3, 1e-3, 2e-3, 2e-3, 2e-3])
_STRAIGHT = recipe_from(
    {
        "name": "straight",
        "landmarks": {"A": [0.3, 0.3], "B": [4.3, 0.3]},
        "landmark_pairs": [["A", "B"]],
        "maneuver": {"way_points": ["A", "B"], "cruise_m_s": 0.5},
        "camera": "none",
        "world": {"extent_m": [0, 0, 4.6, 1.0], "margin_m": 0.6, "metres_per_px": 0.02, "seed": 3},
    },
    "calibration",
)

Array = np.ndarray


def measure() -> list[Metric]:
    """Measure each kind of flight."""
    metrics = []
    for kind in KINDS:
        found = [flight(kind, seed) for seed in range(FLIGHTS)]
        for freedom, what, own in (
            (6, kind, [f.pose for f in found]),
            (2, f"{kind}, landmarks", [f.landmark for f in found]),
            (1, f"{kind}, scale", [f.scale for f in found]),
        ):
            metrics += judged(what, np.array(own), freedom)
    for kind, with_velocity in BRIDGES.items():
        metrics += judged(kind, np.array([bridge(seed, with_velocity) for seed in range(BRIDGED)]), 6)
    return [*metrics, _wrong_speed()]


def _wrong_speed() -> Metric:
    scores = [bridge(seed, True, WRONG_SPEED_M_S) for seed in range(BRIDGED)]
    what = f"the same, speed always read {100 * WRONG_SPEED_M_S:.0f} cm/s too large: mean NEES"
    return reported(what, float(np.mean(scores)), "", "6 expected; the maker names no such error")


def judged(kind: str, nees: Array, dof: int) -> list[Metric]:
    """Compare the mean of independent NEES values (n,) with its chi-square limits."""
    n = len(nees)
    low, high = (float(chi2.ppf(q, dof * n)) / n for q in (CHANCE / 2, 1 - CHANCE / 2))
    beyond = float(np.mean(nees > chi2.ppf(1 - CHANCE, dof)))
    return [
        within(f"{kind}: mean NEES of {n} flights", float(nees.mean()), "", (low, high), f"{dof} expected"),
        reported(f"{kind}: share of flights beyond 95 %", beyond, "", "0.05 expected"),
    ]


@dataclass(frozen=True)
class FlightNees:
    """Normalised estimation errors squared (NEES) of one flight."""

    pose: float
    landmark: float
    scale: float


def flight(kind: str, seed: int) -> FlightNees:
    """Run one flight; return the NEES of a keyframe, of its floor footprint, and of the scale."""
    scene = KINDS[kind]
    # The gain is drawn from its stated uncertainty.
    gain = 1 + scene.range_gain_std * np.random.default_rng([seed, 1]).standard_normal()
    made = make(replace(scene, range_gain=float(gain)), seed)
    turn = (scene.keyframes + 1) // 2
    if kind == "no loops":
        made = _first(made, turn)
    found = refine(made.measurements, made.start, made.floor_z_m)
    hat = found.w_T_b if scene.position_std_m is not None else aligned(found.w_T_b, made.w_T_b)
    k = turn - 1
    # The unit of length is the first keyframe's height.
    ratio = (found.w_T_b[0, 2, 3] - found.floor_z_m) / (made.w_T_b[0, 2, 3] - made.floor_z_m)
    assert found.scale_std is not None
    return FlightNees(
        float(nees(hat[k : k + 1], made.w_T_b[k : k + 1], found.covariances[k : k + 1])[0]),
        mark_nees(made, found, k),
        float(np.log(ratio) / found.scale_std) ** 2,
    )


def bridge(seed: int, with_velocity: bool, velocity_error_m_s: float = 0.0) -> float:
    """Return the NEES of the edge across two seconds of a straight flight of four metres.

    The velocity readings have the constant error ``velocity_error_m_s``.
    """
    flown = simulate(_STRAIGHT, seed)
    assert flown.truth is not None
    stamps_s = np.arange(flown.truth.stamps_s[0] + 0.5, flown.truth.stamps_s[-1] - 0.5, 0.3)
    stamps_s = stamps_s[(stamps_s <= BLIND_S[0]) | (stamps_s >= BLIND_S[1])]
    w_T_b = poses_at(flown.truth, stamps_s)
    rng, steps = np.random.default_rng([seed, 7]), []
    for k in np.flatnonzero(np.diff(stamps_s) < 1.0).tolist():
        i_T_j = np.linalg.inv(w_T_b[k]) @ w_T_b[k + 1]
        i_T_j[:3, 3] /= w_T_b[k, 2, 3]
        noisy = i_T_j @ se3.exp(rng.normal(0, _STEP_STD, (1, 6)))[0]
        steps.append(VisualStep(k, k + 1, noisy, np.diag(_STEP_STD**2)))
    # The simulated speed has the nominal scale.
    velocity = flown.velocity if with_velocity else None
    if velocity is not None:
        velocity = replace(velocity, scale_std=0.0, v_m_s=velocity.v_m_s + velocity_error_m_s)
    flown = replace(flown, velocity=velocity)
    (edge,) = filtered_gaps(flown, stamps_s, tuple(steps)).edges
    truth = np.linalg.inv(w_T_b[edge.i]) @ w_T_b[edge.j]
    return float(nees(edge.i_T_j[None], truth[None], edge.covariance[None])[0])


def _first(made: Made, count: int) -> Made:
    """Build a one-way flight without revisits."""
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
    return replace(made, measurements=measured, start=made.start[:count], w_T_b=made.w_T_b[:count])
