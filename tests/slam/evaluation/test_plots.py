"""The pictures: written whole, of any evaluation, with what they are about in them."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image

from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.geodesy import GeoOrigin
from slam.core.streams import Gps
from slam.evaluation import evaluate
from slam.evaluation.plots import error_figure, trajectory_figure, write_plots
from slam.report.tables.evaluation import accuracy_tables
from tests.slam.evaluation.scene import disturbed, estimate_of, flight_of, smooth_poses

STD = np.array([0.002, 0.002, 0.005, 0.01, 0.01, 0.005])
P = np.tile(np.diag(STD**2), (50, 1, 1))


@pytest.fixture
def evaluation():
    rng = np.random.default_rng(0)
    truth = smooth_poses(rng, 50)
    landmarks = {"A": truth[5, :3, 3] * [1, 1, 0], "$B_": truth[40, :3, 3] * [1, 1, 0]}
    chain = truth.copy()
    chain[:, :3, 3] *= 1.2
    chain[45:] = np.nan
    estimate = estimate_of(disturbed(rng, truth, STD), covariances=P, chain_w_T_b=chain)
    return evaluate(estimate, flight_of(truth, landmarks=landmarks))


def test_two_pictures_appear_and_nothing_else(evaluation, tmp_path):
    paths = write_plots(evaluation, tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted(paths)
    for path in paths:
        with Image.open(path) as picture:
            assert min(picture.size) > 400
            assert len(np.unique(np.asarray(picture.convert("L")))) > 20


def test_the_top_view_shows_all_maps_and_the_bars_every_pair(evaluation):
    top, bars = trajectory_figure(evaluation).axes
    labels = [text.get_text() for text in top.get_legend().get_texts()]
    assert [label.split(",")[0] for label in labels] == [
        "chain of homographies",
        "truth",
        "without loops",
        "with loops",
    ]
    assert [label.get_text() for label in bars.get_xticklabels()] == [r"A-\$B\_".replace(r"\_", "_")]
    assert len(bars.patches) == 3


def test_the_error_picture_holds_the_band_and_the_nees(evaluation):
    figure = error_figure(evaluation)
    assert len(figure.axes) == 4
    band = figure.axes[0].collections[0].get_paths()[0].get_extents()
    assert band.ymax == pytest.approx(2e3 * evaluation.tracks.std_m[:, 0].max())
    line = figure.axes[2].lines[0].get_ydata()
    expected = 1e3 * (evaluation.tracks.loops_m - evaluation.tracks.reference_m)[:, 2]
    np.testing.assert_allclose(line, expected)


def test_figures_stand_as_plain_numbers_and_fill_their_axes(evaluation):
    _, bars = trajectory_figure(evaluation).axes
    nees = error_figure(evaluation).axes[-1]
    for axes in (bars, nees):
        axes.figure.canvas.draw()
        ticks = [tick.get_text() for minor in (False, True) for tick in axes.get_yticklabels(minor=minor)]
        assert len(ticks) > 2
        assert all(re.fullmatch(r"[0-9.]*", tick) for tick in ticks)
    assert max(bar.get_height() for bar in bars.patches) > 0.8 * bars.get_ylim()[1]


def test_no_map_hides_another(evaluation):
    top, _ = trajectory_figure(evaluation).axes
    widths = [line.get_linewidth() for line in top.lines[:4]]
    assert all(below > 1.4 * above for below, above in pairwise(widths))


def test_errors_too_small_to_be_seen_are_drawn_enlarged_and_said_to_be(evaluation):
    """Millimetres on a map of metres: by one factor, told in the legend; large ones are drawn as they are."""
    tracks = evaluation.tracks
    off = tracks.loops_m - tracks.reference_m

    def drawn(size: float) -> tuple[str, np.ndarray]:
        sized = {
            "loops_m": tracks.reference_m + size * off,
            "odometry_m": tracks.reference_m + 0.5 * size * off,
        }
        top = trajectory_figure(replace(evaluation, tracks=replace(tracks, **sized))).axes[0]
        line = next(each for each in top.lines if each.get_label().startswith("with loops"))
        return line.get_label(), line.get_xydata() - tracks.reference_m[:, :2]

    label, shown = drawn(0.01)
    factor = float(re.search(r"error drawn ([0-9]+) x", label)[1])
    assert factor >= 50
    np.testing.assert_allclose(shown, factor * 0.01 * off[:, :2], atol=1e-9)
    extent = np.ptp(tracks.reference_m[:, :2], axis=0).max()
    assert 0.02 * extent < np.linalg.norm(shown, axis=1).max() <= 0.05 * extent
    label, shown = drawn(extent / np.abs(off).max())
    assert label == "with loops"
    np.testing.assert_allclose(shown, extent / np.abs(off).max() * off[:, :2], atol=1e-9)


def test_a_map_without_metres_is_judged_by_its_shape(evaluation):
    shape = replace(evaluation, metric=False)
    title = trajectory_figure(shape).axes[0].get_title()
    assert title.endswith("aligned with scale")
    assert "rigidly" not in title
    rows = accuracy_tables(shape)[-1].rows
    assert rows[0][0] == "lengths of the map"
    assert "aligned with scale" in rows[0][1]
    assert accuracy_tables(evaluation)[-1].rows[0][0] != rows[0][0]


def test_gps_without_altitude_has_two_error_panels_and_no_nees(tmp_path):
    poses = smooth_poses(np.random.default_rng(1), 20, size_m=30.0)
    fixes = Gps(np.arange(20) * 0.25, np.full(20, 48.0), 11.0 + 1e-5 * np.arange(20), np.full(20, np.nan))
    flight = Flight(name="outdoors", epoch_ns=estimate_of(poses).epoch_ns, gps=fixes)
    found = evaluate(estimate_of(poses, origin=GeoOrigin(48.0, 11.0, 0.0)), flight)
    assert len(error_figure(found).axes) == 2
    assert len(write_plots(found, tmp_path)) == 2


def test_no_global_state_is_touched(evaluation):
    from matplotlib import _pylab_helpers

    before = dict(_pylab_helpers.Gcf.figs)
    trajectory_figure(replace(evaluation, landmarks=()))
    assert before == dict(_pylab_helpers.Gcf.figs)


def test_a_place_that_cannot_be_written_is_one_line(evaluation, tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError) as refused:
        write_plots(evaluation, tmp_path / "file")
    assert "\n" not in str(refused.value)
    assert (tmp_path / "file").read_text() == "x"
