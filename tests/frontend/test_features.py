"""Features of each kind: positions, masks and limits."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from frontend.camera import Camera
from frontend.features import Extractor, FeatureConfig, FeatureKind
from frontend.matching import match
from frontend.opencv_features import FeatureUnavailableError
from tests.frontend.floor_pairs import CAMERA, FISHY, texture

KINDS: tuple[FeatureKind, ...] = ("sift", "orb", "orb-teblid", "akaze")


def camera_of(width: int, height: int) -> Camera:
    return Camera((width, width), ((width - 1) / 2, (height - 1) / 2), (width, height))


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_finds_describes_and_repeats(kind: FeatureKind) -> None:
    picture = texture(np.random.default_rng(1), 320, 240)
    one = Extractor(FeatureConfig(kind))(picture, CAMERA)
    again = Extractor(FeatureConfig(kind))(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR), CAMERA)
    assert 300 < len(one) <= 500
    assert one.pixel.shape == (len(one), 2)
    assert one.descriptor.shape[0] == len(one)
    np.testing.assert_array_equal(one.pixel, again.pixel)
    np.testing.assert_array_equal(one.descriptor, again.descriptor)
    assert (one.pixel > -0.5).all()
    assert (one.pixel < np.array([319.5, 239.5])).all()
    if kind == "sift":
        assert one.descriptor.dtype == np.float32
        np.testing.assert_allclose(np.linalg.norm(one.descriptor, axis=1), 1.0, atol=1e-5)
    else:
        assert one.descriptor.dtype == np.uint8


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("width", "height", "max_side"), [(320, 240, 1400), (503, 347, 1400), (701, 503, 450)]
)
def test_picture_turned_by_half_maps_features_onto_themselves(
    kind: FeatureKind, width: int, height: int, max_side: int
) -> None:
    picture = texture(np.random.default_rng(width), width, height)
    camera, extract = camera_of(width, height), Extractor(FeatureConfig(kind, 1000, max_side))
    one, turned = extract(picture, camera), extract(np.ascontiguousarray(picture[::-1, ::-1]), camera)
    pairs = match(one, turned)
    bias = (one.pixel[pairs[:, 0]] + turned.pixel[pairs[:, 1]] - [width - 1, height - 1]) / 2
    bias = bias[np.abs(bias).max(axis=1) < 3]  # the rest are mismatches
    assert len(bias) > 300
    np.testing.assert_allclose(np.median(bias, axis=0), 0, atol=1e-3)
    np.testing.assert_allclose(bias.mean(axis=0), 0, atol=0.015)


@pytest.mark.parametrize(
    ("kind", "std_px"),
    [("sift", (0.02, 0.15)), ("orb", (0.4, 0.9)), ("orb-teblid", (0.4, 0.9)), ("akaze", (0.15, 0.6))],
)
def test_positions_agree_with_a_coarser_picture_of_the_same_floor(
    kind: FeatureKind, std_px: tuple[float, float]
) -> None:
    """Both pictures are area means of one fine texture: no interpolation decides where a pixel is."""
    errors = []
    for seed in range(2):
        fine = cv2.resize(
            texture(np.random.default_rng(seed), 480, 360), (1440, 1080), interpolation=cv2.INTER_CUBIC
        )
        a = Extractor(FeatureConfig(kind, 2000))(
            cv2.resize(fine, (480, 360), interpolation=cv2.INTER_AREA), camera_of(480, 360)
        )
        b = Extractor(FeatureConfig(kind, 2000))(
            cv2.resize(fine, (320, 240), interpolation=cv2.INTER_AREA), camera_of(320, 240)
        )
        pairs = match(a, b)
        error = (a.pixel[pairs[:, 0]] + 0.5) / 1.5 - 0.5 - b.pixel[pairs[:, 1]]
        errors.append(error[np.abs(error).max(axis=1) < 3])
    error = np.concatenate(errors)
    assert len(error) > 500
    assert np.abs(error.mean(axis=0)).max() < 0.06
    assert std_px[0] < error.std() < std_px[1]


def test_sift_predicts_its_position_errors() -> None:
    """Noise of 6 grey levels, twice, over a floor whose contrast grows from left to right."""
    rng = np.random.default_rng(4)
    floor = 128 + (texture(rng, 480, 360) - 128.0) * np.linspace(0.3, 1.0, 480)
    camera, extract = camera_of(480, 360), Extractor(FeatureConfig("sift", 2000))
    a, b = (
        extract(np.clip(floor + rng.normal(0, 6, floor.shape), 0, 255).astype(np.uint8), camera)
        for _ in range(2)
    )
    pairs = match(a, b)
    off = np.linalg.norm(a.pixel[pairs[:, 0]] - b.pixel[pairs[:, 1]], axis=1)
    predicted = np.hypot(a.points.spread[pairs[:, 0]], b.points.spread[pairs[:, 1]])
    assert np.median(a.points.spread) == pytest.approx(1.0)
    low, high = np.quantile(predicted, [0.25, 0.75])
    assert np.median(off[predicted > high]) > 1.4 * np.median(off[predicted < low])


def test_relative_std_grows_with_the_magnification_of_the_lens() -> None:
    picture = texture(np.random.default_rng(5), *FISHY.size_px)
    distorted = Extractor()(picture, FISHY)
    radius = np.linalg.norm(distorted.pixel - np.array(FISHY.center_px), axis=1)
    out, middle = (
        distorted.points.spread[radius > np.quantile(radius, 0.8)],
        distorted.points.spread[radius < np.median(radius)],
    )
    grown = FISHY.magnification(distorted.pixel)[radius > np.quantile(radius, 0.8)]
    assert np.median(out) / np.median(middle) == pytest.approx(np.median(grown), rel=0.15)


@pytest.mark.parametrize("kind", KINDS)
def test_reduced_picture_gives_positions_at_full_size(kind: FeatureKind) -> None:
    fine = cv2.GaussianBlur(texture(np.random.default_rng(4), 900, 675, 4.0), (0, 0), 2.0)
    mask = np.zeros((675, 900), np.uint8)
    mask[100:500, 200:700] = 255
    full = Extractor(FeatureConfig(kind, 2000))(fine, camera_of(900, 675))
    reduced = Extractor(FeatureConfig(kind, 2000, 450))(fine, camera_of(900, 675), mask)
    assert len(reduced) > 50
    assert (reduced.pixel > [197, 97]).all()
    assert (reduced.pixel < [703, 503]).all()
    pairs = match(full, reduced)
    error = full.pixel[pairs[:, 0]] - reduced.pixel[pairs[:, 1]]
    error = error[np.abs(error).max(axis=1) < 5]
    assert len(error) > 30
    assert np.abs(np.median(error, axis=0)).max() < 0.25


def test_picture_that_is_reduced_already_gives_the_same_features() -> None:
    picture, camera = texture(np.random.default_rng(6), 900, 676), camera_of(900, 676)
    mask = np.full((676, 900), 255, np.uint8)
    mask[:, :300] = 0
    smaller = cv2.resize(picture, (450, 338), interpolation=cv2.INTER_AREA)
    extract = Extractor(FeatureConfig("sift", 500, 450))
    whole, reduced = extract(picture, camera, mask), extract(smaller, camera, mask)
    assert len(whole) > 300
    np.testing.assert_array_equal(reduced.pixel, whole.pixel)
    np.testing.assert_array_equal(reduced.descriptor, whole.descriptor)


@pytest.mark.parametrize("kind", KINDS)
def test_mask_is_respected(kind: FeatureKind) -> None:
    picture = texture(np.random.default_rng(2), 320, 240)
    mask = np.zeros((240, 320), np.uint8)
    mask[:, :160] = 255
    seen = Extractor(FeatureConfig(kind))(picture, CAMERA, mask).pixel
    assert len(seen) > 100
    assert (seen[:, 0] < 161.5).all()  # positions are refined by up to a pixel after the mask
    assert len(Extractor(FeatureConfig(kind))(picture, CAMERA, np.zeros_like(mask))) == 0


def faded(contrast: NDArray[np.float64]) -> NDArray[np.uint8]:
    """A texture whose contrast differs from column to column (320,)."""
    noise = texture(np.random.default_rng(3), 320, 240).astype(float) - 125
    return np.clip(125 + noise * contrast, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("kind", ["sift", "akaze"])
def test_limit_keeps_the_strongest(kind: FeatureKind) -> None:
    """Contrast fades a little from left to right: the strongest are on the left."""
    picture = faded(np.linspace(1.0, 0.8, 320))
    many = Extractor(FeatureConfig(kind, 2000))(picture, CAMERA)
    few = Extractor(FeatureConfig(kind, 400))(picture, CAMERA)
    assert 100 < len(few) <= 400 < len(many)
    assert few.pixel[:, 0].mean() < many.pixel[:, 0].mean() - 5


def test_a_textured_object_leaves_features_for_the_floor() -> None:
    """A third of the picture has five times the contrast; it holds no more than half of the features."""
    picture = faded(np.where(np.arange(320) < 107, 1.0, 0.2))
    found = Extractor(FeatureConfig("sift", 200))(picture, CAMERA)
    assert len(found) > 120
    assert (found.pixel[:, 0] < 107).mean() < 0.5
    both = np.column_stack([found.pixel, found.descriptor.astype(float)])
    assert len(np.unique(both.round(3), axis=0)) == len(found), "found twice"


@pytest.mark.parametrize("kind", ["sift", "orb"])
@pytest.mark.parametrize("blur_px", [0.0, 6.0])
def test_features_do_not_depend_on_the_pictures_before(kind: FeatureKind, blur_px: float) -> None:
    """Nor on where arrays lie in memory, nor on a mask that hides nothing."""
    picture = texture(np.random.default_rng(8), 320, 240)
    if blur_px:
        picture = cv2.GaussianBlur(picture, None, blur_px).astype(np.uint8)
    extract, crowded = Extractor(FeatureConfig(kind, 150)), faded(np.where(np.arange(320) < 107, 1.0, 0.2))
    first = extract(picture, CAMERA)
    extract(crowded, CAMERA)
    after, masked = extract(picture, CAMERA), extract(picture, CAMERA, np.full((240, 320), 255, np.uint8))
    assert len(first) > 20
    for other in (after, masked):
        np.testing.assert_array_equal(other.pixel, first.pixel)
        np.testing.assert_array_equal(other.descriptor, first.descriptor)
        np.testing.assert_array_equal(other.points.spread, first.points.spread)


@pytest.mark.parametrize("kind", ["sift", "orb", "orb-teblid"])
def test_masked_features_do_not_use_up_the_limit(kind: FeatureKind) -> None:
    """Detectors apply their limit before the mask."""
    picture = faded(np.where(np.arange(320) < 160, 1.0, 0.3))
    mask = np.full((240, 320), 255, np.uint8)
    mask[:, :160] = 0
    found = Extractor(FeatureConfig(kind, 150))(picture, CAMERA, mask)
    assert len(found) > 120
    assert (found.pixel[:, 0] > 155).all()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shape", [(1, 1), (1, 4000), (7, 300), (40, 40), (240, 320)])
def test_featureless_and_tiny_pictures_give_none(kind: FeatureKind, shape: tuple[int, int]) -> None:
    extract = Extractor(FeatureConfig(kind))
    camera = camera_of(*shape[::-1])
    nothing = extract(np.full(shape, 90, np.uint8), camera)
    assert len(nothing) == 0
    full = extract(texture(np.random.default_rng(0), 320, 240), CAMERA)
    assert nothing.descriptor.shape == (0, full.descriptor.shape[1])
    assert nothing.descriptor.dtype == full.descriptor.dtype
    assert len(match(nothing, full)) == len(match(full, nothing)) == 0


def test_positions_are_undistorted() -> None:
    picture = texture(np.random.default_rng(5), 320, 240)
    plain, lens = (Extractor()(picture, camera) for camera in (CAMERA, FISHY))
    off = np.linalg.norm(lens.pixel[:, None] - FISHY.undistort(plain.pixel), axis=2).min(axis=1)
    assert np.median(off) < 0.3
    assert np.abs(FISHY.undistort(plain.pixel) - plain.pixel).max() > 3


def test_surf_error_names_the_cause_and_a_remedy() -> None:
    with pytest.raises(FeatureUnavailableError, match=r"surf.*OpenCV build.*sift"):
        Extractor(FeatureConfig("surf"))
    with pytest.raises(FeatureUnavailableError, match="choose sift, orb"):
        Extractor(FeatureConfig("sfit"))  # type: ignore[arg-type]


def test_number_of_features_grows_with_the_width_up_to_the_reduction() -> None:
    config = FeatureConfig(max_features=500, max_side_px=1400)
    widths = (100, 500, 1000, 1400, 5000)
    assert [config.for_width(w).max_features for w in widths] == [500, 500, 1000, 1400, 1400]


@pytest.mark.parametrize(
    ("size_px", "cores", "at_once"),
    [((320, 240), 2, 2), ((320, 240), 16, 16), ((4000, 3000), 16, 8), ((4000, 3000), 1, 1)],
)
def test_pictures_searched_at_once_are_limited_by_cores_and_memory(monkeypatch, size_px, cores, at_once):
    """Photographs are reduced to 1200 x 900 pixels: eight of them take 1 GB."""
    monkeypatch.setattr("frontend.features.usable_cores", lambda: cores)
    assert FeatureConfig().searched_at_once(size_px) == at_once
