"""Optical flow on rendered pairs: accuracy beside that of features, and the consistency of its covariances.

Each pair is a keyframe and a later picture of 320x240 that share 75 to 98 %, with a few degrees of turn and
tilt, and the prediction is off by about 2 px. The NEES is that of the four transferred corners, per degree of
freedom. Light, blur and noise are those of the kinds in `tests/benchmarks/registration.py`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from frontend.camera import Camera
from frontend.features import Extractor
from frontend.flow import FlowTemplate
from frontend.gates import GateConfig
from frontend.homography import HomographyConfig, transfer
from frontend.motions import Expectation
from frontend.registration import Registration, overlap, register
from slam.mapping.config import PipelineConfig
from slam.simulation.recipe import load_recipe
from tests.benchmarks.metric import Metric, at_least, at_most, within
from tests.benchmarks.registration import KINDS, Kind, filmed, homography_between

Array = NDArray[np.float64]

PAIRS, SEED = 40, 0
SHARED = (0.75, 0.98)
TURN_RAD, TILT_RAD, CLIMB, OFF_PX = 0.1, 0.02, 0.05, 2.0
NAMES = {
    "75 to 90 % shared", "white balance and gamma", "vignetting of one half", "exposure of 40 ms",
    "noise of 10 grey levels", "gym's planks",
}  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    """Results of the pairs that were followed."""

    followed: int
    nees: Array
    """(k,) NEES of the corners per degree of freedom."""
    flow_px: Array
    """(k,) mean corner error of the flow."""
    features_px: Array
    """(k,) the same of a registration by features."""


def measure() -> list[Metric]:
    """Return, for each kind, the share that is followed, the NEES and the accuracy beside features."""
    metrics = []
    for kind in KINDS:
        if kind.name not in NAMES:
            continue
        name, found = kind.name.replace("75 to 90 % shared", "plain"), outcome(kind, PAIRS, SEED)
        count = 8 * len(found.nees)
        band = float(chi2.ppf(0.025, count) / count), float(chi2.ppf(0.975, count) / count)
        ratio = float(np.median(found.flow_px) / np.median(found.features_px))
        each = f"{np.median(found.flow_px):.3f} over {np.median(found.features_px):.3f} px, medians"
        metrics += [
            at_least(f"{name}: pairs that the flow follows", 100 * found.followed / PAIRS, "%", 90),
            within(f"{name}: mean NEES of the corners", float(found.nees.mean()), "", band),
            at_most(f"{name}: corner error of the flow over that of features", ratio, "x", 1.0, each),
        ]
    return metrics


def outcome(kind: Kind, pairs: int, seed: int) -> Outcome:
    """Render the pairs, follow them by flow, and register them by features."""
    rng, recipe = np.random.default_rng(seed), load_recipe(kind.floor)
    assert recipe.camera is not None
    camera = recipe.camera.camera()
    poses = np.array([pair_of(camera, recipe.world.extent_m, rng) for _ in range(pairs)]).reshape(-1, 4, 4)
    film = filmed(kind, recipe, poses, seed)
    extract = Extractor(PipelineConfig().features.for_width(camera.size_px[0]))
    corners, homography, gates = camera.corners_px, HomographyConfig(), GateConfig()
    rows = []
    for n in range(0, 2 * pairs, 2):
        image, later, truth = film(n), film(n + 1), homography_between(camera, *poses[n : n + 2])
        expected = Expectation(transfer(truth, corners) + rng.normal(0, OFF_PX, 2), 0.0)
        features = extract(image, camera)
        template = FlowTemplate.of(image, features, camera)
        flow = template.register(0, 1, later, None, expected, homography, gates)
        matched = register(0, 1, features, extract(later, camera), camera, homography, gates)
        if flow is not None and matched.ok:
            error, other = (corner_error(found, truth, corners) for found in (flow, matched))
            nees = error @ np.linalg.solve(flow.corner_covariance, error) / len(error)
            rows.append((nees, np.abs(error).mean(), np.abs(other).mean()))
    return Outcome(len(rows), *np.array(rows).reshape(-1, 3).T)


def corner_error(found: Registration, truth: Array, corners_px: Array) -> Array:
    """Return (8,) px, the errors of the transferred corners."""
    return np.asarray((transfer(found.i_H_j, corners_px) - transfer(truth, corners_px)).ravel())


def pair_of(camera: Camera, extent_m: tuple[float, float, float, float], rng: np.random.Generator) -> Array:
    """Return (2, 4, 4) poses of a keyframe and a later picture over the floor."""
    x0, y0, x1, y1 = extent_m
    while True:
        height = rng.uniform(0.6, 1.2)
        x, y = (rng.uniform(a + 0.5 * height, b - 0.5 * height) for a, b in ((x0, x1), (y0, y1)))
        yaw, way, reach = rng.uniform(-np.pi, np.pi), rng.uniform(-np.pi, np.pi), rng.uniform(0, 0.5) * height
        w_T_b = np.tile(np.eye(4), (2, 1, 1))
        for k in range(2):
            turn = [yaw + k * rng.normal(0, TURN_RAD), *rng.normal(0, TILT_RAD, 2)]
            w_T_b[k, :3, :3] = Rotation.from_euler("ZYX", turn).as_matrix()
            w_T_b[k, :2, 3] = x + k * reach * np.cos(way), y + k * reach * np.sin(way)
            w_T_b[k, 2, 3] = height * (1 + k * rng.normal(0, CLIMB))
        if SHARED[0] < overlap(homography_between(camera, *w_T_b), camera) < SHARED[1]:
            return w_T_b
