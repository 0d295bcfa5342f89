"""Comparison of detectors and descriptors: simulated floors, a hybrid flight, aerial photographs.

Each scene has a dozen pairs of pictures that share 35 to 95 % of the ground, the same for all. The transfer
error is that of the registration's homography against the true poses' (``ardrone2-hybrid``: against
motion capture), over a grid of the common pixels. Photographs have no such truth, so the residual of their
inliers is given. Prints the table under *Features compared* in docs/figures.md.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.features import Extractor, FeatureKind
from frontend.gates import GateConfig
from frontend.homography import HomographyConfig, transfer
from frontend.registration import overlap, register
from slam.core.flight import Flight
from slam.core.streams import Image
from slam.evaluation.association import poses_at
from slam.io.flight_folder import read_flight
from slam.io.photos.import_photos import import_photos
from slam.mapping.config import PipelineConfig
from slam.simulation import simulate
from slam.simulation.recipe import load_recipe
from tests.benchmarks.measured import folder
from tests.benchmarks.metric import Metric, Skipped, at_least, reported

Array = NDArray[np.float64]
KINDS: tuple[FeatureKind, ...] = tuple(kind for kind in get_args(FeatureKind) if kind != "surf")
PAIRS = 12
SHARED = (0.35, 0.95)
GRID = 7
LIGHT = {"gain": 0.15, "gamma": 0.30, "tau": 0.02}


@dataclass(frozen=True)
class Scene:
    """Pairs of pictures with the homographies between them; None where these are unknown."""

    name: str
    camera: Camera
    pairs: tuple[tuple[Image, Image, Array | None], ...]


@dataclass(frozen=True)
class Score:
    """Result of one kind of feature on a scene."""

    held: int
    """Number of pairs that register."""
    error_px: float
    """Median error over these pairs."""
    inliers: float
    """Median number of inliers."""
    ms: float
    """Time for the features of one picture and half a match."""


def measure() -> list[Metric]:
    """Return all scenes. The default must register most pairs, and be the most accurate if truth exists."""
    made = [*simulated(), *measured()]
    scores = {scene.name: {kind: score(scene, kind) for kind in KINDS} for scene in made}
    print("\n".join(table(scores, {scene.name: len(scene.pairs) for scene in made})))
    metrics = []
    for name, by_kind in scores.items():
        for kind, got in by_kind.items():
            said = f"{got.held} of {PAIRS} pairs, {got.inliers:.0f} inliers, {got.ms:.1f} ms a picture"
            metrics.append(reported(f"{name}: {kind}", got.error_px, "px", said))
    default = PipelineConfig().features.kind
    held = {kind: sum(by_kind[kind].held for by_kind in scores.values()) for kind in KINDS}
    error = {kind: float(np.mean([by_kind[kind].error_px for by_kind in scores.values()])) for kind in KINDS}
    totals = ", ".join(f"{kind} {held[kind]} and {error[kind]:.2f} px" for kind in KINDS)
    metrics.append(
        at_least(
            f"pairs that the default ({default}) registers beside the best",
            held[default] / max(held.values()),
            "x",
            1,
            totals,
        )
    )
    return metrics


def table(scores: dict[str, dict[FeatureKind, Score]], pairs: dict[str, int]) -> list[str]:
    """Rows of Markdown: error in px / inliers / pairs that register; the last row is time."""
    lines = [f"| scene | {' | '.join(KINDS)} |", "|---" * (len(KINDS) + 1) + "|"]
    for name, by_kind in scores.items():
        cells = (f"{s.error_px:.2f} px, {s.inliers:.0f}, {s.held}/{pairs[name]}" for s in by_kind.values())
        lines.append(f"| {name} | {' | '.join(cells)} |")
    small = [name for name in scores if "photographs" not in name]
    times = (f"{np.median([scores[name][kind].ms for name in small]):.1f} ms" for kind in KINDS)
    return [*lines, f"| time a picture, median of the scenes of 320x240 | {' | '.join(times)} |"]


def score(scene: Scene, kind: FeatureKind) -> Score:
    """Register all pairs by one kind of feature."""
    width = scene.camera.size_px[0]
    extract = Extractor(replace(PipelineConfig().features, kind=kind).for_width(width))
    homography = HomographyConfig().for_width(width)
    errors, inliers, seconds = [], [], []
    for one, other, i_H_j in scene.pairs:
        began = time.perf_counter()
        a, b = extract(one, scene.camera), extract(other, scene.camera)
        found = register(0, 1, a, b, scene.camera, homography, GateConfig())
        seconds.append((time.perf_counter() - began) / 2)
        if found.ok:
            inliers.append(len(found.matches))
            errors.append(
                found.noise_px if i_H_j is None else transfer_error(found.i_H_j, i_H_j, scene.camera)
            )
    middle = (float(np.median(each)) if each else float("nan") for each in (errors, inliers))
    return Score(len(errors), *middle, 1e3 * float(np.median(seconds)))


def transfer_error(found: Array, true: Array, camera: Camera) -> float:
    """Return the mean distance in px between two transfers of the common pixels."""
    w, h = camera.size_px
    grid = np.stack(np.meshgrid(np.linspace(0, w - 1, GRID), np.linspace(0, h - 1, GRID)), -1).reshape(-1, 2)
    grid = camera.undistort(grid)
    there = transfer(true, grid)
    both = (there >= 0).all(axis=1) & (there[:, 0] < w) & (there[:, 1] < h)
    return float(np.linalg.norm(transfer(found, grid[both]) - there[both], axis=1).mean())


def simulated() -> list[Scene]:
    """Return simulated scenes with blur, white balance and noise, at 320x240."""
    eight, gym = load_recipe("figure_eight"), load_recipe("gym")
    flat = replace(gym, world=replace(gym.world, boxes=(), pylons=()))
    assert eight.camera is not None
    noisy = replace(eight, camera=replace(eight.camera, noise_std=10.0))
    blurred = replace(eight, model=eight.model.with_term("motion_blur", exposure=0.04))
    light = replace(eight, model=eight.model.with_term("exposure_variation", **LIGHT))
    named = {
        "puzzle": eight, "gym's planks": flat,
        "puzzle, exposure of 40 ms": blurred, "puzzle, white balance": light,
        "puzzle, noise of 10 grey levels": noisy,
    }  # fmt: skip
    return [with_truth(name, simulate(recipe, 0)) for name, recipe in named.items()]


def measured() -> list[Scene]:
    """Return the recorded scenes that exist."""
    try:
        hybrid = with_truth("ardrone2-hybrid", read_flight(folder("flights/ardrone2-hybrid")))
        return [hybrid, neighbours("photographs (caliterra)", import_photos(folder("photos/caliterra")))]
    except Skipped:
        return []


def with_truth(name: str, flight: Flight) -> Scene:
    """Draw pairs over the whole flight by their true overlap."""
    frames, camera, truth = flight.frames, flight.camera, flight.truth
    assert frames is not None
    assert camera is not None
    assert truth is not None
    rng = np.random.default_rng(0)
    poses = poses_at(truth, frames.stamps_s)
    chosen: list[tuple[int, int, Array]] = []
    while len(chosen) < PAIRS:
        i = int(rng.integers(len(poses)))
        close = np.flatnonzero(np.linalg.norm(poses[:, :2, 3] - poses[i, :2, 3], axis=1) < poses[i, 2, 3])
        j = int(rng.choice(close))
        i_H_j = np.linalg.inv(camera.floor_H_image(poses[i])) @ camera.floor_H_image(poses[j])
        i_H_j /= i_H_j[2, 2]
        if SHARED[0] < overlap(i_H_j, camera) < SHARED[1]:
            chosen.append((i, j, i_H_j))
    return Scene(name, camera, loaded(flight, chosen))


def neighbours(name: str, flight: Flight) -> Scene:
    """Return pairs of consecutive photographs."""
    assert flight.frames is not None
    assert flight.camera is not None
    first = np.linspace(0, len(flight.frames) - 2, PAIRS).astype(int).tolist()
    return Scene(name, flight.camera, loaded(flight, [(k, k + 1, None) for k in first]))


def loaded(
    flight: Flight, chosen: Sequence[tuple[int, int, Array | None]]
) -> tuple[tuple[Image, Image, Array | None], ...]:
    """Return the pictures of pairs of frames."""
    assert flight.frames is not None
    pairs = []
    for i, j, i_H_j in chosen:
        one, other = flight.frames.load(i), flight.frames.load(j)
        assert one is not None
        assert other is not None
        pairs.append((one, other, i_H_j))
    return tuple(pairs)
