"""``python -m tests.blind.run``: hide effects in flights, have them criticised, print the score card.

Writes out/blind.json: the truth and the verdict of every case. A run that was stopped goes on from there.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

from frontend.workers import Workers
from slam.parallel.cluster import cluster
from tests.benchmarks.commit import commit
from tests.blind.answers import earlier, write
from tests.blind.cases import KINDS, make, name_of, suite
from tests.blind.critic import flights_of, verdict_of_call, verdict_on
from tests.blind.folder import without_commands
from tests.blind.score import Answer, card
from tests.blind.settling import settles

ROOT = Path(__file__).parents[2]
OUT = ROOT / "out" / "blind.json"
SUITE = (
    "seed", "kinds", "fault", "strength", "coloured", "flights", "seconds", "library", "without_commands",
)  # fmt: skip
"""Options that define the suite; the others only select a part of it."""


def judged(options: argparse.Namespace, drawn: tuple[int, tuple[str, str | None]]) -> Answer:
    """Make a case of this number, kind and fault, criticise it, delete it."""
    index, (kind, fault) = drawn
    with tempfile.TemporaryDirectory(prefix="flights-") as home:
        case = make(
            kind, options.seed, index, Path(home), options.flights, options.seconds, options.fault or fault,
            options.strength, options.coloured,
        )  # fmt: skip
        begin = time.monotonic()
        judge = verdict_of_call if options.library else verdict_on
        flights = flights_of(Path(home) / case.name)
        if options.without_commands:
            for flight in flights:
                without_commands(flight)
        verdict = judge(flights, Path(home) / "answer")
        if options.keep:
            shutil.move(Path(home, case.name), Path(options.keep, case.name))
        return Answer(case, verdict, time.monotonic() - begin)


def described(a: Answer) -> str:
    """Return one line for the console."""
    true = " + ".join(
        f"{h.name} {h.amplitude:.3g} {h.unit}" + (f" d {h.d:.1f}" if h.d else "") for h in a.case.hidden
    )
    causes = ", ".join(f"{c['name']} {c.get('probability') or 0:.2f}" for c in a.causes[:3])
    return (
        f"{a.case.name} {a.case.kind:11s} {true or '-':45s} -> {a.word}: {causes or '-'} ({a.seconds:.0f} s)"
    )


def main() -> None:
    """Run the cases, print the card, write the answers."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=500, help="how many")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--fault", help="hide this one in every case that hides one")
    parser.add_argument(
        "--strength", type=float, help="sigmas that it shall stand out by, instead of 5 to 20"
    )
    parser.add_argument(
        "--coloured", action="store_true", help="let successive samples of every case's noise correlate"
    )
    # None where it is not asked for, as in files of runs from before there was the option.
    parser.add_argument(
        "--without-commands",
        action="store_const",
        const=True,
        help="take the command logs out of the folders",
    )
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument(
        "--scheduler",
        help="share the cases among the workers of this scheduler of Dask, begun in this folder",
    )
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--flights", type=int, default=4, help="a case")
    parser.add_argument("--seconds", type=float, default=40.0, help="a flight")
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--library", action="store_true", help="call slam.criticise instead of the command")
    parser.add_argument("--keep", help="folder for the cases' flights, made if need be")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    if options.keep:
        Path(options.keep).mkdir(parents=True, exist_ok=True)
    asked = {name: getattr(options, name) for name in SUITE}
    try:
        answers = earlier(options.out, asked)
    except ValueError as error:
        parser.error(str(error))
    state, done = commit(), {answer.case.name for answer in answers}
    drawn = list(enumerate(suite(options.first + options.cases, options.kinds)))[options.first :]
    drawn = [(k, case) for k, case in drawn if name_of(k) not in done]
    with cluster(options.scheduler) if options.scheduler else nullcontext(Workers(options.jobs)) as workers:
        for answer in workers.map(judged, options, drawn, ahead=len(drawn)):
            answers.append(replace(answer, commit=state))
            print(described(answer), flush=True)
            write(options.out, asked, answers)
    print("\n" + "\n".join(row.line() for row in card(answers, settles)))


if __name__ == "__main__":
    main()
