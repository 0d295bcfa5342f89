"""What is said of causes beside something that no term of the catalogue is."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from slam.core.progress import silent
from slam.criticism.cause import JUDGED_HORIZON_S, Cause, ChannelError, Gain, Interval
from slam.criticism.finding import ResidualPattern
from slam.criticism.kalman.filter_parameters import filter_parameters_of
from slam.criticism.kalman.kernel_inputs import Perturbation
from slam.criticism.search.effects import Effect
from slam.criticism.search.expansion import ScoreTest, most_alike_first
from slam.criticism.search.fitted_parameters import fitted_parameter
from slam.criticism.search.search import SearchResult
from slam.criticism.search.thresholds import load_thresholds
from slam.criticism.verdict import held_out, judge
from slam.criticism.verdict.criticism import Criticism
from slam.criticism.verdict.held_out import confirmed_terms
from slam.criticism.verdict.judge import (
    Evidence,
    by_importance,
    decide,
    is_unknown,
    left_over,
    ranking,
    split_by_probability,
)
from slam.criticism.verdict.posterior import (
    NOTHING,
    SOMETHING_ELSE,
    Place,
    Posterior,
)
from slam.criticism.verdict.rollout_fit import RolloutFit
from slam.data_quality.finding import Remark
from slam.simulation.model import load_model
from slam.simulation.terms import CATALOGUE

ODD = Effect("vehicle.drag_1_s out of range", relaxes=("vehicle.drag_1_s",))
GAIN = Gain(50.0, (30.0, 60.0), "flight", (25.0, 25.0), ())


def cause(name: str, probability: float = 1.0) -> Cause:
    return Cause(name, probability, {}, GAIN, 20.0, 30.0, (name,))


def reported(*causes: Cause, unknown: float, doubted: tuple[str, ...] = (), out_of_model: bool = False):
    """Verdict, and the probabilities of the causes that are reported and of those that are not."""
    moving, noisier = (Perturbation("x", "sensor"),), (fitted_parameter("gusts@0.7"),)
    forms = {"gusts": {"changes": noisier}, "attitude_lag": {"relaxes": ("vehicle.attitude_time_s",)}}
    terms = [Effect(c.name, **forms.get(c.name, {"perturbations": moving})) for c in causes]
    posterior = Posterior({SOMETHING_ELSE: unknown, NOTHING: 0.0})
    chosen = (*terms, ODD) if unknown > 0.5 else tuple(terms)
    found = SimpleNamespace(model=SimpleNamespace(out_of_model=out_of_model), chosen=chosen)
    likely, faint = split_by_probability(causes, found, posterior, doubted)
    odd = [left_over(e, found) for e in chosen if e is ODD]
    verdict = decide(likely, posterior.probability, [*odd, *[Remark("faint")] * len(faint)])[0]
    return verdict, [c.probability for c in likely], [c.probability for c in faint]


def test_inconsistent_causes_and_process_noise_are_not_claimed_beside_something_unknown():
    causes = cause("flow_scale"), cause("gusts")
    assert reported(*causes, unknown=1.0, doubted=("flow_scale",)) == ("unknown", [0.5, 0.5], [])
    assert reported(*causes, unknown=1.0, doubted=("flow_scale",), out_of_model=True)[1] == [1.0, 1.0]


def test_a_consistent_cause_is_claimed_with_a_remainder():
    causes = cause("flow_scale"), cause("attitude_lag"), cause("gusts")
    verdict, probabilities, _ = reported(*causes, unknown=1.0)
    assert verdict == "named_with_remainder"
    assert probabilities == [1.0, 1.0, 0.5], "a lag is no noise"


def test_a_certain_cause_leads_whatever_a_doubtful_one_gains():
    """Process noise keeps half of its odds beside something unknown, and may gain more than the cause."""
    gusts = replace(cause("gusts", 0.5), gain=replace(GAIN, nats=90.0))
    causes = by_importance([gusts, cause("flow_scale")])
    assert [c.name for c in causes] == ["flow_scale", "gusts"]
    probability = {SOMETHING_ELSE: 1.0, NOTHING: 0.0}
    for order in (causes, causes[::-1]):
        assert decide(order, probability, [Remark("odd")])[0] == "named_with_remainder"
    assert decide([gusts], probability, [Remark("odd")])[0] == "unknown"
    pattern = ResidualPattern.of("roll ~ pitch", 3.0)
    assert decide([gusts], probability, [], [pattern]) == ("unknown", (), (pattern,))


def test_causes_after_the_leading_one_are_told_by_their_probability():
    gains = {"flow_scale": 50.0, "attitude_lag": 96.0, "gusts": 40.0, "control_latency": 30.0}
    probability = {"flow_scale": 0.99, "attitude_lag": 0.04, "gusts": 0.5, "control_latency": 0.96}
    causes = [
        replace(cause(name, probability[name]), gain=replace(GAIN, nats=nats)) for name, nats in gains.items()
    ]
    for order in (causes, causes[::-1]):
        told = [c.name for c in by_importance(order)]
        assert told == ["flow_scale", "control_latency", "gusts", "attitude_lag"]


@dataclass(frozen=True, kw_only=True)
class Predicted(Evidence):
    """Evidence of which some terms predict held-out flights worse, as long as all of them are chosen."""

    missed: dict[tuple[str, ...], float]
    """Chosen terms -> error of the range with them, in m; 0.1 without any."""

    @property
    def causes(self) -> tuple[Cause, ...]:
        names = tuple(e.name for e in self.found.chosen)
        errors = (ChannelError("range", "m", JUDGED_HORIZON_S, 0.1, self.missed.get(names, 0.1)),)
        parts = {"climb_asymmetry": (900.0, -3.0, 1.0), "gyro_bias": (30.0, 20.0, 10.0)}
        gains = {name: Gain.of(np.array(parts[name]), "flight", errors) for name in names}
        return tuple(replace(cause(name), gain=gain) for name, gain in gains.items())

    def findings(self, judged):
        return []

    def completed(self, found):
        return found


@pytest.mark.parametrize(
    ("missed", "claimed"),
    [
        ((0.12, 0.09), ["gyro_bias"]),
        ((0.12, 0.12), []),
        ((0.102, 0.12), ["climb_asymmetry", "gyro_bias"]),
        ((0.09, 0.12), ["climb_asymmetry", "gyro_bias"]),
    ],
)
def test_causes_that_predict_held_out_flights_worse_are_withdrawn(monkeypatch, missed, claimed):
    """First goes what one flight alone shows, however much that flight gains."""
    both = ("climb_asymmetry", "gyro_bias")
    tests = SimpleNamespace(
        score_tests=lambda *of: [], patterns=(), effects=(), detectable=lambda z: {}, confusable=tuple
    )
    found = SearchResult(model=None, first=tests, last=tests, chosen=tuple(map(Effect, both)))
    certain = Posterior({SOMETHING_ELSE: 0.0, NOTHING: 0.0} | dict.fromkeys(both, 1.0))
    no_alternatives: list[tuple[str, ...]] = []
    monkeypatch.setattr(judge, "posterior_of", lambda found, gone: no_alternatives.append(gone) or certain)
    told = judge.judge(
        Predicted(
            found=found, posterior=certain, limits=load_thresholds(), anomalies=(), readings=(), model=None,
            progress=silent, missed=dict(zip([both, both[1:]], missed, strict=True)), refuted=("gusts",),
        )
    )  # fmt: skip
    assert sorted(c.name for c in told.causes) == claimed
    assert [finding.effect for finding in told.findings] == [n for n in both if n not in claimed]
    assert {finding.is_cause for finding in told.findings} <= {False}
    gone = [n for n in both if n not in claimed]
    assert no_alternatives == [("gusts", *gone[: k + 1]) for k in range(len(gone))]


def test_a_cause_weaker_than_the_remainder_is_doubted():
    found = SimpleNamespace(model=SimpleNamespace(out_of_model=False), chosen=(ODD,))
    posterior = Posterior({SOMETHING_ELSE: 1.0, NOTHING: 0.0})
    for left_z, probability in ((17.4, 1.0), (25.0, 0.5)):
        (drag,), _ = split_by_probability([cause("quadratic_drag")], found, posterior, (), left_z)
        assert drag.z == 20.0
        assert drag.probability == probability


def test_two_reported_causes_are_not_reported_as_equivalent():
    causes = cause("sonar_lag"), cause("yaw_drag")
    verdict, alike, _ = decide(causes, {SOMETHING_ELSE: 0.0, NOTHING: 0.0}, [])
    assert (verdict, alike) == ("named", ("sonar_lag",))


def test_nothing_is_wrong_only_if_no_single_reading_is():
    expansion = SimpleNamespace(score_tests=lambda rest, effects: [], effects=())
    found = SimpleNamespace(first=expansion)
    probability = {NOTHING: 0.8, SOMETHING_ELSE: 0.1}
    odd = replace(cause("sonar_spikes"), probability=0.99)
    ranks = {r.name: r for r in ranking(found, probability, [odd])}
    assert ranks[NOTHING].probability == pytest.approx(0.008)
    assert ranks[SOMETHING_ELSE].probability == 0.1
    assert ranks["sonar_spikes"].z == 20.0
    single = {name for name, term in CATALOGUE.items() if term.in_single_readings}
    assert {name for name in single if ranks[name].z == 0.0} == single - {"sonar_spikes"}


def test_each_cause_is_reported_with_its_alternatives():
    second = replace(cause("steady_wind"), alternatives=("steady_wind", "trim_offset"))
    reported_alike = Criticism("named_with_remainder", "", (cause("flow_scale"), second)).to_json()["causes"]
    assert [c["equivalence_set"] for c in reported_alike] == [["flow_scale"], ["steady_wind", "trim_offset"]]


def test_an_improbable_cause_is_left_over():
    assert reported(cause("flow_scale", 0.01), unknown=0.9) == ("unknown", [], [0.01])


def test_nothing_improbable_is_claimed_for_an_out_of_model_vehicle():
    causes = cause("tilt_limit"), cause("flow_scale", 0.0)
    assert reported(*causes, unknown=1.0, out_of_model=True) == ("named_with_remainder", [1.0], [0.0])


def test_held_out_rollouts_raise_a_set_and_do_not_choose_in_it():
    alike = ("tilt_limit", "command_nonlinearity")
    weak = {NOTHING: 0.0, SOMETHING_ELSE: 1.0, "tilt_limit": 0.03, "command_nonlinearity": 0.01}
    weak |= {"flow_scale": 1.0}
    posterior = Posterior(
        weak, tuple(Place(names, 0.0, "") for names in (alike, ("active_braking", "flow_scale")))
    )
    tied = {"tilt_limit": ("command_nonlinearity",)}
    raised = posterior.raised({"tilt_limit": 0.96, "active_braking": 0.9}, tied).probability
    assert raised["tilt_limit"] == raised["command_nonlinearity"] == pytest.approx(0.48)
    # What only the likelihood of wrong equations prefers has what is left.
    assert raised["active_braking"] == pytest.approx(0.9)
    assert raised["flow_scale"] == pytest.approx(0.1)
    assert posterior.raised({"tilt_limit": 0.02}, tied).probability == weak
    lead = replace(cause("tilt_limit", 0.48), alternatives=alike)
    assert not is_unknown([lead], {SOMETHING_ELSE: 1.0, "command_nonlinearity": 0.48})
    assert is_unknown([lead], {SOMETHING_ELSE: 1.0})
    assert lead.with_alternatives({"command_nonlinearity": 1.0}) == 1.0


def test_flights_without_a_confirmed_cause_are_judged_as_at_first():
    assert confirmed_terms(SearchResult(model=None, first="first", last="last", chosen=())).last == "first"
    limit = Effect("tilt_limit", relaxes=("tilt_limit.limit",))
    plain = SimpleNamespace(effects=(limit,), score_tests=lambda rest, among: [SimpleNamespace(z=100.0)])
    found = SearchResult(model=None, first=plain, last="last", chosen=(limit,))
    assert confirmed_terms(found).last == "last"


def test_a_faint_limit_that_held_out_flights_contradict_is_taken_back(monkeypatch):
    limit = Effect("tilt_limit", relaxes=("tilt_limit.limit",))
    faint = SimpleNamespace(effects=(limit,), score_tests=lambda rest, among: [SimpleNamespace(z=4.0)])
    for total, chosen in ((-178.0, ()), (12.0, (limit,))):
        monkeypatch.setattr(held_out, "held_out", lambda *of, total=total: SimpleNamespace(total=total))
        found = SearchResult(model=None, first=faint, last="last", chosen=(limit,))
        assert confirmed_terms(found).chosen == chosen


def test_what_no_other_part_could_confirm_is_named_with_a_remainder():
    alone = replace(cause("flow_scale"), gain=Gain(50.0, (50.0, 50.0), "segment", (50.0,), ()))
    assert reported(alone, unknown=0.0)[0] == "named_with_remainder"
    seen = replace(alone, gain=replace(alone.gain, by=None))
    assert reported(seen, unknown=0.0)[0] == "named"


@pytest.mark.parametrize("probability", [0.97, 1.0])
def test_one_by_itself_is_named(probability: float):
    assert reported(cause("flow_scale", probability), unknown=0.01)[0] == "named"


def test_rounding_errors_do_not_change_which_terms_look_most_alike():
    for error in (-1e-12, 1e-12):
        pairs = [("a", "z", 0.95 + error), ("a", "b", 0.95), ("c", "d", 0.97)]
        assert [pair[:2] for pair in most_alike_first(pairs)] == [("c", "d"), ("a", "b"), ("a", "z")]


def test_rounding_errors_do_not_change_which_pattern_is_strongest():
    for error in (-1e-9, 1e-9):
        tests = [ScoreTest(Effect(name), 5.0, z) for name, z in (("b", 4.5 + error), ("a", 4.5), ("c", 6.0))]
        last = SimpleNamespace(score_tests=lambda *_, tests=tests: tests, patterns=())
        found = SimpleNamespace(chosen=(), last=last, model=SimpleNamespace(out_of_model=False))
        posterior = SimpleNamespace(probability={SOMETHING_ELSE: 0.0})
        evidence = SimpleNamespace(
            found=found, posterior=posterior, doubts={}, limits=load_thresholds(), anomalies=(), causes=()
        )
        left = judge._judged(evidence).left
        assert [pattern.name for pattern in left] == ["c", "a", "b"]


@pytest.mark.parametrize("std", [{}, {"gyro_bias.z": 0.0}])
def test_a_size_that_roll_outs_do_not_show_keeps_its_interval(std):
    """Its standard deviation there is no zero: nothing is known of it."""
    fitted = {"z": Interval(1.88e-3, "rad/s", 1.51e-3, 2.25e-3)}
    found = replace(cause("gyro_bias"), parameters=fitted)
    bias = Effect("gyro_bias", (fitted_parameter("gyro_bias.z").perturbation,), (), ("z",))
    best = RolloutFit(filter_parameters_of(load_model("nominal")), (bias,), std, (), {"gyro_bias": (1.0,)})
    assert judge._with_rollout_size(found, bias, best).parameters == fitted
    known = judge._with_rollout_size(found, bias, replace(best, std={"gyro_bias.z": 1e-3})).parameters["z"]
    assert known.high - known.low == pytest.approx(2 * 1.96e-3, rel=0.01)
