"""Texts of shares and of uncertain values."""

from __future__ import annotations

import pytest

from slam.core.units import error_length, percent, round_length, to_error, with_error


def test_whole_percents_have_no_exponent():
    assert [percent(x).replace("\N{NO-BREAK SPACE}", " ") for x in (0.999, 0.996, 0.0312, 1.0, 0.00063)] == [
        "100 %", "100 %", "3.1 %", "100 %", "0.063 %",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (0.0176, "18 mm"),
        (0.00184, "1.8 mm"),
        (0.00509, "5 mm"),
        (0.1471, "0.15 m"),
        (0.63, "0.6 m"),
        (35.0, "35 m"),
    ],
)
def test_an_uncertainty_has_two_digits_up_to_35_and_one_above(error: float, told: str) -> None:
    assert error_length(error).replace("\N{NO-BREAK SPACE}", " ") == told


@pytest.mark.parametrize(
    ("value", "std", "sign", "text"),
    [
        (0.97034, 0.0174, "", "0.970 ± 0.017"),
        (-15.72, 11.5, "+", "-16 ± 12"),
        (0.0123, 0.004, "+", "+0.012 ± 0.004"),
        (1.0, 0.003, "", "1.0000 ± 0.0030"),
        (1234.0, 56.0, "", "1234 ± 56"),
        (2.0, 0.0, "", "2 ± 0"),
        (2.0, float("inf"), "", "2 ± inf"),
    ],
)
def test_a_value_has_the_digits_of_its_uncertainty(value: float, std: float, sign: str, text: str) -> None:
    assert with_error(value, std, sign).replace("\N{NO-BREAK SPACE}", " ") == text


def test_lengths_chosen_as_round_have_no_more_digits() -> None:
    assert to_error(1234.5, float("nan")) == "1234"
    assert round_length(0.5).replace("\N{NO-BREAK SPACE}", " ") == "0.5 m"
