"""Reasons of rejected links, in memory and in files."""

import pytest

from backend.measurements import CONTRADICTED, UNPROVEN, LinkCheck, Misfit, Rejection


@pytest.mark.parametrize("check", LinkCheck)
@pytest.mark.parametrize("figures", ["", "7.3 sigma (limit 4.1): 1.2 m, 14 deg"])
def test_a_reason_is_read_from_a_file_as_it_was_written(check, figures):
    rejection = Rejection(check, figures)
    assert Rejection.read(str(rejection)) == rejection
    assert rejection.kind == (check.value or figures)


def test_words_of_output_files_stay():
    assert str(Rejection(LinkCheck.GRAPH, "7.3 sigma")) == "disagrees by 7.3 sigma"
    assert str(Rejection(LinkCheck.REACH, "9 m apart")) == "out of reach: 9 m apart"
    assert str(Rejection(LinkCheck.SCALE)) == "implausible change of scale"


@pytest.mark.parametrize(
    "text", ["implausibly far", "disagrees: 3 m", "too few matches, too few lines", "wrong"]
)
def test_a_text_that_only_begins_like_a_check_is_another_reason(text):
    assert Rejection.read(text) == Rejection(LinkCheck.OTHER, text)


def test_the_finding_is_that_of_the_check_and_not_of_its_words():
    assert Rejection(LinkCheck.OTHER, "disagrees by 9 sigma").check.finding == UNPROVEN
    assert Rejection(LinkCheck.GRAPH, "").check.finding == CONTRADICTED


def test_the_misfit_of_a_link_is_read_from_its_figures():
    misfit = Misfit(0.00012, "heights", 14.0)
    figures = f"7.3 sigma (each 1.8 of a stated one, as the loops show; limit 4.1): {misfit}"
    assert Rejection.read(f"disagrees by {figures}").misfit == misfit
    assert Rejection(LinkCheck.PLACE, figures).misfit is None
    assert Rejection(LinkCheck.GRAPH, "7.3 sigma").misfit is None
