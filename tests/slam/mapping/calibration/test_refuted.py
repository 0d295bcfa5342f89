"""Which held calibrations errors refute, and what frees them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from backend.bundle.accuracy.systematic_errors import SystematicErrors
from backend.bundle.accuracy.systematic_terms import Kind
from slam.mapping.calibration.antenna import NOMINAL_ANTENNA_STD_M, refusal_of_antenna
from slam.mapping.calibration.refuted import Suspects, suspects
from tests.backend.bundle.test_antenna import RTK, flown, refined


def errors(*kinds: Kind, excess: float = 2.0, alternatives: tuple[Kind, ...] = ()) -> SystematicErrors:
    each = dict.fromkeys(kinds, (0.1, 0.1))
    return SystematicErrors(each, each, alternatives, 1e-6, excess, 0.1, 0.0)


def test_an_error_suspects_what_is_held_and_makes_it() -> None:
    held, free = (refined(flown(0), np.zeros(3), std_m) for std_m in (0.0, 0.2))
    assert suspects(held, None) == Suspects((), ())
    assert suspects(held, errors("radial")) == Suspects(("lens",), ())
    assert suspects(held, errors("radial", excess=0.5)) == Suspects((), ())
    assert suspects(held, errors("position offset", excess=0.5)) == Suspects(("antenna",), ())
    assert suspects(held, errors("position offset", "radial")) == Suspects(("lens", "antenna"), ())
    ambiguous = errors("position offset", alternatives=("principal point",))
    assert suspects(held, ambiguous) == Suspects(("antenna",), ("lens",))
    assert suspects(free, ambiguous) == Suspects((), ())


@pytest.mark.parametrize(("std_m", "refused"), [(0.02, False), (5.0, True)])
def test_an_antenna_is_taken_only_where_positions_tell_it(std_m: float, refused: bool) -> None:
    scene = replace(RTK, pixel_std=0.02, told_pixel_std=0.02, position_std_m=(std_m, std_m))
    trial = refined(flown(0, scene), np.zeros(3), NOMINAL_ANTENNA_STD_M)
    assert ("does not tell the antenna's place" in refusal_of_antenna(trial)) == refused
