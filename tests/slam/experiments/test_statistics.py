"""Spreads, verdicts, and what is computed of them."""

import numpy as np
import pytest

from slam.experiments.experiment import (
    Conclusion,
    Row,
    SeedStatistics,
    Trial,
    over_seeds,
    text,
    verdict,
)
from slam.experiments.output import headline, shown, table


def test_a_spread_is_of_what_is_known():
    found = SeedStatistics.of([*np.arange(101.0), np.nan, np.inf])
    assert (found.median, found.lower95, found.upper95, found.seeds) == (50.0, 2.5, 97.5, 101)
    assert np.isnan(SeedStatistics.of([np.nan]).median)
    assert SeedStatistics.of([]).seeds == 0


def test_a_trial_without_the_figure_does_not_count():
    trials = (Trial(0, {"a": 1.0}), Trial(1, {}), Trial(2, {"a": 3.0}))
    assert over_seeds(trials, "a") == SeedStatistics(2.0, pytest.approx(1.05), pytest.approx(2.95), 2)


def test_words():
    assert verdict(True, partly=True) == "agrees"
    assert verdict(False, partly=True) == "agrees in part"
    assert verdict(False) == "does not agree"
    assert text(SeedStatistics(1.0, 0.5, 1.5, 9), "%") == "1.00 % (0.50 to 1.50 %)"
    assert shown(SeedStatistics(0.04217, 0.04, 0.05, 20)) == "0.0422 (0.0400 to 0.0500)"
    assert shown(SeedStatistics(1234.5, 1234.5, 1234.5, 1)) == "1234"
    assert Conclusion((), "agrees", "as it should.").sentence == "Agrees: as it should."


def test_the_papers_columns_come_first():
    one, two = (
        Row("a", "m", {"paper": 1.0}, {"ours": SeedStatistics.of([2.0])}),
        Row("b", "1", {}, {"more": SeedStatistics.of([3.0])}),
    )
    made = table(Conclusion((one, two), "agrees", ""))
    assert made.columns == ("", "", "paper", "ours", "more")
    assert made.paper == 1
    assert made.rows == (("a", "m", "1.00", "2.00", ""), ("b", "", "", "", "3.00"))
    lines = headline("x", Conclusion((one, two), "agrees", ""))
    assert lines[0] == ("x", "a", "", "agrees")
    assert lines[1:] == (("", "  paper", "1.00 m", ""), ("", "  ours", "2.00 m", ""))
