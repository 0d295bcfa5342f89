"""The numbers of the lens that a map has estimated, beside what was told of them."""

from __future__ import annotations

from collections.abc import Mapping

from backend.bundle.lens import NAMES, told_calibration
from backend.bundle.refinement import Bundle
from slam.core.instrument_errors import LensNumber


def lens_numbers(bundle: Bundle | None) -> Mapping[str, LensNumber] | None:
    """Return each number of the calibration by its name; None if the calibration was held."""
    if bundle is None or bundle.lens is None:
        return None
    lens, told = bundle.lens, told_calibration(bundle.optimum.problem.camera)
    rows = zip(
        lens.calibration.tolist(), lens.std.tolist(), told.tolist(), lens.told_std.tolist(),
        lens.is_estimated.tolist(), strict=True,
    )  # fmt: skip
    return {name: LensNumber(*row) for name, row in zip(NAMES[lens.model], rows, strict=True)}
