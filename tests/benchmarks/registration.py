"""Registration of rendered pairs: which hold, and whether their covariances are right.

Pairs of 320x240 over a floor, any yaw, a few degrees of tilt, by overlap, ratio of heights, light, floor and
blur. The homography of each pair that holds is lifted with the true height of the first and its attitude to a
milliradian, so that the relative pose's covariance is nearly the homography's alone; its NEES is held against
the 95 % band of a mean over as many pairs.
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
from slam.core.flight import Image
from slam.mapping.config import PipelineConfig
from slam.simulation.camera.effects import camera_effects
from slam.simulation.camera.film import Film, film_flight
from slam.simulation.camera.photometry import falloff
from slam.simulation.inverse.camera import vignetting_correction
from slam.simulation.recipe import Recipe, load_recipe
from slam.simulation.terms import CATALOGUE
from tests.benchmarks.metric import Metric, at_least, reported, within

Array = NDArray[np.float64]

PAIRS, SEED = 60, 0
ATTITUDE_STD_RAD = 0.001
TILT_RAD = 0.05
SPEED_M_S = 0.5
"""What blurs."""
USUAL = (0.6, 0.8)


@dataclass(frozen=True)
class Kind:
    """What pairs have in common."""

    name: str
    shared: tuple[float, float] = USUAL
    """Share of the smaller footprint that both show."""
    ratio: float = 1.0
    """Height of the second over the first; where they are alike, give or take a tenth."""
    floor: str = "figure_eight"
    noise_std: float = 2.0
    terms: tuple[tuple[str, tuple[tuple[str, float], ...]], ...] = ()
    taken_out: bool = False
    """The pictures are lit evenly again, as ``--model`` does with a vignetting that is known."""


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
    """What came of the pairs of one kind."""

    held: int
    nees: Array
    """(held,) of the relative poses."""


def measure() -> list[Metric]:
    """Each kind's share of pairs that hold, and their mean NEES."""
    metrics = []
    for kind in KINDS:
        came = outcome(kind, PAIRS, SEED)
        count = len(came.nees)
        band = (float(chi2.ppf(q, 6 * count) / count) for q in (0.025, 0.975))
        told_of = f"median {np.median(came.nees):.1f} (5.3 expected), largest {came.nees.max():.0f}"
        metrics += [
            at_least(f"{kind.name}: pairs that register", 100 * came.held / PAIRS, "%", 90)
            if kind.ratio == 1.0
            else reported(f"{kind.name}: pairs that register", 100 * came.held / PAIRS, "%"),
            within(
                f"{kind.name}: mean NEES of relative poses", float(came.nees.mean()), "", tuple(band), told_of
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

    held: list[tuple[int, Registration]] = []
    for n in range(pairs):
        a, b = (extract(picture(k), camera) for k in (2 * n, 2 * n + 1))
        found = register(0, 1, a, b, camera, homography, GateConfig())
        if found.ok:
            held.append((n, found))
    return Outcome(len(held), np.array(list(nees(held, poses, camera, rng))))


def pair_of(kind: Kind, camera: Camera, recipe: Recipe, rng: np.random.Generator) -> Array:
    """(2, 4, 4) poses over the floor that share what the kind asks for."""
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
    """(3, 3) i_H_j over the floor z = 0."""
    H = np.linalg.inv(camera.floor_H_image(w_T_i)) @ camera.floor_H_image(w_T_j)
    return np.asarray(H / H[2, 2], dtype=float)


def filmed(kind: Kind, recipe: Recipe, poses: Array, seed: int) -> Film:
    """A picture a second, one at each pose, each flown through in the direction of its nose."""
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
    held: list[tuple[int, Registration]], poses: Array, camera: Camera, rng: np.random.Generator
) -> Iterator[float]:
    """Of the lifted relative pose of each pair."""
    for n, found in held:
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
