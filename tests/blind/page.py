"""Fill docs/blind.md from the answers of runs of the blind tests.

``python -m tests.blind.page out/blind.json...``
The files may hold parts of one suite or of several suites; they give one card.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from slam.io.atomic import atomic_file
from tests.benchmarks.figures import with_block
from tests.blind.answers import read
from tests.blind.rows import Row
from tests.blind.run import described
from tests.blind.score import FLAGS, Answer, card, misnamed, says_so, true
from tests.blind.settling import settles

PAGE = Path(__file__).parents[2] / "docs" / "blind.md"


WITHOUT = "## Without command logs"
"""Heading of the separate card of cases without command logs."""


def markdown(answers: Sequence[Answer], commands: Sequence[str] = (), level: str = "##") -> str:
    """Return a card: the commands, the figures, and the wrong verdicts under a heading of ``level``."""
    kinds, commits = Counter(a.case.kind for a in answers), Counter(a.commit for a in answers)
    wrong = [a for a in answers if not came_out(a)]
    return "\n".join(
        [
            f"{len(answers)} cases: {_counted(kinds)}. Judged at the commits {_counted(commits)}.",
            *(f"\n`{command}`" for command in commands),
            "",
            "| | cases | rate | 95 % interval | floor | | aim | |",
            "|---|---|---|---|---|---|---|---|",
            *(_line(row) for row in card(list(answers), settles) if row.of),
            "",
            f"{level} Cases with a wrong verdict: {len(wrong)}",
            "",
            "```",
            *(described(a) for a in wrong),
            "```",
        ]
    )


def came_out(answer: Answer) -> bool:
    """Return whether the verdict is right for a case of its kind."""
    kind = answer.case.kind.removeprefix("seen_")
    if kind == "single":
        return answer.right
    if kind == "pair":
        return true(answer) <= answer.claimed
    if kind in ("strange", "stranger"):
        return answer.word in FLAGS and not misnamed(answer)
    return says_so(answer) if kind == "untellable" else answer.word == "nothing_wrong"


def _command(asked: dict[str, Any]) -> str:
    suite = f"--seed {asked['seed']} --flights {asked['flights']} --kinds {' '.join(asked['kinds'])}"
    blind = " --without-commands" if asked.get("without_commands") else ""
    return f"python -m tests.blind.run {suite}{blind}"


def _counted(found: Counter[str]) -> str:
    return ", ".join(f"{name} ({count})" for name, count in sorted(found.items()))


def _line(row: Row) -> str:
    cells = (f"**{cell}**" if cell == "missed" else cell for cell in row.cells())
    return f"| {row.name} | {' | '.join(cells)} |"


def main() -> None:
    """Read the files and write the page."""
    if not sys.argv[1:]:
        sys.exit("python -m tests.blind.page FILE...: give the files that tests.blind.run wrote")
    runs = [read(Path(name)) for name in sys.argv[1:]]
    with atomic_file(PAGE) as path:
        path.write_text(with_block(PAGE.read_text(encoding="utf-8"), block(runs)), encoding="utf-8")


def block(runs: Sequence[tuple[dict[str, Any], list[Answer]]]) -> str:
    """Return the content between the page's markers for some runs and their arguments."""
    cards = []
    for blind in (False, True):
        own = [run for run in runs if bool(run[0].get("without_commands")) == blind]
        if own:
            answers = [answer for _, found in own for answer in found]
            commands = [_command(asked) for asked, _ in own]
            cards.append(markdown(answers, commands, "###" if blind else "##"))
    return f"\n\n{WITHOUT}\n\n".join(cards)


if __name__ == "__main__":
    main()
