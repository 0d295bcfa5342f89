"""The least certain ground of a mosaic."""

from __future__ import annotations

import numpy as np

from slam.io.geotiff import Grid, write_bands
from slam.report.rasters.quality import ground_accuracy


def test_the_least_certain_ground_is_the_largest_of_the_second_band(tmp_path):
    std_m = np.full((40, 60), np.nan, np.float32)
    path, grid = tmp_path / "mosaic_quality.tif", Grid(-1.0, 4.0, 0.1, 60, 40)
    others = np.full((40, 60), 9.0, np.float32)
    write_bands(path, grid, {"pictures": others, "position": std_m, "seam": others})
    assert np.isnan(ground_accuracy(path)).all()
    std_m[5:20, 10:50] = 0.01
    std_m[7, 30] = 0.03
    write_bands(path, grid, {"pictures": others, "position": std_m, "seam": others})
    found = ground_accuracy(path)
    np.testing.assert_allclose(found, (0.01, 0.03, -1.0 + 3.05, 4.0 - 0.75), rtol=1e-6)
