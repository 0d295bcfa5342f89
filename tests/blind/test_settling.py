"""A manoeuvre settles what it is known to settle, and rest settles nothing: by the blind vehicle itself."""

from __future__ import annotations

import pytest

from slam.simulation.healthy.manoeuvres import MANOEUVRES
from tests.blind.cases import Case, Hidden
from tests.blind.faults import UNTELLABLE
from tests.blind.score import Answer
from tests.blind.settling import SETTLED, separation, settles

SIZES = {"steady_wind": 0.09, "trim_offset": 0.0045, "asymmetric_drag": 0.35, "control_latency": 0.065}
"""As the cases have them that were run."""
OPEN = [b for b in UNTELLABLE if b.strength is not None]
ALL_BUT_ONE_SLOW = [b if k == 1 else pytest.param(b, marks=pytest.mark.slow) for k, b in enumerate(OPEN)]


def case_of(blind) -> Case:
    hidden = Hidden(blind.fault, SIZES[blind.fault], None, "", blind.strength, known=True)
    return Case("case_000", "untellable", (), 40.0, (hidden,), blind.equivalents, settled_by=blind.settled_by)


@pytest.mark.slow
@pytest.mark.parametrize("blind", ALL_BUT_ONE_SLOW)
def test_what_is_known_to_settle_it_does_and_rest_does_not(blind):
    case = case_of(blind)
    known = [name for name in MANOEUVRES if blind.settled_by in name]
    best = next(name for name in known if "between" in name or "short" in name or "to the side" in name)
    assert separation(case, best, 4) > SETTLED
    assert separation(case, "hover for 8 s", 4) < 0.5
    # Four times the flights, twice the sigmas: less where priors of nuisances tell something once only.
    assert 1.3 < separation(case, best, 4) / separation(case, best, 1) < 2.01


@pytest.mark.parametrize(
    "said", [None, "", "turn", "fly 'a loop' once: 9.0 sigma", "fly 'hover for 8 s' 3 times"]
)
def test_only_a_manoeuvre_of_the_list_that_tells_settles(said):
    wind = next(b for b in OPEN if b.fault == "steady_wind")
    assert not settles(Answer(case_of(wind), {"verdict": "ambiguous", "next_flight": said}))
