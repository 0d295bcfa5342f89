"""Which of what stands out the search takes."""

from __future__ import annotations

from types import SimpleNamespace

from slam.criticism.search import search
from slam.criticism.search.effects import Effect, _at_values, _plain, relaxed_nuisances
from slam.criticism.search.expansion import ScoreTest
from slam.criticism.search.fitted_parameters import fitted_parameter
from slam.criticism.search.search import SearchResult, _doubtful, beyond, with_term_replaced
from slam.simulation.terms import CATALOGUE
from tests.slam.criticism.judged_flights import NOMINAL

BRAKE = Effect("active_braking", relaxes=("k_b",))
BIAS = Effect("gyro_bias", relaxes=("x", "y", "z"))


def test_a_term_takes_precedence_over_a_constant_out_of_range_that_explains_little_more():
    drag = next(e for e in relaxed_nuisances() if e.name.startswith("vehicle.drag"))
    loose = ScoreTest(drag, 30.0, 7.7)
    assert ScoreTest(BRAKE, 28.0, 7.5).worth > loose.worth > ScoreTest(BRAKE, 20.0, 6.3).worth


def test_each_number_costs():
    assert (
        ScoreTest(BIAS, 22.0, 6.0).worth
        < ScoreTest(BRAKE, 20.0, 6.3).worth
        < ScoreTest(BIAS, 26.0, 6.6).worth
    )


def test_where_nothing_stands_out_nothing_is_taken():
    nowhere = ScoreTest(BIAS, float("nan"), float("nan"))
    assert beyond([], 4.0) == beyond([nowhere], 4.0) == beyond([ScoreTest(BIAS, 7.0, 3.0)], 4.0) == []
    # What explains most decides whether to look further, what is worth most is taken.
    small, large, faint = ScoreTest(BRAKE, 20.0, 6.3), ScoreTest(BIAS, 22.0, 6.0), ScoreTest(BRAKE, 4.0, 2.8)
    assert beyond([large, small, faint], 4.0) == [small, large]
    assert beyond([faint, small], 4.0) == []


def test_of_what_explains_the_same_far_off_each_is_fitted_before_one_is_chosen():
    def standing(name: str, z: float, nats: float) -> ScoreTest:
        return ScoreTest(Effect(name, relaxes=(name,)), nats, z)

    def doubtful(*some: ScoreTest) -> list[str]:
        return [s.effect.name for s in _doubtful(some)]

    bias, slant = standing("sonar_bias", 12.0, 80.8), standing("sonar_slant", 11.0, 60.0)
    cushion = standing("ground_effect", 12.0, 81.1)
    assert doubtful(cushion, bias, slant) == ["ground_effect", "sonar_bias"]
    assert doubtful(bias, slant) == []
    assert doubtful(standing("sonar_bias", 5.0, 12.4), standing("ground_effect", 5.0, 12.3)) == []
    assert doubtful(standing("sonar_bias", 30.0, 450.0), slant) == ["sonar_bias", "sonar_slant"]


LAG = Effect("attitude_lag", relaxes=("vehicle.attitude_time_s",))
DRIFT = _plain(CATALOGUE["clock_drift"])[0]
DELAYS = _at_values("control_latency.T", [0.04, 0.08], 0.0)


def replaced(monkeypatch, tried, drift_ppm=0.0):
    """The result of trying effects in place of a lag, which makes the log likelihood -100.

    ``tried``: the log likelihood of a fit with each, which ends at a drift of ``drift_ppm``.
    """
    nats = {LAG.label: -100.0} | {effect.label: x for effect, x in tried}
    fitted = fitted_parameter("clock_drift.ppm").at(NOMINAL, 1e-6 * drift_ppm)
    look = SimpleNamespace(parameters=NOMINAL, own=lambda effect: effect)
    monkeypatch.setattr(search, "refit", lambda *arguments: (nats[arguments[-1][-1].label], fitted))
    monkeypatch.setattr(search, "expand", lambda *_: look)
    found = SearchResult(model=NOMINAL, first=look, last=look, chosen=(LAG,))
    return with_term_replaced(found, LAG, [(effect,) for effect, _ in tried])


def test_a_fit_that_ends_far_beyond_the_plausible_replaces_nothing(monkeypatch):
    assert replaced(monkeypatch, [(DRIFT, -20.0)], drift_ppm=400.0).chosen == (DRIFT,)
    kept = replaced(monkeypatch, [(DRIFT, -20.0)], drift_ppm=-7000.0)
    assert kept.chosen == (LAG,)
    assert list(kept.leads.values()) == [float("inf")]


def test_each_way_of_a_term_that_was_fitted_in_vain_has_its_lead(monkeypatch):
    """Otherwise the expansion alone would judge some ways of it, and make them probable."""
    leads = replaced(monkeypatch, list(zip(DELAYS, (-130.0, -107.0), strict=True))).leads
    assert leads == {(LAG.label, way.label): lead for way, lead in zip(DELAYS, (30.0, 7.0), strict=True)}
