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


def test_every_error_of_an_instrument_names_it_and_every_parameter_its_quantity():
    for term in CATALOGUE.values():
        assert bool(term.instrument) == (term.is_of_instrument and term.family != "place"), term.name
        quantities = [parameter.quantity for parameter in term.parameters]
        assert all(quantities), term.name
        assert len(set(quantities)) == len(quantities), term.name
