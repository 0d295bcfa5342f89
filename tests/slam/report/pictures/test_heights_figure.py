"""The picture of the heights of the ground stands on the page, with what it shows and how good it is."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from frontend.elevation import Elevation
from slam.core.estimate import GroundFacts
from slam.core.summary import summarise
from slam.io.geotiff import Grid
from slam.report.answers.heights import heights
from slam.report.facts import gather
from slam.report.floor_scatter import floor_scatter
from slam.report.optimize_report import Mosaics, render
from slam.report.pictures.heights import heights_figure_words
from slam.report.rasters.elevation import elevation_picture
from tests.slam.made_estimate import made_estimate, made_flight

MEASURED = GroundFacts(
    misregistration_px=(0.1, 0.4), over_floor_px=(0.4, 2.0), relief_share=0.3, filled_share=0.125,
    lowest_m=-1.5, highest_m=4.0, height_std_m=0.05,
)  # fmt: skip


def test_the_heights_of_the_ground_are_on_the_page(tmp_path, no_figures):
    path, estimate = tmp_path / "elevation.png", made_estimate()
    Image.fromarray(np.full((40, 50, 3), 128, np.uint8)).save(path)
    pages = [
        render(estimate, summarise(estimate), made_flight(), Mosaics(after=path, elevation=heights))
        for heights in (path, None)
    ]
    assert ["Heights of the ground in colours" in page for page in pages] == [True, False]


def test_heights_by_the_pictures_have_range_and_accuracy_and_what_was_filled_in():
    estimate = replace(made_estimate(), ground=MEASURED)
    told = heights_figure_words(estimate, gather(estimate, made_flight()), made_flight())
    words = told.replace("\xa0", " ")
    assert "from 1.50 m below it to 4.00 m above it" in words
    assert "typically to ± 50 mm" in words
    assert "of all ground, 3.8 % is filled in" in words
    assert "taken as level" not in words
    alone = replace(estimate, ground=replace(MEASURED, level_share=0.25))
    told = heights_figure_words(alone, gather(alone, made_flight()), made_flight())
    assert "25 % is taken as level, because no two pictures show it, and 3.8 %" in told.replace("\xa0", " ")


def test_doubted_heights_are_told_with_the_place_of_the_lowest():
    ground = replace(MEASURED, doubted_share=0.02, doubted_at_m=(-3.0, 7.0, -1.5))
    estimate, flight = replace(made_estimate(), ground=ground), made_flight()
    words = heights_figure_words(estimate, gather(estimate, flight), flight).replace("\xa0", " ")
    assert "% is doubted, because it lies in deep pits" in words
    assert "1.50 m below the floor, around x = -3.00 m, y = 7.00 m" in words
    assert "Doubted" not in heights_figure_words(
        replace(estimate, ground=MEASURED), gather(estimate, flight), flight
    )


def test_heights_by_the_height_sensor_have_its_accuracy():
    estimate, flight = made_estimate(), made_flight()
    words = heights_figure_words(estimate, gather(estimate, flight), flight)
    assert "height sensor alone" in words
    assert "smaller differences are noise" in words


def test_the_colours_reach_the_highest_echo_and_the_floor_has_one():
    """One cell of 900 is a thing on the floor; a percentile would have cut its colour."""
    rng = np.random.default_rng(0)
    height = (0.005 * rng.standard_normal((30, 30))).astype(np.float32)
    floor = floor_scatter(height)
    assert -0.02 < floor.lowest_m < 0 < floor.highest_m < 0.02
    height[10, 10], height[20, 20] = 0.06, 0.09
    drawn = elevation_picture(height, Grid(0, 3, 0.1, 30, 30))
    pixels = np.asarray(Image.open(io.BytesIO(drawn)).convert("RGB")).astype(int)[:, : 30 * 25]
    inside = pixels[100:800, 120:700]
    assert (np.abs(inside - [0xFD, 0xE7, 0x25]).sum(axis=2) < 20).sum() > 100, "the upper end of the colours"


@pytest.fixture
def titles(monkeypatch):
    """Titles of the pictures that are drawn."""
    found = []

    def drawn(figure, cropped):
        found.append(figure.axes[0].get_title())
        return b""

    monkeypatch.setattr("slam.report.rasters.elevation.png", drawn)
    return found


def test_title_caption_and_answer_tell_one_scatter_of_the_floor(titles):
    height = (-0.006 + 0.009 * np.random.default_rng(0).standard_normal((30, 30))).astype(np.float32)
    scatter = str(floor_scatter(height))
    flat = GroundFacts(misregistration_px=(0.1, 0.4), over_floor_px=(0.1, 0.4))
    estimate = replace(made_estimate(), elevation=Elevation(0, 3, 0.1, height), ground=flat)
    elevation_picture(height, Grid(0, 3, 0.1, 30, 30))
    facts = gather(estimate, made_flight())
    lines = heights(estimate, facts, summarise(estimate))[1]
    assert scatter in titles[0]
    assert scatter in heights_figure_words(estimate, facts, made_flight())
    assert any(scatter in line for line in lines)


def test_the_title_names_a_doubt_only_where_there_is_one(titles):
    height, none, some = (np.zeros((30, 30), x) for x in (np.float32, bool, bool))
    some[:3] = True
    for filled, pits in ((none, none), (some, none), (none, some), (some, some)):
        elevation_picture(
            height, Grid(0, 3, 0.1, 30, 30), "the pictures", {"filled in": filled, "doubted": pits}
        )
    told = [title.partition("(grey: ")[2] for title in titles]
    pale = "no picture; pale: "
    assert told == ["no picture)", f"{pale}filled in)", f"{pale}doubted)", f"{pale}filled in or doubted)"]


def test_what_stands_out_of_the_floor_is_told_with_its_area_and_place():
    height_m = np.random.default_rng(0).normal(0, 0.002, (20, 30)).astype(np.float32)
    height_m[4, 6:10], height_m[15, 20] = (0.05, 0.06, 0.08, 0.05), -0.04
    estimate = replace(made_estimate(), ground=None, elevation=Elevation(-1.0, 2.0, 0.1, height_m))
    facts = gather(estimate, made_flight())
    words = heights_figure_words(estimate, facts, made_flight()).replace("\xa0", " ")
    assert "lie above it, by 80.0 mm at most, around x = -0.15 m, y = 1.55 m" in words
    assert "lie below it, by 40.0 mm at most, around x = 1.05 m, y = 0.45 m" in words
    flat = replace(estimate, elevation=Elevation(-1.0, 2.0, 0.1, np.clip(height_m, -0.001, 0.001)))
    assert "likely wrong echoes" not in heights_figure_words(flat, facts, made_flight())


def test_the_share_of_trusted_heights_leaves_out_all_others():
    ground = replace(MEASURED, relief_share=0.8, filled_share=0.25, level_share=0.1, doubted_share=0.5)
    assert abs(ground.trusted_share - 0.4) < 1e-12  # half of 0.6 measured, and 0.1 found flat
    assert replace(MEASURED, filled_share=0.0).trusted_share == 1.0
    estimate = replace(made_estimate(), messages=(), ground=ground)
    told, _ = heights(estimate, gather(estimate, made_flight()), summarise(estimate))
    assert "on 40 % of the ground" in told.replace("\xa0", " ")
    assert "trust none on the rest" in told.split(". ")[0]
