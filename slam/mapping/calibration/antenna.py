"""The place of the GPS antenna on the body: what was stated of it, and what a map has estimated."""

from __future__ import annotations

import numpy as np

from backend.bundle.accuracy.systematic_errors import ErrorTest
from backend.bundle.refinement import Bundle
from backend.significance import SIGMAS_OF_SEVERAL
from backend.triple import triple
from slam.core.instrument_errors import AntennaPlace
from slam.core.messages import Message, about, warning

NOMINAL_ANTENNA_STD_M = 0.2
"""Standard deviation along each axis of an antenna's place that nobody has measured. Vehicles that carry a
camera are 0.3 to 1.2 m wide, and the antenna is on them: three deviations are half of the largest width."""
_FOUND_SIGMAS = SIGMAS_OF_SEVERAL + 2.0
"""Standard deviations from which the test of several errors finds an offset in 49 of 50 flights."""
FARTHEST = 3.0
"""Standard deviations of the prior within which a calibration lies: farther away it has another cause."""


def antenna_m(bundle: Bundle | None) -> tuple[float, float, float] | None:
    """Return the place (forward, left, up) that a map has of the antenna; None without positions."""
    if bundle is None or not bundle.optimum.problem.measurements.positions:
        return None
    return triple(bundle.antenna_m)


def antenna_place(bundle: Bundle | None) -> AntennaPlace | None:
    """Return the place; None without positions, and where it was fixed."""
    place = antenna_m(bundle)
    if bundle is None or place is None:
        return None
    measured = bundle.optimum.problem.measurements
    if measured.antenna_std_m == 0:
        return None
    std, stated = map(triple, (bundle.antenna_std_m, measured.antenna_m))
    return AntennaPlace(place, std, stated, measured.antenna_std_m)


def unknown_antenna_warning(bundle: Bundle, tested: ErrorTest) -> Message | None:
    """Return a line where an antenna may lie away from the body's origin, where it is assumed, unseen.

    At one heading its place moves the whole map, and nothing shows it. The line is None for fixes that are
    coarser than a vehicle is large, and for an antenna that is estimated. Its place is not stated.
    """
    measured = bundle.optimum.problem.measurements
    seen = tested.errors is not None and "position offset" in tested.errors.coefficients
    if not measured.positions or measured.antenna_std_m > 0 or seen:
        return None
    fix_std_m = float(np.median([p.std_m[:2].max() for p in measured.positions]))
    largest_unseen_m = _FOUND_SIGMAS * tested.detectable.get("position offset", np.inf)
    if fix_std_m >= NOMINAL_ANTENNA_STD_M or largest_unseen_m < NOMINAL_ANTENNA_STD_M:
        return None
    return about(
        "gps0",
        f"fixes are good to {fix_std_m:.2g} m, but nothing tells where the antenna is on the body: "
        "it is held at the body's origin, because at the headings of this flight its place looks like that "
        "of the whole map or like the lens",
        "the map may lie beside its place on Earth by as much",
        "state the antenna's place in T_BS of gps0/sensor.yaml, or fly lines in several headings",
    )


def antenna_height_note(bundle: Bundle) -> Message | None:
    """Return a note where the height of the antenna is uncertain as nobody stated it; None elsewhere."""
    measured = bundle.optimum.problem.measurements
    if not measured.positions or measured.antenna_up_std_m <= measured.antenna_std_m:
        return None
    return about(
        "gps0",
        "nothing tells how high the antenna is above the body's origin: heights of cameras and ground "
        f"count it as 0 ± {measured.antenna_up_std_m:g} m",
        "T_BS of gps0/sensor.yaml states it",
    ).as_note()


def refusal_of_antenna(bundle: Bundle) -> Message | None:
    """Return why a place that was free, in ``bundle``, is not to be taken; None where it is.

    As for the numbers of a lens, the flight must tell more of it than was known: its variance is below half
    of the prior's, forward and left. Upward it is one with the height of the ground. A place outside the
    vehicle has another cause, such as a delay.
    """
    measured = bundle.optimum.problem.measurements
    std, prior = bundle.antenna_std_m[:2], measured.antenna_std_m
    off = (bundle.antenna_m - measured.antenna_m)[:2]
    if not measured.positions or not (std**2 < 0.5 * prior**2).all():
        return warning(
            "the flight does not tell the antenna's place from the lens and from the place of the whole map "
            f"(±{np.nanmax(std):.2g} m, ±{prior:.2g} m without the flight)"
        )
    if (np.abs(off) > FARTHEST * prior).any():
        return warning(
            f"it would be {off[0]:+.2f} m forward and {off[1]:+.2f} m left of its stated place, which is "
            "outside most vehicles and may have another cause, such as a delay",
            "if it is there, state it in T_BS of gps0/sensor.yaml",
        )
    return None
