"""Mutates whole inputs and reads them: each is read or refused in one line, in bounded time.

``python -m tests.fuzz.fuzz --seed 7 --count 2000 g2o csv`` runs some formats; without names it runs all.
"""

from __future__ import annotations

import argparse
import signal
import tempfile
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from backend.errors import BackendError
from slam.core.errors import InputError
from tests.fuzz.formats import FORMATS, Format
from tests.fuzz.mutations import mutated

LIMIT_S = 20.0
"""Longest time of one case. The slowest whole input takes less than a second on an idle machine."""


@dataclass
class Outcome:
    """What became of the mutations of one format."""

    read: int = 0
    refused: int = 0
    faults: dict[str, str] = field(default_factory=dict)
    """A case of each kind of fault: where it was raised, and the number of the case with the traceback."""

    def __str__(self) -> str:
        return f"{self.read} read, {self.refused} refused, {len(self.faults)} kinds of fault"


def fuzz(form: Format, seed: int, count: int, folder: Path) -> Outcome:
    """Read ``count`` mutations of one format. A case depends on the seed and its own number alone."""
    files = form.make(folder)
    outcome = Outcome()
    for case in range(count):
        rng = np.random.default_rng([seed, case])
        path = files[int(rng.integers(len(files)))]
        whole = path.read_bytes()
        path.write_bytes(mutated(whole, rng))
        try:
            with warnings.catch_warnings(), time_limit(LIMIT_S):
                warnings.simplefilter("error")
                form.read(folder, path)
            outcome.read += 1
        except (InputError, BackendError) as refusal:
            outcome.refused += 1
            if "\n" in str(refusal):
                outcome.faults.setdefault("several lines", f"case {case} of {path.name}: {refusal}")
        except Exception as error:  # noqa: BLE001  any other one is a fault
            where = traceback.extract_tb(error.__traceback__)[-1]
            kind = f"{type(error).__name__} at {where.filename}:{where.lineno}"
            outcome.faults.setdefault(kind, f"case {case} of {path.name}: {traceback.format_exc()}")
        finally:
            path.write_bytes(whole)
    return outcome


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise ``TimeoutError`` in the block after some seconds."""

    def late(*_: object) -> None:
        raise TimeoutError(f"more than {seconds:g} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def main() -> None:
    """Run the formats that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("formats", nargs="*", metavar="FORMAT", help=", ".join(FORMATS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=2000)
    options = parser.parse_args()
    for name in options.formats or FORMATS:
        with tempfile.TemporaryDirectory() as folder:
            outcome = fuzz(FORMATS[name], options.seed, options.count, Path(folder))
        print(f"{name}: {outcome}", flush=True)
        for kind, case in outcome.faults.items():
            print(f"--- {kind}\n{case}", flush=True)


if __name__ == "__main__":
    main()
