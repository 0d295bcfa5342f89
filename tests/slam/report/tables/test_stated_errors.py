"""A pilot reads how large errors are beside the stated ones, and which sizes chance alone gives."""

from __future__ import annotations

from slam.evaluation.nees import Consistency
from slam.report.tables.evaluation import as_stated


def test_errors_are_told_as_multiples_of_the_stated_ones():
    words = as_stated(Consistency(dof=6, mean=24.0, lower95=1.5, upper95=13.5, n_eff=3.0))
    assert words.startswith("2.00 times as large as stated")
    assert "0.50 to 1.50 times" in words
