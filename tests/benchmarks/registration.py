"""Registration of rendered pairs: the share of valid ones, and the consistency of their covariances.

Pairs of 320x240 over a floor differ in overlap, ratio of heights, light, floor and blur, with any yaw and a
few degrees of tilt. Each valid homography is lifted with the true height of the first picture and its
attitude to a milliradian, so the relative pose's covariance is nearly that of the homography alone. Its NEES
is compared with the 95 % band of a mean over as many pairs.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from frontend.camera import Camera
from frontend.features import Extractor
from frontend.gates import GateConfig
from frontend.homography import HomographyConfig
from frontend.lift import lift
from frontend.registration import Registration, overlap, register
from slam.core.streams import Image
from slam.mapping.config import PipelineConfig
from slam.simulation.camera.effects import camera_effects
from slam.simulation.camera.film import Film, film_flight
from slam.simulation.camera.photometry import falloff
from slam.simulation.recipe import Recipe, load_recipe
from slam.simulation.terms import CATALOGUE
from slam.simulation.terms.camera import vignetting_correction
from tests.benchmarks.metric import Metric, at_least, reported, within

Array = NDArray[np.float64]

PAIRS, SEED = 60, 0
ATTITUDE_STD_RAD = 0.001
TILT_RAD = 0.05
SPEED_M_S = 0.5
"""Kind of blur."""
USUAL = (0.6, 0.8)


@dataclass(frozen=True)
class Kind:
    """Common properties of a kind of pairs."""

    name: str
    shared: tuple[float, float] = USUAL
    """Overlap as a share of the smaller footprint."""
    ratio: float = 1.0
    """Ratio of the second height to the first; equal heights vary by a tenth."""
    floor: str = "figure_eight"
    noise_std: float = 2.0
    terms: tuple[tuple[str, tuple[tuple[str, float], ...]], ...] = ()
    taken_out: bool = False
    """Whether vignetting is corrected, as ``--model`` does with a known one."""


def term(name: str, **values: float) -> tuple[tuple[str, tuple[tuple[str, float], ...]], ...]:
    """An effect on pictures."""
    return ((name, tuple(values.items())),)


VIGNETTING = 0.5
KINDS = (
    Kind("30 to 45 % shared", (0.30, 0.45)),
    Kind("45 to 60 % shared", (0.45, 0.60)),
    Kind("60 to 75 % shared", (0.60, 0.75)),
    Kind("75 to 90 % shared", (0.75, 0.90)),
    Kind("twice as high", ratio=2.0),
    Kind("three times as high", ratio=3.0),
    Kind("a third as high", ratio=1 / 3),
    Kind("white balance and gamma", terms=term("exposure_variation", gain=0.15, gamma=0.30, tau=0.0)),
    Kind("vignetting of one half", terms=term("vignetting", a=VIGNETTING)),
    Kind("the same vignetting, known and taken out", terms=term("vignetting", a=VIGNETTING), taken_out=True),
    Kind("exposure of 40 ms", terms=term("motion_blur", exposure=0.04)),
    Kind("noise of 10 grey levels", noise_std=10.0),
    Kind("gym's planks", floor="gym"),
)


@dataclass(frozen=True)
class Outcome:
    """Result of the pairs of one kind."""

    valid: int
    nees: Array
    """(valid,) NEES of the relative poses."""


def measure() -> list[Metric]:
    """Return each kind's share of valid pairs, and their mean NEES."""
    metrics = []
    for kind in KINDS:
        result = outcome(kind, PAIRS, SEED)
        count = len(result.nees)
        band = (float(chi2.ppf(q, 6 * count) / count) for q in (0.025, 0.975))
        spread = f"median {np.median(result.nees):.1f} (5.3 expected), largest {result.nees.max():.0f}"
        metrics += [
            at_least(f"{kind.name}: pairs that register", 100 * result.valid / PAIRS, "%", 90)
            if kind.ratio == 1.0
            else reported(f"{kind.name}: pairs that register", 100 * result.valid / PAIRS, "%"),
            within(
                f"{kind.name}: mean NEES of relative poses",
                float(result.nees.mean()),
                "",
                tuple(band),
                spread,
            ),
        ]
    return metrics


