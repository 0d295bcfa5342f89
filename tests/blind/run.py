"""``python -m tests.blind.run``: hide effects in flights, have them criticised, print the score card.

Writes out/blind.json: the truth and the verdict of every case.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from pathlib import Path
from typing import Any

from tests.blind.cases import KINDS, Case, Hidden, make, suite
from tests.blind.critic import flights_of, verdict_of_call, verdict_on
from tests.blind.score import Answer, card

ROOT = Path(__file__).parents[2]
OUT = ROOT / "out" / "blind.json"


def judged(kind: str, fault: str | None, index: int, options: argparse.Namespace) -> Answer:
    """One case: made, criticised, thrown away."""
    with tempfile.TemporaryDirectory(prefix="flights-") as home:
        case = make(
            kind, options.seed, index, Path(home), options.flights, options.seconds, fault, options.strength,
            options.coloured,
        )  # fmt: skip
        begin = time.monotonic()
        judge = verdict_of_call if options.library else verdict_on
        verdict = judge(flights_of(Path(home) / case.name), Path(home) / "answer")
        if options.keep:
            shutil.move(Path(home, case.name), Path(options.keep, case.name))
        return Answer(case, verdict, time.monotonic() - begin)


def told(a: Answer) -> str:
    """One line for the console."""
    true = " + ".join(
        f"{h.name} {h.amplitude:.3g} {h.unit}" + (f" d {h.d:.1f}" if h.d else "") for h in a.case.hidden
    )
    causes = ", ".join(f"{c['name']} {c.get('probability') or 0:.2f}" for c in a.causes[:3])
    return (
        f"{a.case.name} {a.case.kind:11s} {true or '-':45s} -> {a.word}: {causes or '-'} ({a.seconds:.0f} s)"
    )


def answer_of(data: dict[str, Any]) -> Answer:
    """From what blind.json holds."""
    known = {f.name for f in fields(Case)}
    case = {k: tuple(v) if isinstance(v, list) else v for k, v in data["case"].items() if k in known}
    case["hidden"] = tuple(Hidden(**{**h, "channels": tuple(h["channels"])}) for h in case["hidden"])
    return Answer(Case(**case), data["verdict"], data["seconds"])


def main() -> None:
    """Run, print, write."""
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
    parser.add_argument("--jobs", type=int, default=2)
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
    drawn = list(enumerate(suite(options.first + options.cases, options.kinds)))[options.first :]
    answers: list[Answer] = []
    options.out.parent.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(options.jobs) as pool:
        for answer in pool.map(lambda it: judged(it[1][0], options.fault or it[1][1], it[0], options), drawn):
            answers.append(answer)
            print(told(answer), flush=True)
            data = [{"case": a.case.to_json(), "verdict": a.verdict, "seconds": a.seconds} for a in answers]
            text = json.dumps({"seed": options.seed, "answers": data}, indent=1)
            beside = options.out.with_suffix(".part")
            beside.write_text(text + "\n", encoding="utf-8")
            beside.replace(options.out)
    print(f"\n{'':52s}   count      rate    95 % interval   floor (best)")
    print("\n".join(row.line() for row in card(answers)))


if __name__ == "__main__":
    main()
