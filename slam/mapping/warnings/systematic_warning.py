"""Warning about errors that all pictures or all positions share, with their size and likely cause."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from backend.bundle.accuracy.systematic_errors import SystematicErrors
from backend.bundle.accuracy.systematic_terms import Kind, lens_displacement
from backend.bundle.lens import CENTER, FOCAL, NAMES, TERMS, is_uncertain, prior_calibration, prior_covariance
from backend.significance import SURE_SIGMAS
from frontend.camera import Camera
from slam.core.instrument_errors import AntennaPlace
from slam.core.lens_priors import as_nominal
from slam.core.messages import Message, about
from slam.core.units import length, percent
from slam.mapping.gps.stated_accuracy import Contradiction
from slam.mapping.map import Map
from slam.mapping.part_measurements import pinhole_model

_PATTERN: Mapping[Kind, tuple[str, str]] = {
    "radial": ("cam0", "the residuals grow with the radius in the same way in all pictures"),
    "decentring": (
        "cam0",
        "the residuals depend on the place in the picture in the same way in all pictures",
    ),
    "principal point": ("cam0", "the residuals are constant in the camera's axes in all pictures"),
    "position offset": ("gps0", "the positions differ from the pictures by a constant in the body's axes"),
}
_CAUSE: Mapping[Kind, str] = {
    "radial": "a lens distortion other than the declared one",
    "decentring": "a lens distortion other than the declared one",
    "principal point": "a principal point other than the declared one",
    "position offset": "positions of another point or moment than the pictures (antenna, delay)",
}
_ADVICE: Mapping[Kind, str] = {
    "radial": "calibrate the camera and declare distortion_coefficients in {camera_file}",
    "decentring": "calibrate the camera and declare distortion_coefficients in {camera_file}",
    "principal point": "calibrate the camera and correct intrinsics in {camera_file}",
    "position offset": "calibrate the camera, and refer the positions to its place and its clock",
}
_MIDDLE = 0.25
"""Share of a side by which a principal point may lie off the declared one. No lens has it farther out, but
another direction of view does the same to the residuals."""
_TURNED = "check T_BS in {camera_file}, and give the angles of the camera in attitude0"
_PATTERNS_OF_FIXES: Mapping[Kind, tuple[str, ...]] = {
    "radial": ("place", "altitude"),
    "decentring": ("place",),
    "principal point": ("body",),
    "position offset": ("body", "delay"),
}
"""Patterns of the differences between fixes and map (`slam.mapping.gps.stated_accuracy`) by the same cause.
"""


def explains(found: SystematicErrors | None, contradiction: Contradiction) -> bool:
    """Return whether the errors are also the reason for which fixes differ by more than is stated."""
    kinds = () if found is None else (*found.coefficients, *found.alternatives)
    return any(contradiction.pattern.kind in _PATTERNS_OF_FIXES[kind] for kind in kinds)


def refuted_lens_warning(
    found: SystematicErrors, declared: Camera, used: Camera, height_m: float, metric: bool, camera_file: str
) -> Message:
    """Return the warning about a ``declared`` lens in whose place the map has an estimated one, ``used``."""
    line = _described(found, declared, height_m, metric, camera_file)
    lens = "an equidistant fisheye" if used.lens == "equidistant" else "a lens with distortion"
    return line.extended(
        f"that is of a map with the declared lens: this one has {lens} instead, as the pictures show it"
    )


def stated_lens_warning(stated: Camera, map_: Map, camera_file: str) -> Message:
    """Return the warning about a lens whose stated numbers the evidence of a map refutes.

    It names the number that is farthest from the stated one, in standard deviations.
    """
    declared, estimate = _farthest_number(stated, map_)
    if not is_uncertain(pinhole_model(stated)):
        return about(
            "cam0",
            "the stated lens, held as exact, contradicts the pictures",
            f"this map has an estimated one instead, with {estimate}",
            f"calibrate the camera and correct its numbers in {camera_file}",
        )
    return about(
        "cam0",
        f"{declared}, with what else is told of its lens, contradicts the pictures and positions",
        f"this map has {estimate} instead, as estimated",
        f"calibrate the camera and correct its numbers in {camera_file}",
    )


def _farthest_number(stated: Camera, map_: Map) -> tuple[str, str]:
    """Return the stated number of the lens that is farthest from the map's, and the map's."""
    # A number that was held was stated as certain by nobody.
    model, lens = pinhole_model(as_nominal(stated)), None if map_.bundle is None else map_.bundle.lens
    numbers, std = prior_calibration(model), np.sqrt(np.diag(prior_covariance(model)))
    focal_px = np.mean(numbers[FOCAL])
    focal = f"a focal length of {focal_px:.0f} px ± {percent(stated.focal_std_ratio)}"
    if lens is None:
        return focal, f"{np.mean(map_.camera.focal_px):.0f} px"
    comparable = slice(None) if lens.model == stated.lens else slice(TERMS.start)
    off = np.abs(lens.calibration[comparable] - numbers[comparable]) / std[comparable]
    worst = int(np.argmax(off))
    found, found_std = lens.calibration, lens.std
    if NAMES[lens.model][worst] in ("fx", "fy"):
        return focal, f"{np.mean(found[FOCAL]):.0f} ± {np.mean(found_std[FOCAL]):.2g} px"
    if NAMES[lens.model][worst] in ("cx", "cy"):
        (u, v), (found_u, found_v) = numbers[CENTER], found[CENTER]
        return (
            f"a principal point at ({u:.0f}, {v:.0f}) ± {std[worst]:.2g} px",
            f"({found_u:.0f}, {found_v:.0f}) ± {np.max(found_std[CENTER]):.2g} px",
        )
    name = NAMES[lens.model][worst]
    return (
        f"a distortion with {name} = {numbers[worst]:.2g} ± {std[worst]:.2g}",
        f"{name} = {found[worst]:.2g} ± {found_std[worst]:.2g}",
    )


def refuted_antenna_warning(
    found: SystematicErrors, place: AntennaPlace, camera: Camera, height_m: float, is_stated: bool
) -> Message:
    """Return the warning about an antenna whose stated or assumed place the map has replaced by ``place``."""
    axes = zip(("forward", "left"), place.place_m, place.std_m, strict=False)
    here = ", ".join(f"{axis} {at:+.2f} ± {std:.1g} m" for axis, at, std in axes)
    held = "where T_BS of gps0/sensor.yaml tells" if is_stated else "at the body's origin, as assumed"
    offset = _term("position offset", found, camera, height_m)
    name, pattern = _PATTERN["position offset"]
    return about(
        name,
        f"{pattern} ({offset}), so the antenna is not {held}",
        f"this map has it at {here}, as estimated",
        "measure its place, and state it in T_BS of gps0/sensor.yaml (slam import writes this "
        "file for photographs)",
    )


def is_outside_covariances(found: SystematicErrors | None) -> bool:
    """Return whether the errors displace the poses by more than the map's covariances state."""
    return found is not None and found.excess > 1.0