def outcome(kind: Kind, pairs: int, seed: int) -> Outcome:
    """Render, register and lift."""
    rng = np.random.default_rng(seed)
    recipe = load_recipe(kind.floor)
    assert recipe.camera is not None
    camera = recipe.camera.camera()
    poses = np.array([pair_of(kind, camera, recipe, rng) for _ in range(pairs)]).reshape(-1, 4, 4)
    film = filmed(kind, recipe, poses, seed)
    extract = Extractor(PipelineConfig().features.for_width(camera.size_px[0]))
    homography = HomographyConfig().for_width(camera.size_px[0])
    even = vignetting_correction(falloff(camera.size_px, camera.center_px, VIGNETTING))

    def picture(k: int) -> Image:
        return even(film(k)) if kind.taken_out else film(k)

    valid: list[tuple[int, Registration]] = []
    for n in range(pairs):
        a, b = (extract(picture(k), camera) for k in (2 * n, 2 * n + 1))
        found = register(0, 1, a, b, camera, homography, GateConfig())
        if found.ok:
            valid.append((n, found))
    return Outcome(len(valid), np.array(list(nees(valid, poses, camera, rng))))


def pair_of(kind: Kind, camera: Camera, recipe: Recipe, rng: np.random.Generator) -> Array:
    """Return (2, 4, 4) poses over the floor with the overlap of the kind."""
    x0, y0, x1, y1 = recipe.world.extent_m
    while True:
        low = rng.uniform(0.5, 0.7) if kind.ratio != 1.0 else rng.uniform(0.6, 1.2)
        height = np.array([low, low * kind.ratio]) if kind.ratio >= 1 else np.array([low / kind.ratio, low])
        height[1] *= rng.uniform(0.9, 1.1) if kind.ratio == 1.0 else 1.0
        margin = 0.5 * height.max()
        xy = np.array([rng.uniform(a + margin, b - margin) for a, b in ((x0, x1), (y0, y1))])
        reach = rng.uniform(0, 1.2) * height.max()
        way = rng.uniform(-np.pi, np.pi)
        places = xy, xy + reach * np.array([np.cos(way), np.sin(way)])
        w_T_b = np.tile(np.eye(4), (2, 1, 1))
        for T, place, z in zip(w_T_b, places, height, strict=True):
            T[:3, :3] = Rotation.from_euler(
                "ZYX", [rng.uniform(-np.pi, np.pi), *rng.normal(0, TILT_RAD, 2)]
            ).as_matrix()
            T[:3, 3] = *place, z
        H = homography_between(camera, *w_T_b)
        shared = max(overlap(H, camera), overlap(np.linalg.inv(H) / np.linalg.inv(H)[2, 2], camera))
        if kind.shared[0] <= shared <= kind.shared[1] or (kind.ratio != 1.0 and shared > USUAL[0]):
            return w_T_b


def homography_between(camera: Camera, w_T_i: Array, w_T_j: Array) -> Array:
    """Return (3, 3) i_H_j over the floor z = 0."""
    H = np.linalg.inv(camera.floor_H_image(w_T_i)) @ camera.floor_H_image(w_T_j)
    return np.asarray(H / H[2, 2], dtype=float)


def filmed(kind: Kind, recipe: Recipe, poses: Array, seed: int) -> Film:
    """Return one picture a second, one at each pose, each moving along its heading."""
    assert recipe.camera is not None
    world = replace(recipe.world, boxes=(), pylons=())
    terms = {name: {**CATALOGUE[name].neutral, **dict(values)} for name, values in kind.terms}

    def pose_at(times_s: Array) -> Array:
        k = np.clip(np.rint(times_s - 1).astype(int), 0, len(poses) - 1)
        w_T_b = poses[k].copy()
        w_T_b[:, :3, 3] += SPEED_M_S * (times_s - 1 - k)[:, None] * poses[k, :3, 0]
        return w_T_b

    stamps_s = 1.0 + np.arange(len(poses))
    model = replace(recipe.camera, noise_std=kind.noise_std)
    return film_flight(world, (), model, camera_effects(terms), stamps_s, pose_at, stamps_s[-1] + 1, seed)


def nees(
    valid: list[tuple[int, Registration]], poses: Array, camera: Camera, rng: np.random.Generator
) -> Iterator[float]:
    """Return the NEES of the lifted relative pose of each pair."""
    for n, found in valid:
        w_T_i, w_T_j = poses[2 * n], poses[2 * n + 1]
        roll_pitch = Rotation.from_matrix(w_T_i[:3, :3]).as_euler("ZYX")[[2, 1]]
        roll_pitch = roll_pitch + rng.normal(0, ATTITUDE_STD_RAD, 2)
        lifted = lift(
            found.i_H_j[None], found.corner_covariance[None], camera, roll_pitch[None],
            np.full((1, 2), ATTITUDE_STD_RAD),
        )  # fmt: skip
        i_T_j, covariance = lifted.scale(w_T_i[2, 3:4], np.zeros(1))
        error = RigidTransform.from_matrix(
            np.linalg.inv(i_T_j[0]) @ np.linalg.inv(w_T_i) @ w_T_j
        ).as_exp_coords()
        yield float(error @ np.linalg.solve(covariance[0], error))
