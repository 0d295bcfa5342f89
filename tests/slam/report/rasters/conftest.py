"""What tests of raster files share."""

from __future__ import annotations

import pytest


@pytest.fixture
def no_quality_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the picture of the quality empty: drawing it is most of the work on a small mosaic.

    Tests without this fixture draw it, with metres and without.
    """
    monkeypatch.setattr("slam.report.rasters.quality.quality_picture", lambda *_: b"")
