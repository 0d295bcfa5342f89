"""Fixed calibrations that a flight refutes: those of the lens, the antenna and the height sensor.

A refuted calibration becomes a free parameter, with which the flight is mapped again. It stays fixed where
the flight does not tell it from the others, because then another cause explains the same residuals.

A lens that is stated with an uncertainty is a free parameter already, but within that. It is refuted where
the evidence of a wider prior is very strong (`backend.bundle.lens_evidence`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from backend.bundle.accuracy.systematic_errors import ErrorTest, SystematicErrors
from backend.bundle.accuracy.systematic_terms import LENS_KINDS, Kind
from backend.bundle.lens_evidence import log_evidence_of_priors
from backend.bundle.range_evidence import RangePrior
from backend.bundle.refinement import Bundle
from backend.significance import VERY_STRONG_NATS
from backend.sparse_cholesky import SingularMatrixError
from frontend.camera import Camera
from slam.core.flight import Flight
from slam.core.lens_priors import PLAUSIBLE_FOCAL, as_assumed, as_nominal
from slam.core.messages import Message, about
from slam.core.streams import Gps
from slam.mapping.calibration.antenna import FARTHEST, NOMINAL_ANTENNA_STD_M, refusal_of_antenna
from slam.mapping.calibration.height_sensor import with_range_prior
from slam.mapping.map import Map
from slam.mapping.part_measurements import pinhole_model
from slam.mapping.setup import Setup

Array = NDArray[np.float64]
Fixable = Literal["lens", "antenna", "height sensor"]
FIXABLE: tuple[Fixable, ...] = ("lens", "antenna", "height sensor")
"""Calibrations that may be fixed."""
_KINDS: dict[Fixable, tuple[Kind, ...]] = {"lens": LENS_KINDS, "antenna": ("position offset",)}
"""Kinds of errors of the pictures that each calibration makes where it is wrong."""


_SUSPECT = 0.05
"""Probability by chance of a fixed lens's score below which its evidence is computed, which then decides: one
flight in twenty with a right lens is refined once more."""


@dataclass(frozen=True)
class Refuted:
    """A calibration that the map has as a free parameter because the pictures refute what is stated of it."""

    what: Fixable
    errors: SystematicErrors | None
    """The errors of the map in which it is fixed; None of a calibration that the evidence refutes."""
    stated_ranges: RangePrior | None = None
    """How well gain and zero of a refuted height sensor were stated to be known; None of the others."""

    @property
    def still_fixed_warning(self) -> Message | None:
        """The warning where no map came out with it free; None where the errors of the map have one."""
        if self.errors is not None:
            return None
        stream = "cam0" if self.what == "lens" else "sonar0"
        return about(
            stream,
            f"this flight contradicts what is stated of the {self.what}, and no map came out with what the "
            "flight shows instead",
            "this map has what is stated, and its lengths may be wrong by more than it says",
            f"calibrate the {self.what}, and state how sure that is in {stream}/sensor.yaml",
        )


@dataclass(frozen=True)
class FreeCalibrations:
    """The instruments as stated, with the refuted calibrations as free parameters."""

    camera: Camera
    gps: Gps | None
    ranges: RangePrior | None
    """How well gain and zero of the height sensor are known; None without one."""
    refuted: tuple[Refuted, ...] = ()
    """The calibrations that become free, without a lens of another model that was stated as uncertain."""
    reason: Message | None = None
    """Why a refuted antenna is fixed all the same; None where none is."""
    doubted_lens: Message | None = None
    """Warning about a lens that is refuted and fixed all the same; None where none is."""

    def of(self, flight: Flight) -> Flight:
        """Return a flight with these instruments."""
        return with_range_prior(replace(flight, gps=self.gps), self.ranges)

    def changes_nothing(self, camera: Camera) -> bool:
        """Return whether a map that was made with ``camera`` has all of these parameters already."""
        return not self.refuted and self.camera is camera


@dataclass(frozen=True)
class Suspects:
    """Fixed calibrations that may be the cause of errors."""

    refuted: tuple[Fixable, ...]
    """Those without which the errors are not explained."""
    others: tuple[Fixable, ...]
    """Those that could explain the errors in the place of a refuted one."""

    def free(self, setup: Setup) -> Setup:
        """Return the setup in which all of them are known no better than by nominal values."""
        if "lens" in (*self.refuted, *self.others):
            setup = replace(setup, camera=as_nominal(setup.camera))
        fixes = setup.readings.fixes
        if "antenna" in self.refuted and fixes is not None:
            free = replace(fixes, antenna_std_m=NOMINAL_ANTENNA_STD_M)
            setup = replace(setup, readings=replace(setup.readings, fixes=free))
        return setup


def suspects(bundle: Bundle | None, errors: SystematicErrors | None) -> Suspects:
    """Return the fixed calibrations that may be the cause of errors.

    A lens is refuted by errors that displace the poses by more than their covariances state. The noise of
    positions is estimated from what they differ, an offset included, so that the covariances always include
    it: any offset beyond chance refutes the antenna's place.
    """
    if bundle is None or errors is None:
        return Suspects((), ())
    measured = bundle.optimum.problem.measurements
    fixed: list[Fixable] = [] if bundle.lens is not None or errors.excess <= 1.0 else ["lens"]
    fixed += ["antenna"] if measured.positions and measured.antenna_std_m == 0 else []
    refuted = tuple(what for what in fixed if any(kind in errors.coefficients for kind in _KINDS[what]))
    # An antenna that may replace a lens is no lens: nothing is lost where it stays fixed.
    others: tuple[Fixable, ...] = ()
    if "antenna" in refuted and "lens" not in refuted and bundle.lens is None:
        others = ("lens",) if any(kind in errors.alternatives for kind in LENS_KINDS) else ()
    return Suspects(refuted, others)


def refuted_by_trial(
    trial: Bundle | None, suspected: Suspects, errors: SystematicErrors
) -> tuple[tuple[Refuted, ...], Message | None]:
    """Return the suspects that a ``trial`` with all of them free determines, and why an antenna is none."""
    if trial is None:
        return (), None
    refusal = refusal_of_antenna(trial) if "antenna" in suspected.refuted else None
    determined: dict[Fixable, bool] = {"lens": trial.lens is not None, "antenna": refusal is None}
    return tuple(Refuted(what, errors) for what in suspected.refuted if determined[what]), refusal


def is_fixed_lens_suspect(bundle: Bundle, tested: ErrorTest) -> bool:
    """Return whether a fixed lens may be wrong although no error of it is beyond chance.

    The relief of the ground and the noise of all measurements are estimated with the fixed lens, and grow to
    explain what it gets wrong. Against that noise, the score of the lens has little power.
    """
    if bundle.lens is not None or tested.errors is not None:
        return False
    return any(tested.p_values.get(kind, 1.0) < _SUSPECT for kind in LENS_KINDS)


def is_stated_lens_doubted(camera: Camera, map_: Map) -> bool:
    """Return whether a map contradicts the stated lens, or positions that its lens may have bent.

    The evidence of a wider prior, extrapolated from that one, is then the larger. The distance from what
    is stated does not show it: what is stated as certain pulls the estimate towards itself.
    """
    if map_.stated_accuracy:
        return True
    if map_.bundle is None or map_.bundle.lens is None:
        return False
    return bool(_evidence(camera, map_).argmax() > 0)


def lens_by_evidence(camera: Camera, trial: Map) -> tuple[Camera, Message | None]:
    """Return ``camera`` with its lens known as well as the evidence of a ``trial`` says, else as it is.

    The trial has the widest of the priors, that of `as_assumed`. Where its focal length is implausible, the
    lens stays as stated, and the second result is a warning.
    """
    if trial.bundle is None or trial.bundle.lens is None or trial.camera.lens != camera.lens:
        return camera, None
    evidence = _evidence(camera, trial)
    best = int(np.argmax(evidence))
    if evidence[best] - evidence[0] <= VERY_STRONG_NATS:
        return camera, None
    if implausible := ImplausibleFocal.of(camera, trial):
        return camera, implausible.warning(used=False)
    return with_lens_of(_priors(camera)[best], trial.camera), None


def _priors(camera: Camera) -> tuple[Camera, ...]:
    """Return the lens as stated, the narrowest of the priors, and as wider ones."""
    return camera, as_nominal(camera), as_assumed(camera)


def _evidence(camera: Camera, map_: Map) -> Array:
    """Return the logarithms (3,) of the evidence of each of `_priors` on a map with an estimated lens.

    They are equal where the flight leaves a direction open.
    """
    assert map_.bundle is not None
    priors = _priors(camera)
    try:
        return log_evidence_of_priors(map_.bundle.optimum, [pinhole_model(prior) for prior in priors])
    except SingularMatrixError:
        return np.zeros(len(priors))


@dataclass(frozen=True)
class ImplausibleFocal:
    """A focal length that a map has estimated farther from the stated one than calibrations are wrong by.

    Pixels that are not square, relief and false matches look like another focal length. But one that was only
    assumed may be any, so that the pictures are believed where the estimate is one that lenses have.
    """

    stated_px: float
    found_px: float
    std_ratio: float
    """Relative standard deviation of the widest prior."""
    is_assumed: bool
    """Whether the stated one is no better than an assumed one."""
    is_plausible: bool
    """Whether a lens may have the estimated one."""
    by_positions: bool
    """Whether positions contribute to the estimate."""

    @staticmethod
    def of(camera: Camera, map_: Map) -> ImplausibleFocal | None:
        """Return the implausible estimate of a map made with ``camera``; None for a plausible one."""
        if map_.bundle is None or map_.bundle.lens is None:
            return None
        known, stated_px = camera.stated or camera, camera.stated_numbers[0]
        found_px = map_.camera.focal_px[0]
        std_ratio = as_assumed(known).focal_std_ratio
        if abs(found_px - stated_px) <= FARTHEST * std_ratio * stated_px:
            return None
        low, high = PLAUSIBLE_FOCAL
        return ImplausibleFocal(
            stated_px=stated_px,
            found_px=found_px,
            std_ratio=std_ratio,
            is_assumed=known.focal_std_ratio == std_ratio,
            is_plausible=low < found_px / max(camera.size_px) < high,
            by_positions=map_.georeferenced,
        )

    @property
    def is_believed(self) -> bool:
        """Whether a map is to have the estimate, not the stated focal length."""
        return self.is_assumed and self.is_plausible

    def warning(self, used: bool) -> Message:
        """Return the warning; ``used`` says whether the map has the estimate."""
        origin = "assumed" if self.is_assumed else "stated"
        refuting = "pictures and positions" if self.by_positions else "the pictures"
        known = "" if self.is_assumed else ", which no calibration is wrong by"
        choice = "has that one" if used else f"keeps the {origin} one"
        return about(
            "cam0",
            f"the {origin} focal length, {self.stated_px:.0f} px, contradicts {refuting}, but they "
            f"show {self.found_px:.0f} px{known}: the map {choice}",
            "its heights and slopes are doubted",
            "give the pictures as the camera took them, neither stretched nor cropped, with their tags, or "
            "add control points, or fly at a second height",
        )


def with_fixed_focal(camera: Camera) -> Camera:
    """Return ``camera`` with the lens that was stated before any flight, and its focal length fixed."""
    return replace(as_nominal(camera.stated or camera), focal_std_ratio=0.0)


def with_lens_of(camera: Camera, found: Camera) -> Camera:
    """Return ``camera`` with the lens that was ``found``, and what was stated of it before any flight."""
    return replace(
        camera,
        focal_px=found.focal_px,
        center_px=found.center_px,
        distortion=found.distortion,
        lens=found.lens,
        stated=camera.stated or camera,
    )
