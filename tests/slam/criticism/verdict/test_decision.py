"""What is said of causes beside something that no term of the catalogue is."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from slam.criticism.verdict.criticism import Cause, Gain
from slam.criticism.verdict.decision import decide, shared_with_unknown
from slam.criticism.verdict.posterior import NOTHING, SOMETHING_ELSE, Posterior

GAIN = Gain(50.0, (30.0, 60.0), "flight", (25.0, 25.0), ())


def cause(name: str, probability: float = 1.0) -> Cause:
    return Cause(name, probability, {}, GAIN, 20.0, 30.0, (name,))


def verdict_on(causes: tuple[Cause, ...], unknown: float) -> str:
    odd = SimpleNamespace(name="vehicle.drag_1_s out of range", directions=())
    posterior = Posterior({SOMETHING_ELSE: unknown, NOTHING: 0.0}, (), (), 0.0)
    found = SimpleNamespace(chosen=(odd,) if unknown > 0.5 else ())
    return decide(causes, found, posterior, [], [], 4.5)[0]


def test_a_cause_that_contradicts_itself_beside_something_unknown_is_not_claimed():
    causes = shared_with_unknown([cause("flow_scale"), cause("gusts")], ["flow_scale", "gusts"])
    assert [c.probability for c in causes] == [0.5, 0.5]
    assert verdict_on(causes, unknown=1.0) == "unknown"


def test_one_that_is_the_same_everywhere_is_claimed_with_a_remainder():
    causes = shared_with_unknown([cause("flow_scale"), cause("gusts")], ["gusts"])
    assert verdict_on(causes, unknown=1.0) == "named_with_remainder"


@pytest.mark.parametrize("probability", [0.97, 1.0])
def test_one_by_itself_is_named(probability: float):
    assert verdict_on((cause("flow_scale", probability),), unknown=0.01) == "named"
