"""Each of 52 faults has the outcome that is promised: one line and nothing written, a warning, or the same
result again."""

from __future__ import annotations

import re

import pytest

from tests.slam.faults.fault import Event, Fault, Sources, parameters, told
from tests.slam.faults.of_files import FAULTS as OF_FILES
from tests.slam.faults.of_geometry import FAULTS as OF_GEOMETRY
from tests.slam.faults.of_sensors import FAULTS as OF_SENSORS

FAULTS: tuple[Fault | Event, ...] = (*OF_FILES, *OF_SENSORS, *OF_GEOMETRY)


@pytest.fixture(scope="module")
def sources(tmp_path_factory) -> Sources:
    return Sources(tmp_path_factory.mktemp("whole"))


def line_of(fault: Fault | Event, sources: Sources, place) -> str:
    return told(fault, sources, place) if isinstance(fault, Fault) else fault.play(sources, place)


@pytest.mark.parametrize("fault", parameters(FAULTS))
def test_a_fault_has_the_outcome_that_is_promised(fault, sources, tmp_path):
    line = line_of(fault, sources, tmp_path)
    assert re.search(fault.said, line), line
