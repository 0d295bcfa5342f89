"""Messages about the mosaic that a command writes."""

from __future__ import annotations

from slam.cli.results import _ground_messages
from slam.core.estimate import GroundFacts
from slam.core.messages import Kind
from slam.core.units import percent

MEASURED = GroundFacts(
    misregistration_px=(0.2, 0.5), over_floor_px=(0.3, 4.0), relief_share=0.1, filled_share=0.2, highest_m=2.5
)


def test_measured_relief_is_a_note():
    (message,) = _ground_messages(MEASURED, True)
    assert message.kind is Kind.NOTE
    assert f"{percent(0.1)} of the ground is not flat: heights were measured" in message.text


def test_relief_that_no_two_pictures_show_is_a_warning():
    """Two pictures alone once told heights from 0.00 to 0.00 m as measured."""
    flat = GroundFacts(
        misregistration_px=(2.0, 4.0), over_floor_px=(2.0, 4.0), relief_share=0.6, filled_share=1.0
    )
    (message,) = map(str, _ground_messages(flat, True))
    assert "no two pictures show its height" in message
    assert "agree only within 4 px" in message


def test_a_flat_floor_is_not_told():
    assert _ground_messages(GroundFacts(misregistration_px=(0.2, 0.5), over_floor_px=(0.2, 0.5)), True) == []


def test_ground_on_which_pictures_do_not_agree_is_a_note_with_its_place():
    facts = GroundFacts(
        misregistration_px=(0.2, 0.5),
        over_floor_px=(0.2, 0.5),
        unmatched_share=0.1,
        unmatched_at_m=(8.04, -12.0),
    )
    (message,) = _ground_messages(facts, True)
    assert message.kind is Kind.NOTE
    assert f"on {percent(0.1)} of the ground the pictures do not agree" in message.text
    assert "x = 8.0, y = -12.0 m" in message.text
