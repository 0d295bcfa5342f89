"""Titles below other lines, units in a row of their own, other delimiters, and names of other loggers."""

from __future__ import annotations

import numpy as np
import pytest

from slam.core.errors import InputError
from slam.io.recordings.tables.layout import layout_of
from tests.slam.io.recordings.read_recording import read
from tests.slam.io.recordings.tables.made_table import lines_with, table

POSITIONS = [f"{k}.5,51.{k},-0.25,100" for k in range(4)]


@pytest.mark.parametrize(
    "above",
    [
        ("sep=,",),
        ("# flight of 3 May, logger v2", ""),
        ("Product,Blackbox", "date,3 May", "loop time,500"),
    ],
)
def test_titles_are_found_below_other_lines(tmp_path, above):
    flight = read(table(tmp_path / "a.csv", *above, "time [s],lat,lon,alt [m]", *POSITIONS))
    assert flight.gps.latitude_deg.tolist() == [51.0, 51.1, 51.2, 51.3]
    assert flight.epoch_ns == 500_000_000


@pytest.mark.parametrize("delimiter", ["|", " ", "  ", "\t", ";", ", "])
def test_cells_are_separated_in_other_ways(tmp_path, delimiter):
    rows = [row.replace(",", delimiter) for row in ("time_s,lat,lon,alt_m", *POSITIONS)]
    flight = read(table(tmp_path / "a.csv", *rows))
    assert flight.gps.latitude_deg.tolist() == [51.0, 51.1, 51.2, 51.3]
    assert flight.gps.altitude_m.tolist() == [100] * 4


def test_a_row_below_the_titles_gives_the_units(tmp_path):
    flight = read(table(tmp_path / "a.csv", "time,lat,lon,alt,note", "ms,deg,deg,ft,", *POSITIONS))
    assert flight.gps.altitude_m == pytest.approx([30.48] * 4)
    assert flight.gps.stamps_s == pytest.approx([0, 0.001, 0.002, 0.003])


def test_a_table_without_a_time_names_what_is_read(tmp_path):
    path = table(tmp_path / "a.csv", "frame,lat,lon", "1,51.5,-0.25")
    with pytest.raises(
        InputError, match=r"without a time .*'frame,lat,lon'.*that are read: time, .*latitude"
    ):
        read(path)


def test_columns_of_decoded_flight_records_have_their_names_and_units(tmp_path):
    names = "OSD.flyTime [s],OSD.latitude,OSD.longitude,OSD.height [ft],OSD.pitch,OSD.roll,OSD.yaw"
    flight = read(
        table(tmp_path / "a.csv", "sep=,", names, *(f"{k},51.{k},-0.25,1{k},20,10,90" for k in range(4)))
    )
    assert np.degrees(flight.attitude.roll_pitch_yaw_rad[0]) == pytest.approx([10, -20, 0], abs=1e-9)
    assert flight.barometer.value[:2] == pytest.approx([3.048, 3.3528])
    gimbal = "OSD.flyTime [s],GIMBAL.pitch,GIMBAL.roll,GIMBAL.yaw"
    flight = read(table(tmp_path / "b.csv", gimbal, "0,-90,0,0", "1,-90,0,0"))
    assert np.degrees(flight.attitude.roll_pitch_yaw_rad[0]) == pytest.approx([0, 0, 90], abs=1e-9)


def test_columns_of_betaflight(tmp_path):
    names = "loopIteration, time (us), vbatLatest (V), baroAlt (cm), gyroADC[0]"
    flight = read(
        table(tmp_path / "a.csv", names, *(f"{k}, {100_000 * k}, 15.9, {200 + k}, 3" for k in range(4)))
    )
    assert flight.battery.value[0] == 15.9
    assert flight.barometer.value == pytest.approx([2, 2.01, 2.02, 2.03])


@pytest.mark.parametrize(
    "header",
    [
        "OSD.flyTime,OSD.flyTime [s],OSD.height,OSD.height [ft]",
        "timestamp,CUSTOM.updateTime,height [furlong],height [ft]",
        "timestamp,datetime,image [id],height [ft]",
    ],
)
def test_a_column_with_a_known_unit_comes_before_one_without(tmp_path, header):
    stamp = "{0}.0" if "flyTime" in header else "10:00:0{0}.0"
    rows = (f"{k}m,{stamp.format(k)},7,1{k}" for k in range(4))
    flight = read(table(tmp_path / "a.csv", header, *rows))
    assert flight.barometer.value[:2] == pytest.approx([3.048, 3.3528])
    assert flight.barometer.stamps_s.tolist() == [0, 1, 2, 3]
    assert header.split(",")[2] in {source.channel for source in flight.sources}


def test_a_row_of_units_may_have_brackets(tmp_path):
    flight = read(
        table(tmp_path / "a.csv", "time,lat,lon,hMSL,alt", "(s),(deg),[deg],(m),(ft)", "0,51,8,9,10")
    )
    assert flight.gps.altitude_m == pytest.approx([3.048])
    assert not lines_with(flight, ["no number"])


def test_a_text_with_a_cell_too_long_for_a_table_is_refused(tmp_path):
    for k, lines in enumerate(("x" * 140_000 + ",1", "time [s],range [m]\n0," + "1" * 140_000)):
        with pytest.raises(InputError, match=r"is (a|no) table of readings"):
            layout_of(tmp_path / f"{k}.csv", lines)
