"""Pictures of a report: the path from above, and the heights of the camera."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from backend.measurements import LinkCheck, Rejection
from slam.core.estimate import LoopVerdict
from slam.report.gaps import Gap
from slam.report.pictures.path import altitude_picture, trajectory_picture
from slam.report.pictures.path_over_time import laps, path_over_time
from tests.slam.made_estimate import made_estimate


def test_hundreds_of_rejected_loops_do_not_bury_the_path():
    estimate = made_estimate()
    wrong = tuple(LoopVerdict(k % 29, 30 + k % 30, Rejection(LinkCheck.GRAPH, "9 sigma")) for k in range(600))
    red = [_share_of(trajectory_picture(replace(estimate, loops=loops))) for loops in (wrong[:50], wrong)]
    assert red[1] < 2 * red[0]


def test_the_band_of_heights_says_how_wide_it_is_and_can_be_seen():
    """Tenths of a millimetre on a height of a metre are no wider than a line."""
    png = np.asarray(Image.open(io.BytesIO(altitude_picture(made_estimate(sigma_m=0.02)))).convert("RGB"))
    assert (np.abs(png.astype(int) - [0xF0, 0xC5, 0x66]).sum(axis=2) < 30).mean() > 0.02


def test_the_band_of_heights_is_open_over_a_stretch_without_pictures():
    """Its edges between the keyframes at both ends would claim an uncertainty that nobody computed."""
    estimate = made_estimate(sigma_m=0.02)
    whole, torn = (
        np.asarray(Image.open(io.BytesIO(altitude_picture(estimate, gaps))).convert("RGB")).astype(int)
        for gaps in ((), (Gap(10, 50, 3.0, True, ((0.0, 0.0), (3.0, 0.0)), 1.0),))
    )
    band = [(np.abs(png - [0xF0, 0xC5, 0x66]).sum(axis=2) < 30).sum() for png in (whole, torn)]
    assert 0 < band[1] < band[0]


def _share_of(png: bytes) -> float:
    """Of what is neither grey nor blue: dashed lines in red and pale red."""
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)[:850]
    return float((pixels[..., 0] - pixels[..., 2] > 20).mean())


def test_ellipses_lie_along_the_uncertain_direction():
    """A flight that knows x and not y: the picture differs from one that knows y and not x."""
    estimate = made_estimate()
    wide = estimate.covariances.copy()
    wide[:, 3, 3], wide[:, 4, 4] = 1e-2, 1e-6
    tall = estimate.covariances.copy()
    tall[:, 3, 3], tall[:, 4, 4] = 1e-6, 1e-2
    purple = [_extent_of_purple(trajectory_picture(replace(estimate, covariances=c))) for c in (wide, tall)]
    assert purple[0][0] > purple[1][0], "wider where x is not known"
    assert purple[1][1] > purple[0][1], "taller where y is not known"


@pytest.mark.parametrize(
    "sigma_m", [1e-5, *(pytest.param(m, marks=pytest.mark.slow) for m in (0.01, 1.0)), 100.0]
)
def test_ellipses_are_drawn_at_a_size_that_can_be_read(sigma_m):
    """Whatever their true size: neither points nor a tangle that hides the path."""
    covariances = np.tile(np.diag([1e-5] * 3 + [sigma_m**2] * 3), (60, 1, 1))
    png = trajectory_picture(replace(made_estimate(), covariances=covariances))
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)[:850]
    share = (np.abs(pixels - [0xCC, 0x79, 0xA7]).sum(axis=2) < 30).mean()
    assert 0.001 < share < 0.02


def _extent_of_purple(png: bytes) -> tuple[int, int]:
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)[:850]
    rows, columns = np.nonzero(np.abs(pixels - [0xCC, 0x79, 0xA7]).sum(axis=2) < 30)
    return int(np.ptp(columns)), int(np.ptp(rows))


@pytest.mark.parametrize("times", [1, 3])
def test_laps_are_counted_by_the_length_of_the_way_around(times):
    turn = np.linspace(0.0, 2 * np.pi * times, 200)
    assert laps(np.column_stack([4 * np.cos(turn), np.sin(turn)])) == times
    assert laps(np.zeros((5, 2))) == 1


@pytest.mark.parametrize("width", [0.2, 1.0, 5.0])
def test_laps_of_any_shape_have_a_panel_each(width):
    estimate, turn = made_estimate(), np.linspace(0, 4 * np.pi, 60)
    w_T_b = estimate.w_T_b.copy()
    w_T_b[:, 0, 3], w_T_b[:, 1, 3] = width * np.cos(turn), np.sin(turn)
    size = Image.open(io.BytesIO(path_over_time(replace(estimate, w_T_b=w_T_b)))).size
    assert size[0] > size[1]  # two panels side by side


def test_the_path_over_time_has_the_colours_of_begin_and_end():
    png = path_over_time(made_estimate(), [Gap(3, 4, 1.0, True, ((0.0, 0.0), (1.0, 0.0)), 0.5)])
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)
    for colour in ([0x44, 0x01, 0x54], [0xFD, 0xE7, 0x25]):  # the ends of viridis
        assert (np.abs(pixels - colour).sum(axis=2) < 30).mean() > 5e-4


@pytest.mark.parametrize("across", [0.2, 1.0, 4.0])
def test_several_laps_are_drawn_whatever_the_shape_of_the_path(across):
    """Photographs of a kite, in no order: panels that share their axes cannot be stretched."""
    estimate = made_estimate()
    poses = estimate.w_T_b.copy()
    poses[:, :2, 3] = np.random.default_rng(0).uniform(-1, 1, (len(poses), 2)) * [1.0, across]
    assert laps(poses[:, :2, 3]) > 3
    drawn = np.asarray(Image.open(io.BytesIO(path_over_time(replace(estimate, w_T_b=poses)))))
    assert drawn.size
