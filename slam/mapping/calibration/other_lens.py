"""A lens that the pictures show instead of the one that was told."""

from __future__ import annotations

from dataclasses import dataclass, replace

from backend.bundle.refinement import Bundle
from backend.bundle.systematic_errors import SystematicErrors
from backend.bundle.systematic_terms import LENS_KINDS
from frontend.camera import Camera


@dataclass(frozen=True)
class OtherLens:
    """The camera with the lens that the pictures show."""

    camera: Camera
    refuted: SystematicErrors | None
    """Errors that a lens told as certain leaves in the residuals; None where it was told as uncertain."""


def is_refuted(bundle: Bundle | None, errors: SystematicErrors | None) -> bool:
    """Return whether errors of a held lens displace the poses by more than their covariances state."""
    if bundle is None or bundle.lens is not None or errors is None:
        return False
    return errors.excess > 1.0 and any(kind in LENS_KINDS for kind in errors.coefficients)


def with_lens_of(camera: Camera, found: Camera) -> Camera:
    """Return ``camera`` with the lens that was ``found``, and what was told of it."""
    return replace(
        camera,
        focal_px=found.focal_px,
        center_px=found.center_px,
        distortion=found.distortion,
        lens=found.lens,
        told=camera,
    )
