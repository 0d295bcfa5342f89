"""Several flights are joined and give one map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from backend import se3
from slam import evaluate, optimize
from slam.cli import app
from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.join_flights import JOINED_STREAMS, PAUSE_S, join_flights
from slam.core.streams import Gps
from slam.io.estimate import read_estimate
from slam.io.flight_writer import write_flight
from tests.slam.small_flight import elsewhere, flown, gps_of, only, photographs, seeing


@pytest.fixture(scope="module")
def two() -> tuple[Flight, Flight]:
    """The same ground flown twice, with a hold noise and a sensor noise of its own each."""
    return replace(flown(0), name="small"), replace(flown(1), name="second")


@pytest.mark.slow
def test_two_flights_over_the_same_ground_make_one_map_as_good_as_its_covariance_says(two):
    joint = join_flights(two)
    estimate = optimize(joint)
    assert estimate.status == "ok"
    assert set(estimate.component.tolist()) == {0}
    first = np.array([name.startswith("small/") for name in estimate.frame_names])
    across = [loop for loop in estimate.loops if loop.verdict == "kept" and first[loop.i] != first[loop.j]]
    assert len(across) > 50
    result = evaluate(estimate, joint)
    assert result.loops.precision == 1.0
    assert result.ate_m.rmse < 0.005
    assert result.nees.pose.lower95 < result.nees.pose.mean < result.nees.pose.upper95


@pytest.mark.slow
def test_flights_over_different_ground_give_two_maps(two):
    estimate = optimize(join_flights([two[0], replace(elsewhere(), name="elsewhere")]))
    assert set(estimate.component.tolist()) == {0, 1}
    assert "2 parts" in estimate.status
    first = np.array([name.startswith("small/") for name in estimate.frame_names])
    assert len(set(estimate.component[first].tolist())) == 1


def test_a_single_flight_is_returned_unchanged(two):
    assert join_flights(two[:1]) is two[0]


def test_consecutive_clocks_are_kept_and_others_are_shifted_by_whole_seconds(two):
    a, b = two
    later = replace(b, epoch_ns=a.epoch_ns + 3_600_000_000_000)
    kept = join_flights([a, later])
    assert kept.frames.stamps_s[len(a.frames)] == pytest.approx(b.frames.stamps_s[0] + 3600.0, abs=1e-9)
    assert not kept.warnings
    moved = join_flights([a, b])
    shift = moved.frames.stamps_s[len(a.frames)] - b.frames.stamps_s[0]
    assert shift == pytest.approx(round(shift), abs=1e-9)
    assert moved.frames.stamps_s[len(a.frames)] >= a.truth.stamps_s[-1] + PAUSE_S
    assert "second" in moved.warnings[0]
    for series in (moved.frames, moved.sonar, moved.attitude, moved.truth):
        assert (np.diff(series.stamps_s) > 0).all()


def test_each_of_three_flights_begins_after_the_one_before_it(two):
    third = replace(flown(2), name="third")
    joint = join_flights([*two, third])
    lengths = [len(flight.frames) for flight in (*two, third)]
    first, second, last = np.split(joint.frames.stamps_s, np.cumsum(lengths)[:-1])
    assert first[-1] + PAUSE_S < second[0]
    assert second[-1] + PAUSE_S < last[0]


def test_a_landmark_that_two_flights_name_is_where_the_first_has_it(two):
    a, b = two
    there, elsewhere = np.array([1.0, 2.0, 0.0]), np.array([9.0, 9.0, 0.0])
    joint = join_flights(
        [replace(a, landmarks={"A": there}), replace(b, landmarks={"A": elsewhere, "B": elsewhere})]
    )
    assert {name: place.tolist() for name, place in joint.landmarks.items()} == {
        "A": there.tolist(),
        "B": elsewhere.tolist(),
    }


def test_pictures_and_read_errors_are_those_of_the_flights(two):
    a, b = two
    broken = seeing(b, lambda k: None)
    broken.frames.failures[3] = "cut short"  # a loader's own dictionary
    joint = join_flights([a, broken])
    assert np.array_equal(joint.frames.load(5), a.frames.load(5))
    assert joint.frames.load(len(a.frames) + 3) is None
    assert joint.frames.failures == {len(a.frames) + 3: "cut short"}
    assert joint.frames.names[len(a.frames)] == f"second/{b.frames.names[0]}"


def test_truth_is_kept_only_if_all_have_it_and_gps_if_some_have_it(two):
    a, b = two
    joint = join_flights([replace(a, gps=gps_of(a, 0.1)), replace(b, truth=None)])
    assert joint.truth is None
    assert "small" in joint.warnings[-1]
    assert len(joint.gps.stamps_s) == len(gps_of(a, 0.1).stamps_s)


def test_equal_names_are_numbered(two):
    assert join_flights([two[0], replace(two[1], name=two[0].name)]).name == "small.1 + small.2"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: replace(f, camera=None, frames=None), "no camera"),
        (lambda f: replace(f, camera=replace(f.camera, size_px=(320, 240))), "320x240"),
        (lambda f: replace(f, camera=replace(f.camera, focal_px=(99.0, 99.0))), "99.0"),
        (lambda f: replace(f, camera=replace(f.camera, distortion=(0.1, 0, 0, 0))), "distortion"),
        (lambda f: replace(f, camera=replace(f.camera, lens="equidistant")), "equidistant lens, not brown"),
        (lambda f: replace(f, camera=replace(f.camera, b_T_c=np.eye(4))), "mounted"),
        (lambda f: photographs([(f, 0), (f, 9)]), "photographs"),
    ],
)
def test_flights_that_cannot_be_joined_are_refused_in_one_line(two, change, message):
    with pytest.raises(InputError, match=message) as refused:
        join_flights([two[0], change(two[1])])
    assert "\n" not in str(refused.value)


def test_no_flight_is_refused():
    with pytest.raises(InputError, match="no flight"):
        join_flights([])


def test_the_command_takes_several_flights_and_evaluates_their_map(two, tmp_path, no_figures):
    for flight in two:
        write_flight(only(flight, range(0, len(flight.frames) // 6, 2)), tmp_path / flight.name)
    paths = [str(tmp_path / flight.name) for flight in two]
    out = str(tmp_path / "map")
    ran = CliRunner().invoke(app, ["optimize", *paths, "--out", out, "--no-mosaic"])
    assert ran.exit_code == 0, ran.output
    assert read_estimate(out).name == "small + second"
    ran = CliRunner().invoke(app, ["evaluate", out, "--truth", paths[0], "--truth", paths[1]])
    assert ran.exit_code == 0, ran.output
    graph = tmp_path / "map" / "graph.g2o"
    ran = CliRunner().invoke(app, ["optimize", paths[0], str(graph), "--out", str(tmp_path / "other")])
    assert ran.exit_code == 1
    assert "graph" in ran.output


def test_positions_of_flights_of_different_accuracy_keep_their_own(two):
    zero = np.zeros(2)
    gps = [Gps(np.arange(2.0), zero, zero, zero, noise_std_m=(s, s, 2 * s)) for s in (0.01, 5.0)]
    joined = join_flights([replace(f, gps=g) for f, g in zip(two, gps, strict=True)]).gps
    np.testing.assert_equal(joined.stds_m[:, 0], [0.01, 0.01, 5.0, 5.0])
    assert joined.noise_std_m == (2.505, 2.505, 5.01)
    assert join_flights([replace(f, gps=gps[0]) for f in two]).gps.stds_m is None


def raised(lever_m):
    b_T_s = np.eye(4)
    b_T_s[2, 3] = lever_m
    return b_T_s


def of_series(**changes):
    """Return a change of some fields of some series of a flight, as ``{"sonar": {"scale_std": 0.1}}``."""
    return lambda f: replace(f, **{name: replace(getattr(f, name), **c) for name, c in changes.items()})


def with_gps(flight):
    return replace(flight, gps=gps_of(flight, 0.1))


@pytest.mark.parametrize(
    ("series", "field", "value"),
    [
        ("sonar", "noise_std_m", 0.3),
        ("sonar", "scale_std", 0.3),
        ("sonar", "datum_std_m", 0.3),
        ("sonar", "beam_width_rad", 1.0),
        ("sonar", "max_range_m", 60.0),
        ("sonar", "min_range_m", 0.01),
        ("sonar", "assumed", ("noise_std",)),
        ("attitude", "noise_std_rad", (0.05, 0.06, 0.2)),
        ("attitude", "assumed", ("noise_std",)),
        ("gps", "antenna_std_m", 0.3),
        ("gps", "assumed", ("T_BS",)),
        ("gps", "height_system", ""),
    ],
)
@pytest.mark.parametrize("changed", [0, 1])
def test_what_any_of_the_flights_states_worse_holds_for_all(two, series, field, value, changed):
    flights = [with_gps(flight) for flight in two]
    flights = [of_series(gps={"height_system": "EPSG:5773"})(flight) for flight in flights]
    limits = {"max_range_m": 6.0, "min_range_m": 0.25, "scale_std": 0.05}
    flights = [of_series(sonar=limits)(flight) for flight in flights]
    flights[changed] = of_series(**{series: {field: value}})(flights[changed])
    assert getattr(getattr(join_flights(flights), series), field) == value


def test_each_range_counts_within_the_limits_of_its_own_sonar(two):
    a, b = (replace(f, sonar=replace(f.sonar, range_m=np.full(len(f.sonar.stamps_s), 7.0))) for f in two)
    joint = join_flights(
        [of_series(sonar={"max_range_m": 6.0})(a), of_series(sonar={"max_range_m": 50.0})(b)]
    )
    first = len(a.sonar.stamps_s)
    np.testing.assert_array_equal(joint.sonar.range_m[:first], np.nan)
    np.testing.assert_array_equal(joint.sonar.range_m[first:], 7.0)
    assert joint.sonar.max_range_m >= 7.0


@pytest.mark.parametrize(("series", "folder"), [("sonar", "sonar0"), ("gps", "gps0")])
def test_instruments_that_are_mounted_in_another_way_are_refused(two, series, folder):
    a, b = (with_gps(flight) for flight in two)
    moved = of_series(**{series: {"b_T_s": raised(0.8)}})(b)
    with pytest.raises(InputError, match=rf"second: {folder} mounted .* that of small \(0.8 m apart\)"):
        join_flights([a, moved])
    assert join_flights([of_series(**{series: {"b_T_s": raised(0.8)}})(a), moved]) is not None


def test_an_instrument_that_is_turned_is_refused_with_the_angle(two):
    a, b = two
    turned = se3.exp(np.array([[0.1, 0.0, 0.0, 0.0, 0.0, 0.0]]))[0]
    with pytest.raises(InputError, match=r"sonar0 mounted in another way .* \(turned by 5.73 deg\)"):
        join_flights([a, of_series(sonar={"b_T_s": turned})(b)])


def test_antennas_may_be_apart_by_the_uncertainty_of_their_places(two):
    a, b = (with_gps(flight) for flight in two)
    a, b = of_series(gps={"antenna_std_m": 0.1})(a), of_series(gps={"antenna_std_m": 0.2})(b)
    near, far = (of_series(gps={"b_T_s": raised(lever_m)})(b) for lever_m in (0.5, 0.8))
    assert join_flights([a, near]).gps.antenna_std_m == 0.2
    with pytest.raises(InputError, match=r"gps0 mounted .* \(0.8 m apart, known to 0.22 m\)"):
        join_flights([a, far])


def test_the_antenna_is_where_a_flight_states_it(two):
    a, b = (with_gps(flight) for flight in two)
    unknown, known = of_series(gps={"assumed": ("T_BS",)})(a), of_series(gps={"b_T_s": raised(0.8)})(b)
    joint = join_flights([unknown, known])
    np.testing.assert_array_equal(joint.gps.b_T_s, raised(0.8))
    assert joint.gps.antenna_assumed


def test_every_field_of_every_series_has_a_rule(two):
    """A field without one is an error."""
    joint = join_flights([with_gps(flight) for flight in two])
    assert all(getattr(joint, name) is not None for name in JOINED_STREAMS)


@pytest.mark.parametrize(("other", "is_told"), [("EPSG:4979", True), ("EPSG:5773", False), ("", False)])
def test_altitudes_over_different_levels_are_told(two, other, is_told):
    """The ellipsoid and sea level lie up to a hundred metres apart."""
    flights = [
        of_series(gps={"height_system": system})(with_gps(flight))
        for flight, system in zip(two, ("EPSG:5773", other), strict=True)
    ]
    lines = [line for line in join_flights(flights).warnings if "different levels" in line]
    assert len(lines) == is_told
    assert all("WGS 84 ellipsoid" in line and flights[1].name in line for line in lines)
