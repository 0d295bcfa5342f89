"""Which of what stands out the search takes."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from slam.criticism.search.effects import Effect, relaxations
from slam.criticism.search.look import Standing
from slam.criticism.search.search import _doubtful, _refitted, beyond
from slam.progress import Tally, silent

BRAKE = Effect("active_braking", relaxes=("k_b",))
BIAS = Effect("gyro_bias", relaxes=("x", "y", "z"))


def test_a_term_that_says_why_goes_before_a_constant_out_of_its_range_that_explains_little_more():
    drag = next(e for e in relaxations() if e.name.startswith("vehicle.drag"))
    loose = Standing(drag, 30.0, 7.7)
    assert Standing(BRAKE, 28.0, 7.5).worth > loose.worth > Standing(BRAKE, 20.0, 6.3).worth


def test_each_number_costs():
    assert (
        Standing(BIAS, 22.0, 6.0).worth < Standing(BRAKE, 20.0, 6.3).worth < Standing(BIAS, 26.0, 6.6).worth
    )


def test_where_nothing_stands_out_nothing_is_taken():
    nowhere = Standing(BIAS, float("nan"), float("nan"))
    assert beyond([], 4.0) == beyond([nowhere], 4.0) == beyond([Standing(BIAS, 7.0, 3.0)], 4.0) == []
    # What explains most decides whether to look further, what is worth most is taken.
    small, large, faint = Standing(BRAKE, 20.0, 6.3), Standing(BIAS, 22.0, 6.0), Standing(BRAKE, 4.0, 2.8)
    assert beyond([large, small, faint], 4.0) == [small, large]
    assert beyond([faint, small], 4.0) == []


def test_of_what_explains_the_same_far_off_each_is_fitted_before_one_is_chosen():
    def standing(name: str, z: float, nats: float) -> Standing:
        return Standing(Effect(name, relaxes=(name,)), nats, z)

    def doubtful(*some: Standing) -> list[str]:
        return [s.effect.name for s in _doubtful(some)]

    bias, slant = standing("sonar_bias", 12.0, 80.8), standing("sonar_slant", 11.0, 60.0)
    cushion = standing("ground_effect", 12.0, 81.1)
    assert doubtful(cushion, bias, slant) == ["ground_effect", "sonar_bias"]
    assert doubtful(bias, slant) == []
    assert doubtful(standing("sonar_bias", 5.0, 12.4), standing("ground_effect", 5.0, 12.3)) == []
    assert doubtful(standing("sonar_bias", 30.0, 450.0), slant) == ["sonar_bias", "sonar_slant"]


def test_by_how_much_a_candidate_that_is_beaten_falls_behind_is_kept(monkeypatch):
    """A look from the healthy vehicle does not tell what another term does in the chosen one's place."""
    nats = {"ground_effect": 90.0, "sonar_bias": 60.0, "sonar_slant": 89.0}
    fits = {None: 0.0} | nats

    def refit(records, model, setting, effects):
        return fits[effects[-1].name if effects else None], setting

    monkeypatch.setattr("slam.criticism.search.search.refit", refit)
    candidates = [Effect(name, relaxes=(name,)) for name in nats]
    look = SimpleNamespace(setting=None)

    def leads(z: float) -> dict[str, float]:
        ranked = [Standing(e, nats[e.name], z) for e in candidates]
        found = _refitted([], None, look, [], ranked, Tally(silent, "try causes"))
        assert (found.effect.name, found.rivals) == ("ground_effect", ("sonar_slant",))
        return {other: lead for (_, other), lead in found.leads.items()}

    assert leads(12.0) == pytest.approx({candidates[1].label: 30.0, candidates[2].label: 1.0})
    # Compared in part of the flights only.
    assert leads(30.0) == {}
