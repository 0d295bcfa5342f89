"""What is told of a lens is weighed against wider priors; the pictures are projected by `made_floor`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.bundle import lens_evidence
from backend.bundle.lens_evidence import log_evidence_of_priors
from backend.bundle.minimise import BundleOptimum
from backend.bundle.refinement import refine
from backend.measurements import FloorTracks
from backend.significance import VERY_STRONG_NATS
from tests.backend.bundle.made_scenes import SEEDS, WRONG_LENS
from tests.backend.made_floor import Scene, make

MAKERS, NOMINAL, ASSUMED = 0.005, 0.03, 0.1
"""Relative standard deviations of a focal length."""
SCENE = replace(WRONG_LENS, keyframes=16, radial=0.0, center_off_px=(0.0, 0.0), tangential=(0.0, 0.0))
SCENE_AS_TOLD = replace(SCENE, focal_ratio=1.0)


def evidence(scene: Scene, seed: int, under: int = -1) -> np.ndarray:
    """Logarithms of the evidence of a maker's focal length, a nominal and an assumed one, less the first.

    ``under``: number of the prior with which the map is made.
    """
    told = [replace(scene.camera, focal_std_ratio=std) for std in (MAKERS, NOMINAL, ASSUMED)]
    made = make(replace(scene, camera=told[under]), seed)
    bundle = refine(made.measurements, made.start, made.floor_z_m)
    found = log_evidence_of_priors(bundle.optimum, told)
    return found - found[0]


def test_a_lens_that_is_as_told_is_not_doubted():
    found = evidence(SCENE_AS_TOLD, 0)
    # What is wider by a factor of k explains the same flight k times less often.
    assert found[1:] == pytest.approx(-np.log([NOMINAL / MAKERS, ASSUMED / MAKERS]), abs=0.4)


@pytest.mark.parametrize("focal_ratio", [0.9, 1.1])
def test_a_wrong_focal_length_is_refuted(focal_ratio: float):
    found = evidence(replace(SCENE, focal_ratio=focal_ratio), 0)
    assert found[2] > found[1] > VERY_STRONG_NATS


@pytest.mark.parametrize("focal_ratio", [0.9, 1.1])
def test_a_map_under_the_told_prior_shows_that_a_wider_one_is_better(focal_ratio: float):
    assert evidence(SCENE_AS_TOLD, 0, under=0).argmax() == 0
    assert evidence(replace(SCENE, focal_ratio=focal_ratio), 0, under=0).argmax() > 0


@pytest.mark.slow
def test_the_evidence_follows_the_size_of_the_error():
    """The wider of two priors is the better one only for errors that the narrower does not expect."""
    assert (
        max(evidence(replace(SCENE, focal_ratio=1.005), seed)[1:].max() for seed in SEEDS) < VERY_STRONG_NATS
    )
    small = [evidence(replace(SCENE, focal_ratio=1.04), seed) for seed in SEEDS]
    assert all(found[1] > max(found[2], VERY_STRONG_NATS) for found in small)


@pytest.mark.slow
def test_points_that_are_seen_twice_tell_no_more(monkeypatch: pytest.MonkeyPatch):
    """Sixteen copies of each point share its errors; the model takes them as independent."""
    scene = replace(SCENE_AS_TOLD, position_std_m=(1e-3, 1e-3))
    told = [replace(scene.camera, focal_std_ratio=std) for std in (MAKERS, ASSUMED)]
    effects = list[float]()
    measure = lens_evidence._design_effect

    def measured(optimum: BundleOptimum, weights: np.ndarray) -> float:
        effects.append(measure(optimum, weights))
        return effects[-1]

    monkeypatch.setattr(lens_evidence, "_design_effect", measured)
    # Copies would count as evidence for another model of the lens too.
    monkeypatch.setattr("backend.bundle.model_selection.fisheye_by_evidence", lambda *_: None)
    for copies in (1, 16):
        for seed in SEEDS:
            made = make(replace(scene, camera=told[-1]), seed)
            copied = replace(made.measurements, tracks=repeated(made.measurements.tracks, copies))
            log_evidence_of_priors(refine(copied, made.start, made.floor_z_m).optimum, told)
    once, often = np.array(effects).reshape(2, -1)
    assert np.median(once) < 1.5
    assert np.median(often) > 3, "positions are not copied, and tell a part of it"


def repeated(tracks: FloorTracks | None, copies: int) -> FloorTracks:
    """The observations, each point under several numbers."""
    assert tracks is not None
    number = np.concatenate([tracks.track + k * (tracks.track.max() + 1) for k in range(copies)])
    keyframe, pixel, std_px = (
        np.concatenate([part] * copies) for part in (tracks.keyframe, tracks.pixel, tracks.std_px)
    )
    return FloorTracks(keyframe, number, pixel, std_px)
