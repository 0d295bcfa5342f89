"""Where the accuracies of datums are read from."""

from __future__ import annotations

import math
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest
import rasterio
from rasterio.crs import CRS

from slam.io.datum_accuracy import datum_accuracy_m

LONDON_DEG = (-0.13, 51.5)


def test_a_database_that_the_environment_names_comes_first(tmp_path, monkeypatch):
    folder = tmp_path / "proj data"
    folder.mkdir()
    shutil.copy(Path(rasterio.__file__).parent / "proj_data/proj.db", folder)
    with closing(sqlite3.connect(folder / "proj.db")) as database, database:
        database.execute("PRAGMA recursive_triggers = off")
        database.execute(
            "UPDATE helmert_transformation_table SET accuracy = 7.5 WHERE source_crs_code = '4277'"
        )
    monkeypatch.setenv("PROJ_DATA", f"{tmp_path / 'none'}:{folder}")
    assert datum_accuracy_m(CRS.from_epsg(27700), *LONDON_DEG) == 7.5


def test_without_a_database_the_accuracy_is_unknown(monkeypatch):
    monkeypatch.setattr(Path, "is_file", lambda path: False)
    assert math.isnan(datum_accuracy_m(CRS.from_epsg(27700), *LONDON_DEG))


@pytest.mark.parametrize(("code", "accuracy_m"), [(27700, 2.0), (4326, 0.0)])
def test_the_database_of_the_package_serves_without_an_environment(code, accuracy_m, monkeypatch):
    monkeypatch.delenv("PROJ_DATA", raising=False)
    assert datum_accuracy_m(CRS.from_epsg(code), *LONDON_DEG) == accuracy_m
