"""Texts of shares and of uncertain values."""

from __future__ import annotations

import pytest

from slam.core.units import percent, with_error


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (39.98, 0.47, "40.0 ± 0.5"),
        (39.98, 4.7, "40 ± 5"),
        (1.0, 0.003, "1.000 ± 0.003"),
        (1234.0, 56.0, "1234 ± 56"),
        (2.0, 0.0, "2 ± 0"),
        (2.0, float("inf"), "2 ± inf"),
    ],
)
def test_no_error_is_rounded_to_nothing(value: float, std: float, text: str) -> None:
    assert with_error(value, std) == text


def test_a_value_may_show_its_sign() -> None:
    assert with_error(0.0123, 0.004, "+") == "+0.012 ± 0.004"


def test_whole_percents_have_no_exponent():
    assert [percent(x).replace("\N{NO-BREAK SPACE}", " ") for x in (0.999, 0.996, 0.0312, 1.0, 0.00063)] == [
        "100 %", "100 %", "3.1 %", "100 %", "0.063 %",
    ]  # fmt: skip
