"""The words about the coordinates of a map's rasters."""

from __future__ import annotations

import pytest

from slam.core.geodesy import GeoOrigin
from slam.report.coordinates import plane_text
from tests.slam.io.exports.made_map import made_map, pose


@pytest.mark.parametrize(
    ("latitude_deg", "grid"),
    [(47.0, "for UTM, EPSG:32632,"), (85.0, "for UPS, EPSG:5041,"), (-81.0, "for UPS, EPSG:5042,")],
)
def test_the_grid_of_the_place_is_named(latitude_deg, grid):
    assert grid in plane_text(made_map(pose(), origin=GeoOrigin(latitude_deg, 8.5, 0.0)))
