"""The answers of a report, by question."""

from __future__ import annotations

from slam.core.instrument_errors import AccelerometerErrors
from slam.core.summary import summarise
from slam.report.answers.checked_lengths import as_asked
from slam.report.answers.questions import pilots_answers
from slam.report.facts import gather

AGAIN = "Was a place recognised again, and is that right?"
SHARES = {"x": {"range": 0.7, "pictures": 0.3}, "y": {"range": 0.5, "pictures": 0.5}, "scale": {"range": 1.0}}


def answers(estimate, flight):
    found = pilots_answers(estimate, summarise(estimate), gather(estimate, flight))
    return {item.label: as_asked(" ".join((item.value, *item.lines))) for item in found}


def by_accelerometer(scale: float, scale_std: float, used: bool) -> AccelerometerErrors:
    """Return lengths by an accelerometer over those of the map, and whether the map uses them."""
    nothing, little = (0.0, 0.0, 0.0), (0.1, 0.1, 0.1)
    return AccelerometerErrors(
        offset_m_s2=nothing, offset_std_m_s2=little, arm_m=nothing, arm_std_m=little,
        scale=scale, scale_std=scale_std, used=used,
    )  # fmt: skip
