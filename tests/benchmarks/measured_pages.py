"""Write docs/measured: the verdicts of ``slam criticise`` on measured flights, one page with pictures each.

``SLAM_DATA=data python -m tests.benchmarks.measured_pages [NAME]...``
Every number on the pages comes from the verdict, from a replay, or from the truth; none is typed.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from slam.core.flight import Flight
from slam.core.units import spaced
from slam.criticism import Criticism, criticise
from slam.criticism.cause import Gain, Interval
from slam.data_quality.commands import has_commands
from slam.io.flight_folder import read_flight
from slam.report.criticism.gains import gain_rows
from slam.report.criticism.pictures import (
    covariate_caption,
    covariate_picture,
    gain_picture,
    ranking_caption,
    ranking_picture,
)
from slam.report.criticism.plain_names import figure
from slam.report.criticism.segment import Segment, before_after_picture, evidence_segment
from slam.simulation.model import save_model
from slam.simulation.terms import CATALOGUE
from tests.benchmarks.commit import commit
from tests.benchmarks.measured import folder
from tests.benchmarks.measured_studies import STUDIES, Study
from tests.benchmarks.measured_truth import APART_S, against_gps, with_truth_for_instruments
from tests.benchmarks.measured_unseen import unseen_rows

HOME = Path(__file__).parents[2] / "docs" / "measured"
MOST_SHOWN = 8


def page(name: str, study: Study) -> None:
    """Criticise the flights of a study; write its page, its pictures and the extended model."""
    flights = [_flight(path) for path in study.flights]
    found = criticise(flights)
    home = HOME / name
    home.parent.mkdir(exist_ok=True)
    parts = [
        f"# {study.title}",
        study.about,
        f"```\nslam criticise {study.shown} --out out/{name}\n```",
        f"**{found.verdict}**: {found.sentence}",
        *_section("Causes", [_causes(found), _model(home, found, flights)]),
        *_segment(home, evidence_segment(found, flights)),
        *_section("Why this cause", _why(home, found)),
        *_section("Ranking of the hypotheses", _ranking(home, found)),
        *_section("Gain on held-out data", _gain(home, found)),
        *_section("Prediction of other flights", _unseen(home, study, found)),
        *_section("Independent truth", _truth(study, flights[0], found)),
        *_section("Unexplained findings", [f"- {part}" for part in found.findings], found.remainder),
        *_section("Limits of these flights", _silent(found)),
        *_section("The next flight", [found.next_flight], found.next_flight),
        *_section("What was not judged", [f"- {line}" for line in found.dropped], found.dropped),
        f"Written at {commit()} by `python -m tests.benchmarks.measured_pages`; see "
        "[criticism](../criticism.md).",
    ]
    text = "\n\n".join(part for part in parts if part).replace("\n\n- ", "\n- ")
    home.with_suffix(".md").write_text(text + "\n", encoding="utf-8")


def _flight(path: str) -> Flight:
    return read_flight(folder("flights") / path)


def _section(title: str, content: Sequence[str], there: object = True) -> list[str]:
    content = [c for c in content if c]
    return [f"## {title}", *content] if content and there else []


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)]) if rows else ""


def _causes(found: Criticism) -> str:
    rows = [
        (
            *((f"`{c.name}`", CATALOGUE[c.name].equation) if k == 0 else ("", "")),
            name,
            f"{figure(p.value)}{spaced(p.unit)}",
            f"{figure(p.low)} to {figure(p.high)}",
            f"{c.probability:.3f}" if k == 0 else "",
        )
        for c in found.causes
        for k, (name, p) in enumerate(c.parameters.items())
    ]
    return _table(("cause", "equation", "parameter", "value", "95 % interval", "probability"), rows)


def _model(home: Path, found: Criticism, flights: Sequence[Flight]) -> str:
    if found.extended is None or not found.causes:
        return ""
    save_model(found.extended, home.with_suffix(".toml"))
    replayed = " and `slam replay --model`" if any(map(has_commands, flights)) else ""
    return (
        f"The model with these causes: [{home.name}.toml]({home.name}.toml), for `slam simulate --model`"
        f"{replayed}."
    )


def _image(home: Path, kind: str, alt: str, picture: bytes) -> str:
    path = home.with_name(f"{home.name}-{kind}.png")
    path.write_bytes(picture)
    return f"![{alt}]({path.name})"


def _drawn(home: Path, kind: str, segment: Segment | None) -> list[str]:
    if segment is None:
        return []
    return [
        _image(home, kind, "Measured, nominal model and extended model", segment.picture),
        segment.caption,
    ]


def _segment(home: Path, segment: Segment | None) -> list[str]:
    return _section(segment.title, _drawn(home, "stretch", segment)) if segment is not None else []


def _why(home: Path, found: Criticism) -> list[str]:
    if found.covariate is None:
        return []
    picture = covariate_picture(found.covariate)
    return [
        _image(home, "covariate", "Prediction error against the error that each cause predicts", picture),
        covariate_caption(found),
    ]


def _ranking(home: Path, found: Criticism) -> list[str]:
    return [
        _image(home, "ranking", "Probability and strength of each hypothesis", ranking_picture(found)),
        ranking_caption(found),
    ]


def _gain(home: Path, found: Criticism) -> list[str]:
    if not found.causes:
        return []
    gain = found.causes[0].gain
    rows = [(r.channel, r.horizon, r.before, r.after, r.change) for r in gain_rows(found)]
    return [
        f"{_held_out(gain)}: {gain.nats:+.0f} nats ({gain.ci95[0]:.0f} to {gain.ci95[1]:.0f}).",
        _table(("channel", "ahead", "nominal model", "extended", "change"), rows),
        _image(home, "gain", "Gain of each held-out part", gain_picture(gain)),
    ]


def _held_out(gain: Gain) -> str:
    if gain.by is None:
        return "Each anomalous reading counts by itself"
    return f"Each {gain.by} in turn is held out and predicted by the others"


def _unseen(home: Path, study: Study, found: Criticism) -> list[str]:
    if not study.rounds:
        return []
    rounds, models = study.rounds, []
    for one in rounds:
        again = found if one.judged == study.flights else criticise([_flight(path) for path in one.judged])
        models.append((again.model, again.extended))
    unseen = [_flight(path) for group in rounds[0].groups.values() for path in group]
    segment = before_after_picture(*models[0], unseen, study.drawn)
    truth = any(flight.truth is not None for flight in unseen)
    captured = " Channels that begin with `truth` are the motion capture's." if truth else ""
    times = "one round" if len(rounds) == 1 else f"{len(rounds)} rounds"
    return [
        f"Predicted over 2 s by `slam replay`, with a model fitted on other flights ({times}). Channels "
        f"that became worse are listed too.{captured}",
        _table(
            ("flights", "channel", "nominal model", "extended", "change"),
            unseen_rows(rounds, models, _flight),
        ),
        *_drawn(home, "unseen", segment),
    ]


def _silent(found: Criticism) -> list[str]:
    usual = found.within_reach
    sizes = [
        f"{name} of {size:.2g} {'' if unit == '1' else unit}".strip()
        for name, (size, unit) in found.detectable.items()
        if name in usual
    ]
    pairs = [f"- {a} and {b} (cosine {c:+.2f})" for a, b, c in found.confusable[:MOST_SHOWN]]
    missed = "Smallest sizes that nine of ten such flights would have shown"
    return [
        f"{missed}: {', '.join(sizes)}. They would not have shown other effects at a usual size."
        if sizes
        else "",
        "Pairs of terms with similar sensitivities in these flights:" if pairs else "",
        *pairs,
    ]


def _truth(study: Study, flight: Flight, found: Criticism) -> list[str]:
    if study.truth == "motion capture":
        return _of_motion_capture(flight, found)
    return _of_gps(flight) if study.truth == "gps" else []


def _of_motion_capture(flight: Flight, found: Criticism) -> list[str]:
    """Return the lines that compare the causes with those from the motion capture in place of the
    instruments."""
    again = criticise([with_truth_for_instruments(flight)])
    by_capture = {cause.name: cause.parameters for cause in again.causes}
    rows = []
    for cause in found.causes:
        for name, own in cause.parameters.items():
            other = by_capture.get(cause.name, {}).get(name)
            there = ("not named", "")
            if other is not None:
                overlap = max(own.low, other.low) <= min(own.high, other.high)
                there = (_sized(other), "yes" if overlap else "no")
            rows.append((f"`{cause.name}`", name, _sized(own), *there))
    beyond = [name for name in by_capture if name not in {cause.name for cause in found.causes}]
    return [
        "The same with the motion capture's attitude, speed and height in place of the drone's own, so "
        "that only its inertial unit is judged:",
        _table(("cause", "parameter", "own instruments", "motion capture", "intervals overlap"), rows),
        f"With the motion capture there is also {' and '.join(beyond)}, which may be an error of its "
        "markers, as they are not at the inertial unit."
        if beyond
        else "",
    ]


def _sized(p: Interval) -> str:
    return f"{p.value:.3g} ({p.low:.3g} to {p.high:.3g}) {'' if p.unit == '1' else p.unit}".strip()


def _of_gps(flight: Flight) -> list[str]:
    """Return the lines on the speed over ground by GPS."""
    found = against_gps(flight)
    return [
        "GPS can check only the flow sensor's speed: its ratio to the speed between GPS positions is "
        f"{found.scale:.3f} (± {1.96 * found.std:.3f}, {found.count} segments of "
        f"{APART_S:g} s, GPS {found.late_s:.2f} s late, {found.rms_m_s:.2f} m/s rms left). It cannot check "
        "the zeros of a gyro. The log has no altitude of the receiver, so it cannot check the vertical "
        "accelerometer either."
    ]


def main(names: Sequence[str]) -> None:
    """Write the pages of these names, or all."""
    for name in names or STUDIES:
        page(name, STUDIES[name])


if __name__ == "__main__":
    main(sys.argv[1:])
