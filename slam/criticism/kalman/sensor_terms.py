"""Compiled reading equations of the catalogue's terms, joined to one kernel for each instrument.

The parameters of all terms that change what an instrument reads form one vector.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from backend.compilation import inner_kernel
from slam.simulation.terms import CATALOGUE

STREAMS = ("imu", "attitude", "velocity", "sonar")
"""Streams of the filter's kinds of events, in their order."""
SENSOR = (
    *(f"{t.name}.{p.name}" for t in CATALOGUE.values() if t.stream in STREAMS for p in t.smooth),
    "sonar.datum_m", "attitude.delay_s", "velocity.delay_s",
)  # fmt: skip
"""Entries of the instruments' parameter vector; the last three belong to no term."""


def _kind(entry: str) -> int:
    owner = entry.partition(".")[0]
    return STREAMS.index(CATALOGUE[owner].stream if owner in CATALOGUE else owner)


READ_BY = tuple(_kind(entry) for entry in SENSOR)
"""Kind of the events that read each entry."""


def reading_terms(stream: str) -> Callable[..., None]:
    """Return the kernel ``(out, state, rate, elapsed, sensor)`` that applies the terms of a stream in turn.

    numba neither inlines nor caches a loop over functions. Therefore the calls are written out.
    """
    # Without a module's name, a cached kernel cannot be loaded by a process that compiles its caller.
    space: dict[str, Any] = {"__name__": __name__}
    calls = []
    for term in CATALOGUE.values():
        if term.stream == stream and term.read is not None:
            space[term.name] = inner_kernel(term.read)
            first = SENSOR.index(f"{term.name}.{term.parameters[0].name}")
            calls.append(f"    {term.name}(out, state, rate, elapsed, sensor, {first})")
    name = f"terms_of_{stream}"
    source = f"def {name}(out, state, rate, elapsed, sensor):\n" + "\n".join(calls or ["    pass"])
    exec(compile(source, __file__, "exec"), space)
    joined: Callable[..., None] = inner_kernel(space[name])
    return joined
