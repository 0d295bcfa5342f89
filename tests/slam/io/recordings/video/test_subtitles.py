"""Dialects of subtitles: letters of hemispheres, orders of coordinates, held values, and unknown fields."""

from __future__ import annotations

import numpy as np
import pytest

from slam.core.errors import InputError
from slam.core.flight_info import describe
from slam.io.recordings.video.subtitles import changed_rows, parse_subtitles
from tests.slam.io.recordings.read_recording import read
from tests.slam.io.recordings.tables.made_table import lines_with
from tests.slam.io.recordings.video.made_video import video


def cues(*texts):
    return "".join(
        f"{k + 1}\n00:00:{k:02d},000 --> 00:00:{k + 1:02d},000\n{text}\n\n" for k, text in enumerate(texts)
    )


@pytest.mark.parametrize(
    ("text", "place"),
    [
        (
            "ISO 100, RTK (120.083799, 30.213635, 28), HOME (120.084146, 30.214243, 103.55m)",
            (30.213635, 120.083799, None),
        ),
        ("HOME(W: 97.6, N: 30.2)\nGPS(W: 97.621475, N: 30.214199, 161)", (30.214199, -97.621475, 161)),
        ("GPS(S: 30.5, E: 97.25, 161.5m)", (-30.5, 97.25, 161.5)),
        ("GPS(47.39, 8.54, 20M), HOME(47.397700, 8.545500, 460M)", (47.39, 8.54, 20)),
        ("GPS(8.54, 47.39, 20)", (47.39, 8.54, None)),
        ("[latitude: 47.39 S] [longitude: 8.54 W] [abs_alt: 480.0]", (-47.39, -8.54, 480)),
        ("[latitude: 47.39] [longitude: 8.54] [altitude: 1000.0 ft]", (47.39, 8.54, 304.8)),
        ("latitude: 47.39 E: 3 longitude: 8.54", (47.39, 8.54, None)),
    ],
)
def test_coordinates_of_each_dialect(text, place):
    found = parse_subtitles(cues(text))
    expected = [np.nan if each is None else each for each in place]
    values = [found.column(name)[0] for name in ("latitude", "longitude", "altitude")]
    assert values == pytest.approx(expected, nan_ok=True)


def test_a_height_that_is_held_to_the_end_covers_the_video(tmp_path):
    path = video(tmp_path / "a.mp4")
    (tmp_path / "a.srt").write_text(cues(*["[rel_alt: 40.000]"] * 4))
    flight = read(path)
    assert flight.barometer.stamps_s.tolist() == [0, 3]
    assert not [line for line in describe(flight).anomalies if "covers only" in line]


@pytest.mark.parametrize(
    ("values", "kept"),
    [([1, 1, 2, 2, 3, 3], [0, 2, 4]), ([1, 2, 3, 3, 3], [0, 1, 2, 4]), ([1, 1, np.nan], [0, 1]), ([1], [0])],
)
def test_the_last_row_is_kept_where_it_is_held_for_longest(values, kept):
    assert np.flatnonzero(changed_rows(np.array(values, float)[:, None])).tolist() == kept


def test_a_focal_length_of_no_lens_on_film_is_not_used(tmp_path):
    path = video(tmp_path / "a.mp4")
    (tmp_path / "a.srt").write_text(cues(*["[focal_len: 4.5]"] * 4))
    flight = read(path)
    assert flight.camera.focal_px[0] > 40
    assert lines_with(flight, ["focal_len 4.5 mm is not used"])
    assert lines_with(flight, ["focal length 50 px assumed"])


def test_subtitles_without_a_known_field_are_quoted(tmp_path):
    path = video(tmp_path / "a.mp4")
    (tmp_path / "a.srt").write_text(cues(*["<i>GPS 47.39N 8.54E</i>"] * 4))
    assert lines_with(read(path), ["a.srt has no field that is read, first '<i>GPS 47.39N 8.54E</i>'"])
    with pytest.raises(InputError, match=r"GPS 47.39N 8.54E"):
        read(tmp_path / "a.srt")
