"""A term has a plain name that a pilot can tell from all others."""

from __future__ import annotations

from slam.simulation.terms import CATALOGUE


def test_every_term_has_a_short_plain_name_of_its_own():
    titles = [term.title for term in CATALOGUE.values()]
    assert len(set(titles)) == len(titles)
    for title in titles:
        assert 0 < len(title) <= 40
        assert "_" not in title
        assert title[-1].isalpha()
