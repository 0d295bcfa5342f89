"""Each of 52 faults has the outcome that is promised: one line and nothing written, a warning, or the same
result again."""

from __future__ import annotations

import re

import pytest

from tests.slam.faults.fault import Event, Fault, Sources, outcome, parameters
from tests.slam.faults.of_files import FAULTS as OF_FILES
from tests.slam.faults.of_geometry import FAULTS as OF_GEOMETRY
from tests.slam.faults.of_processes import FAULTS as OF_PROCESSES
from tests.slam.faults.of_recordings import FAULTS as OF_RECORDINGS
from tests.slam.faults.of_sensors import FAULTS as OF_SENSORS

FAULTS: tuple[Fault | Event, ...] = (*OF_FILES, *OF_SENSORS, *OF_GEOMETRY, *OF_RECORDINGS, *OF_PROCESSES)


@pytest.fixture(scope="module")
def sources(tmp_path_factory) -> Sources:
    return Sources(tmp_path_factory.mktemp("whole"))


def line_of(fault: Fault | Event, sources: Sources, place) -> str:
    return outcome(fault, sources, place) if isinstance(fault, Fault) else fault.play(sources, place)


def test_the_catalogue_has_all_52():
    assert {fault.number for fault in FAULTS} == set(range(1, 53))


@pytest.mark.parametrize("fault", parameters(FAULTS))
def test_a_fault_has_the_outcome_that_is_promised(fault, sources, tmp_path):
    line = line_of(fault, sources, tmp_path)
    assert re.search(fault.message, line), line


@pytest.mark.slow
def test_the_score(sources, tmp_path, capsys):
    """The share of the 52 faults of which every case has the promised outcome."""
    failed: dict[int, list[str]] = {}
    for k, fault in enumerate(FAULTS):
        place = tmp_path / str(k)
        place.mkdir()
        try:
            line = line_of(fault, sources, place)
            assert re.search(fault.message, line), line
        except AssertionError as error:
            failed.setdefault(fault.number, []).append(f"{fault.name}: {str(error)[:300]}")
    numbers = {fault.number for fault in FAULTS}
    with capsys.disabled():
        print(f"\nfault score: {len(numbers - failed.keys())} of {len(numbers)}, {len(FAULTS)} cases")
    assert not failed, failed
