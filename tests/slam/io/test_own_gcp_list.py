"""The list of control points in the folder of a flight."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

from slam.cli.optimize import _joined
from slam.core.control_points import PictureView
from slam.io.flight_folder import read_flight, write_flight
from slam.io.gcp_list import with_own_points, without_own_points
from tests.slam.io.made_flight import made_flight
from tests.slam.io.made_gcp_list import ROWS, UTM, flight

FAULT = "465026.0 5250010.0 401 11 20 DJI_0020.JPG south"


def test_a_flight_folder_s_own_list_is_read_with_it(tmp_path):
    written = made_flight()
    write_flight(written, tmp_path / "f")
    origin, name = written.geo_origin(), read_flight(tmp_path / "f").frames.names[0]
    place = f"{origin.longitude_deg} {origin.latitude_deg} 12.5"
    listed = f"EPSG:4326\n{place} 20 10 {name} north\n{place} 20 10 gone.png north\n"
    (tmp_path / "f" / "gcp_list.txt").write_text(listed)
    back = read_flight(tmp_path / "f")
    (point,) = back.surveyed
    assert (point.name, point.altitude_m, point.views) == ("north", 12.5, (PictureView(name, 20.0, 10.0),))
    assert any("gcp_list.txt, line 3: no picture of the flight has this name" in w for w in back.warnings)
    (tmp_path / "f" / "gcp_list.txt").write_text("EPSG:4326\n1 2 3\n")
    back = read_flight(tmp_path / "f")
    assert back.surveyed == ()
    fault = "gcp_list.txt, line 2: has 3 fields, fewer than 6"
    assert any(w.startswith(fault) and w.endswith("; no control point is used") for w in back.warnings)


def test_a_list_beside_a_recording_without_pictures_is_noted(tmp_path):
    write_flight(replace(made_flight(), frames=None), tmp_path / "f")
    (tmp_path / "f" / "gcp_list.txt").write_text("\n".join([*UTM, *ROWS]))
    assert "gcp_list.txt is not used: the flight has no pictures" in read_flight(tmp_path / "f").warnings


def test_without_its_own_list_a_flight_is_as_before(tmp_path):
    (tmp_path / "gcp_list.txt").write_text("\n".join([*UTM, *ROWS, "1 1 1 1 1 gone.jpg", FAULT]))
    told = with_own_points(flight(), tmp_path)
    assert [p.name for p in told.surveyed] == ["north", "south"]
    assert any("control point south" in line for line in told.warnings)
    plain = without_own_points(told)
    assert (plain.surveyed, plain.warnings) == ((), ())


def test_a_list_on_the_command_line_replaces_those_of_the_flights(tmp_path):
    """Points of the folder's list with other names stayed."""
    (tmp_path / "gcp_list.txt").write_text("\n".join([*UTM, *ROWS]))
    given = tmp_path / "given.txt"
    given.write_text("\n".join([*UTM, ROWS[0].replace("north", "mast")]))
    own = with_own_points(flight(), tmp_path)
    options = SimpleNamespace(gcp=given, check=(), gcp_std_m=None)
    assert [p.name for p in _joined([own], options).surveyed] == ["mast"]
