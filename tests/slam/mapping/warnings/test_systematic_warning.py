"""One sentence for the errors that all pictures share: pattern, size, likely cause, effect, next step."""

from __future__ import annotations

from dataclasses import replace

import pytest

from backend.bundle.accuracy.systematic_errors import SystematicErrors
from frontend.camera import Camera
from slam.core.flight import Flight
from slam.mapping.gps.stated_accuracy import Contradiction, Pattern
from slam.mapping.warnings.systematic_warning import (
    explains,
    is_outside_covariances,
    refuted_lens_warning,
    systematic_warning,
)

CAMERA = Camera((1000.0, 1000.0), (499.5, 399.5), (1000, 800))
RADIAL = SystematicErrors(
    coefficients={"radial": (-0.1, 0.0)},
    stds={"radial": (0.01, 0.01)},
    alternatives=(),
    p_value=1e-9,
    excess=9.0,
    shift_m=0.5,
    tilt_rad=0.02,
)
OFFSET = replace(
    RADIAL,
    coefficients={"position offset": (0.3, -0.4), "principal point": (0.002, -0.001)},
    stds={"position offset": (0.02, 0.2), "principal point": (1e-4, 1e-4)},
    alternatives=("radial",),
)


def warning(found: SystematicErrors | None) -> str:
    return str(systematic_warning(found, CAMERA, 50.0, True, "cam0/sensor.yaml") or "")


def test_a_lens_is_reported_with_its_size_at_the_corners() -> None:
    """The corner lies at 0.64 focal lengths: 1000 px times 0.1 times its cube is 26 px."""
    line = warning(RADIAL)
    assert "cam0: the residuals grow with the radius in the same way in all pictures" in line
    assert "26 px inward at the corners" in line
    assert "0.50\N{NO-BREAK SPACE}m and 1.1°, more than their standard deviations state" in line
    assert "distortion_coefficients in cam0/sensor.yaml" in line
    assert "outward" in warning(replace(RADIAL, coefficients={"radial": (0.1, 0.0)}))


def test_an_offset_is_reported_with_all_its_causes() -> None:
    line = warning(OFFSET)
    assert line.startswith("gps0: the positions differ from the pictures by a constant in the body's axes")
    assert "positions off by forward +0.30 ± 0.02 m" in line
    assert "left" not in line
    assert "as much as 10 px of the principal point" in line
    assert "principal point off by +2, -1 px" in line
    assert (
        "likely by positions of another point or moment than the pictures (antenna, delay) and a principal "
        "point other than the declared one, or in part a lens distortion other than the declared one;"
    ) in line


def test_a_camera_that_looks_ahead_is_no_wrong_lens() -> None:
    """A principal point at the border of the picture is a direction of view."""
    ahead = replace(
        RADIAL, coefficients={"principal point": (0.0, -0.3)}, stds={"principal point": (0.1, 0.1)}
    )
    line = warning(ahead)
    assert "likely by a camera that looks elsewhere than T_BS and the attitude say" in line
    assert line.endswith("check T_BS in cam0/sensor.yaml, and give the angles of the camera in attitude0")
    near = replace(ahead, coefficients={"principal point": (0.0, -0.1)})
    assert "likely by a principal point other than the declared one" in warning(near)


def test_an_error_inside_the_covariances_is_reported_for_positions_alone() -> None:
    assert is_outside_covariances(RADIAL)
    small = replace(RADIAL, excess=0.9)
    assert not is_outside_covariances(small)
    assert not is_outside_covariances(None)
    assert warning(small) == warning(None) == ""
    assert "the standard deviations include its effect" in warning(replace(OFFSET, excess=0.9))


def test_a_refuted_lens_is_told_with_its_errors_where_the_covariances_include_them() -> None:
    inside = replace(RADIAL, excess=0.9)
    line = refuted_lens_warning(inside, CAMERA, CAMERA, 50.0, True, "cam0/sensor.yaml")
    declared, used = line.text.split("; that is of a map with the declared lens: ")
    assert "a lens distortion other than the declared one" in declared
    assert used.startswith("this one has a lens with distortion")


@pytest.mark.parametrize(
    ("found", "kind", "same"),
    [
        (OFFSET, "body", True),
        (OFFSET, "delay", True),
        (OFFSET, "place", True),  # radial distortion is an alternative
        (OFFSET, "", False),
        (RADIAL, "place", True),
        (RADIAL, "body", False),
        (None, "body", False),
    ],
)
def test_fixes_that_differ_for_the_same_reason_share_the_sentence(found, kind, same) -> None:
    assert explains(found, Contradiction("gps0: states 0.01 m", Pattern(kind, 0.9, ""))) is same


def test_photographs_and_recordings_have_their_calibration_in_the_flight_folder() -> None:
    assert Flight("folder").camera_file == "cam0/sensor.yaml"
    assert "`slam import`" in Flight("photographs", all_keyframes=True).camera_file
    line = str(systematic_warning(RADIAL, CAMERA, 50.0, True, Flight("p", all_keyframes=True).camera_file))
    assert line.endswith("in cam0/sensor.yaml of the flight folder that `slam import` makes")


@pytest.mark.parametrize("kind", ["decentring", "principal point"])
def test_other_errors_of_the_lens_have_their_own_words(kind: str) -> None:
    line = warning(replace(RADIAL, coefficients={kind: (0.001, 0.0)}, stds={kind: (1e-4, 1e-4)}))
    assert line.startswith("cam0: ")
    assert "in all pictures" in line
    assert "px" in line