def systematic_warning(
    found: SystematicErrors | None, camera: Camera, height_m: float, metric: bool, camera_file: str
) -> Message | None:
    """Return the warning; None where the errors concern no position and the covariances include them.

    ``camera`` is the declared or estimated one, ``height_m`` its typical height over the floor. Lengths are
    metres if ``metric``. ``camera_file`` says where a calibration is declared.
    """
    if found is None:
        return None
    at_positions = "position offset" in (*found.coefficients, *found.alternatives)
    if not at_positions and not is_outside_covariances(found):
        return None
    return _described(found, camera, height_m, metric, camera_file)


def _described(
    found: SystematicErrors, camera: Camera, height_m: float, metric: bool, camera_file: str
) -> Message:
    first = next(iter(found.coefficients))
    terms = ", ".join(_term(kind, found, camera, height_m) for kind in found.coefficients)
    turned = _looks_elsewhere(found, camera)
    likely = dict.fromkeys(_CAUSE[kind] for kind in found.coefficients)
    others = dict.fromkeys(_CAUSE[kind] for kind in found.alternatives if _CAUSE[kind] not in likely)
    causes = " and ".join(likely) + (", or in part " + " or ".join(others) if others else "")
    moved = f"about {length(found.shift_m, metric)} and {np.degrees(found.tilt_rad):.2g}°"
    effect = (
        f"it displaces poses by {moved}, more than their standard deviations state, and may cause the other "
        "warnings"
        if is_outside_covariances(found)
        else "the standard deviations include its effect"
    )
    if turned:
        causes = "a camera that looks elsewhere than T_BS and the attitude say, as one that looks ahead"
    advice = (_TURNED if turned else _ADVICE[first]).format(camera_file=camera_file)
    name, pattern = _PATTERN[first]
    return about(name, f"{pattern} ({terms}), likely by {causes}", effect, advice)


def _looks_elsewhere(found: SystematicErrors, camera: Camera) -> bool:
    """Return whether the principal point would lie where no lens has it."""
    shift_px = np.array(found.coefficients.get("principal point", (0.0, 0.0))) * camera.focal_px
    return bool((np.abs(shift_px) > _MIDDLE * np.array(camera.size_px)).any())


def _term(kind: Kind, found: SystematicErrors, camera: Camera, height_m: float) -> str:
    """Return the term with its size: at the corner that it displaces most, or by component."""
    coefficients = np.array(found.coefficients[kind])
    if kind == "position offset":
        each = zip(("forward", "left"), coefficients, found.stds[kind], strict=True)
        sure = [f"{axis} {at:+.2f} ± {std:.1g} m" for axis, at, std in each if abs(at) > SURE_SIGMAS * std]
        alike_px = float(np.linalg.norm(coefficients)) / height_m * camera.focal_px[0]
        sure.append(f"as much as {_figure(alike_px)} px of the principal point")
        return f"positions off by {', '.join(sure)}"
    if kind == "principal point":
        u, v = coefficients * camera.focal_px
        return f"principal point off by {u:+.2g}, {v:+.2g} px"
    corners = camera.rays(camera.undistort(camera.corners_px))[:, :2]
    displaced = lens_displacement(camera.lens, kind, coefficients, corners) * camera.focal_px
    largest = float(np.linalg.norm(displaced, axis=1).max())
    if kind == "decentring":
        return f"tangential terms: {_figure(largest)} px at the corners"
    inward = np.sum(displaced * corners) < 0
    return f"radial terms r³ and r⁵: {_figure(largest)} px {'inward' if inward else 'outward'} at the corners"


def _figure(size: float) -> str:
    return f"{size:.0f}" if size >= 10.0 else f"{size:.2g}"
