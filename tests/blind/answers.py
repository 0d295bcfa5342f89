"""Results of runs of the blind tests: truth and verdict of every case, and the suite."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from tests.blind.cases import Case, Hidden
from tests.blind.score import Answer


def write(path: Path, asked: dict[str, Any], answers: Sequence[Answer]) -> None:
    """Write the whole file; an existing one stays until the new one is complete."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_suffix(".part")
    text = json.dumps({**asked, "answers": [asdict(a) for a in answers]}, indent=1)
    beside.write_text(text + "\n", encoding="utf-8")
    beside.replace(path)


def read(path: Path) -> tuple[dict[str, Any], list[Answer]]:
    """Return the options of the run, by name, and the answers."""
    held = json.loads(path.read_text(encoding="utf-8"))
    return held, [_answer_of(data) for data in held.pop("answers")]


def earlier(path: Path, asked: dict[str, Any]) -> list[Answer]:
    """Return the answers of an earlier run, from which a new one continues; none without a file.

    Raises ``ValueError`` if the file belongs to another suite.
    """
    if not path.exists():
        return []
    held, answers = read(path)
    if other := [name for name, value in asked.items() if held.get(name) != value]:
        raise ValueError(f"{path} is of another suite ({', '.join(other)}): remove it, or name another --out")
    return answers


def _answer_of(data: dict[str, Any]) -> Answer:
    known = {f.name for f in fields(Case)}
    case = {k: tuple(v) if isinstance(v, list) else v for k, v in data["case"].items() if k in known}
    case["hidden"] = tuple(Hidden(**{**h, "channels": tuple(h["channels"])}) for h in case["hidden"])
    return Answer(Case(**case), data["verdict"], data["seconds"], data["commit"])
