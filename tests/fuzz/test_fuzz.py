"""Mutations of every format are read or refused in one line. ``tests.fuzz.fuzz`` runs more of them."""

from __future__ import annotations

import time

import numpy as np
import pytest

from tests.fuzz.formats import FORMATS, PICTURES
from tests.fuzz.fuzz import fuzz, time_limit
from tests.fuzz.mutations import mutated

SEED = 0
FEW, MANY, MANY_PICTURES = 15, 2000, 500


def assert_no_faults(outcome) -> None:
    assert not outcome.faults, "\n".join(f"{kind}: {case}" for kind, case in outcome.faults.items())


@pytest.mark.parametrize("name", FORMATS)
def test_some_mutations(name, tmp_path):
    assert_no_faults(fuzz(FORMATS[name], SEED, FEW, tmp_path))


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_many_mutations(name, tmp_path):
    outcome = fuzz(FORMATS[name], SEED + 1, MANY_PICTURES if name in PICTURES else MANY, tmp_path)
    assert_no_faults(outcome)
    assert outcome.read > 0
    assert outcome.refused > 0 or name in PICTURES, "a photograph that is refused is left out of its set"


@pytest.mark.parametrize("name", FORMATS)
def test_the_whole_input_is_read(name, tmp_path):
    """Otherwise the mutations would test a refusal only."""
    form = FORMATS[name]
    found = [form.holds(form.read(tmp_path, path)) for path in form.make(tmp_path)]
    assert found == list(form.whole)


def test_mutations_follow_the_seed_and_change_the_data():
    data = b"a: 1\nb: [2, 3]\n" * 5
    made = [mutated(data, np.random.default_rng([7, case])) for case in range(200)]
    assert made == [mutated(data, np.random.default_rng([7, case])) for case in range(200)]
    assert len(set(made)) > 150


def test_a_hang_is_a_fault():
    with pytest.raises(TimeoutError), time_limit(0.05):
        time.sleep(5)
