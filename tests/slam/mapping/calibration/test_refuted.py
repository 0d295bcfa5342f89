"""Which held calibrations errors refute, and what frees them."""

from __future__ import annotations

from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from backend.bundle.accuracy.systematic_errors import SystematicErrors
from backend.bundle.accuracy.systematic_terms import Kind
from frontend.camera import Camera
from slam.core.flight import Flight
from slam.mapping import main_loop
from slam.mapping.calibration.antenna import NOMINAL_ANTENNA_STD_M, refusal_of_antenna
from slam.mapping.calibration.refuted import (
    Fixable,
    FreeCalibrations,
    ImplausibleFocal,
    Refuted,
    Suspects,
    suspects,
    with_fixed_focal,
    with_lens_of,
)
from slam.mapping.context import Context
from slam.mapping.map import Map
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
    assert ("does not tell the antenna's place" in str(refusal_of_antenna(trial))) == refused


@pytest.mark.parametrize(("what", "stream"), [("height sensor", "sonar0"), ("lens", "cam0")])
def test_a_calibration_that_no_map_came_out_with_is_named(
    what: Fixable, stream: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    refuted = Refuted(what, None)
    free = FreeCalibrations(cast(Camera, None), None, None, (refuted,))
    values = {f.name: cast(Any, None) for f in fields(Context)} | {"job": SimpleNamespace(camera=None)}
    before = main_loop._Finished(Context(**values), cast(Map, None), None, (), False)
    monkeypatch.setattr(main_loop, "free_refuted_calibrations", lambda *_: free)
    monkeypatch.setattr(main_loop, "_again", lambda *_: None)
    found = main_loop._with_refuted_free(before, Flight("small"))
    assert found.context.still_fixed == (refuted,)
    line = str(refuted.still_fixed_warning)
    assert line.startswith(f"{stream}: this flight contradicts what is stated of the {what}")
    assert Refuted(what, errors("radial")).still_fixed_warning is None, "errors of the map have a line"


def stretched_map(told: Camera, focal_px: float, georeferenced: bool = False) -> Map:
    """As much of a map as the test of its focal length needs."""
    bundle = SimpleNamespace(lens=object())
    camera = replace(told, focal_px=(focal_px, focal_px))
    return cast(Map, SimpleNamespace(bundle=bundle, camera=camera, georeferenced=georeferenced))


@pytest.mark.parametrize(
    ("std_ratio", "found_px", "is_odd", "is_believed"),
    [
        (0.1, 640.0, False, True),
        (0.1, 1500.0, True, True),
        (0.1, 52.0, True, False),
        (0.03, 640.0, False, False),
        (0.03, 1500.0, True, False),
    ],
)
def test_an_odd_focal_length_is_believed_against_an_assumed_one_alone(
    std_ratio: float, found_px: float, is_odd: bool, is_believed: bool
) -> None:
    told = Camera((500.0, 500.0), (319.5, 239.5), (640, 480), focal_std_ratio=std_ratio)
    odd = ImplausibleFocal.of(told, stretched_map(told, found_px))
    assert (odd is not None) == is_odd
    if odd is not None:
        assert odd.is_believed == is_believed
        assert f"but they show {found_px:.0f} px" in odd.warning(used=is_believed).text
        assert ("the map has that one" in odd.warning(used=is_believed).text) == is_believed
    # What was told of a lens remains so when a map has estimated it.
    again = with_lens_of(told, stretched_map(told, found_px).camera)
    assert (ImplausibleFocal.of(again, stretched_map(again, found_px)) is not None) == is_odd
    assert with_fixed_focal(again).focal_px == told.focal_px
    assert with_fixed_focal(again).focal_std_ratio == 0.0
