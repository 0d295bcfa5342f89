"""The least certain ground of a mosaic."""

from __future__ import annotations

import numpy as np
import pytest

from frontend.mosaic.quality import MosaicQuality
from slam.io.geotiff import Grid, write_bands
from slam.report.gaps import Gap
from slam.report.rasters.quality import quality_figure, quality_figures


def missing_ground_m2(path, gaps):
    found = quality_figures(path, gaps)
    return found.gap_area_m2, found.hole_beside_m2


def test_the_least_certain_ground_is_the_largest_of_the_second_band(tmp_path):
    std_m = np.full((40, 60), np.nan, np.float32)
    path, grid = tmp_path / "mosaic_quality.tif", Grid(-1.0, 4.0, 0.1, 60, 40)
    others = np.full((40, 60), 9.0, np.float32)
    write_bands(path, grid, {"pictures": others, "position": std_m, "seam": others})
    assert np.isnan(quality_figures(path)[:4]).all()
    std_m[5:20, 10:50] = 0.01
    std_m[7, 30] = 0.03
    seam = np.where(np.isfinite(std_m), np.float32(0.02), np.float32(np.nan))
    seam[12, 20] = 0.5
    write_bands(path, grid, {"pictures": others, "position": std_m, "seam": seam})
    found = quality_figures(path)
    np.testing.assert_allclose(found[:4], (0.01, 0.03, -1.0 + 3.05, 4.0 - 0.75), rtol=1e-6)
    assert found.worst_pictures == 9
    np.testing.assert_allclose(found[5:9], (0.5, -1.0 + 2.05, 4.0 - 1.25, 0.02), rtol=1e-6)


def test_white_areas_inside_of_a_mosaic_are_holes_and_those_around_it_are_its_edge(tmp_path):
    pictures = np.full((40, 60), np.nan, np.float32)
    pictures[5:35, 10:50] = 3.0
    pictures[10:12, 20:25], pictures[30, 40], pictures[5:9, 11] = np.nan, np.nan, np.nan
    path, grid = tmp_path / "mosaic_quality.tif", Grid(-1.0, 4.0, 0.1, 60, 40)
    write_bands(path, grid, {"pictures": pictures, "position": pictures, "seam": pictures})
    found = quality_figures(path)
    assert found.covered_share == np.mean(np.isfinite(pictures))
    assert found.holes == 2, "the third one is open to the edge"
    np.testing.assert_allclose(found.hole_area_m2, 0.11)
    np.testing.assert_allclose((found.hole_x_m, found.hole_y_m), (-1.0 + 2.25, 4.0 - 1.1))


def test_ground_below_a_stretch_without_pictures_is_missing_as_wide_as_a_picture(tmp_path):
    """Also beyond the raster, which ends where the pictures end."""
    pictures = np.full((40, 60), 3.0, np.float32)
    pictures[:, 20:40] = np.nan
    path, grid = tmp_path / "mosaic_quality.tif", Grid(-1.0, 4.0, 0.1, 60, 40)
    write_bands(path, grid, {"pictures": pictures, "position": pictures, "seam": pictures})
    across = Gap(3, 4, 3.0, True, ((0.5, 2.0), (3.5, 2.0)), 1.0)
    assert missing_ground_m2(path, (across,))[0] == pytest.approx(2.0 * 1.0, rel=0.1)
    at_the_edge = Gap(3, 4, 3.0, True, ((0.5, 4.0), (3.5, 4.0)), 1.0)
    assert missing_ground_m2(path, (at_the_edge,))[0] == pytest.approx(2.0 * 1.0 + 1.0 * 0.5, rel=0.1)
    assert missing_ground_m2(path, (across, across)) == missing_ground_m2(path, (across,))
    assert missing_ground_m2(path, (Gap(3, 4, 3.0, False, across.ends_m, 1.0),)) == (0.0, 0.0)


def test_a_hole_below_a_stretch_without_pictures_is_missing_once(tmp_path):
    pictures = np.full((40, 60), 3.0, np.float32)
    pictures[10:30, 20:40] = np.nan  # 2 m x 2 m, between rows of pictures
    path, grid = tmp_path / "mosaic_quality.tif", Grid(-1.0, 4.0, 0.1, 60, 40)
    write_bands(path, grid, {"pictures": pictures, "position": pictures, "seam": pictures})
    across = Gap(3, 4, 3.0, True, ((0.5, 2.0), (3.5, 2.0)), 1.0)
    below_m2, beside_m2 = missing_ground_m2(path, (across,))
    assert below_m2 == pytest.approx(2.0 * 1.0, rel=0.1)
    assert below_m2 + beside_m2 == pytest.approx(4.0)
    assert missing_ground_m2(path, ()) == (0.0, pytest.approx(4.0))


def test_the_darkest_ground_is_the_one_that_the_report_states():
    grid, ends = Grid(0.0, 2.0, 0.1, 30, 20), []
    for largest in (0.02, 0.6):
        pictures, std_m, seam = (np.full((20, 30), value, np.float32) for value in (3, 0.001, largest / 2))
        std_m[4, 5], seam[0, 0] = 0.004, largest
        figure = quality_figure(MosaicQuality(0.1, pictures, std_m, seam), grid)
        _, position, brightness = (axes.images[0] for axes in figure.axes[:3])
        np.testing.assert_allclose(position.get_clim(), (0.0, 4.0), rtol=1e-6)
        ends.append(brightness.get_clim())
        rings = [[line.get_xydata().tolist() for line in axes.lines] for axes in figure.axes[:3]]
        np.testing.assert_allclose(rings[1:], [[[[0.55, 1.55]]] * 2, [[[0.05, 1.95]]] * 2])
        assert not rings[0]
    np.testing.assert_allclose(ends, [(0, 2), (0, 60)], rtol=1e-6)
