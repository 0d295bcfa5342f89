"""Cases: flights of one vehicle with a hidden effect, or none, and their truth.

Every number follows from (seed, case, flight, purpose). Names and order of folders carry no information.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from tests.blind import folder, vehicle
from tests.blind.camera import floor, pictures
from tests.blind.faults import (
    BY_NAME,
    FAULTS,
    SEEN,
    SEEN_STRANGE,
    SENSES,
    STRANGE,
    STRANGER,
    UNTELLABLE,
    Blind,
    Fault,
)
from tests.blind.instruments import RATE_HZ, streams
from tests.blind.plans import GRID_S, LANDING, PLANS, start_of, stick_of
from tests.blind.strength import NUISANCES, outputs, strengths, whitened
from tests.blind.vehicle import HEALTHY, Knobs

CONTACT = ("sonar_bias",)
"""Effects that only the contact with the floor shows, which the whitening leaves out."""
FINE_S, COARSE_S = GRID_S / 2, GRID_S
CHANCE = ("gusts", "timestamp_jitter", "sonar_spikes", "sonar_quantisation", "flow_sticks")
"""Effects on the variance only: noise-free differences do not show their strength."""
POOLS: dict[str, tuple[Fault, ...]] = {
    "single": FAULTS, "strange": STRANGE, "seen_single": SEEN, "seen_strange": SEEN_STRANGE,
    "stranger": STRANGER,
}  # fmt: skip
"""Kinds of case that hide one effect, and their pools."""
PICTURED = ("seen_null", "seen_single", "seen_strange")
"""Kinds whose flights have pictures."""
KINDS = (
    "null", "null_heavy", "null_coloured", "null_edge", "single", "pair", "strange", "untellable", *PICTURED,
    "null_uneven", "stranger",
)  # fmt: skip
"""New kinds are added at the end, so that suites of the others keep their draws."""
SHARE = dict(zip(KINDS, (8, 4, 3, 4, 15, 4, 5, 2, 1, 3, 1, 3, 2), strict=True))
"""Shares of the kinds in a full suite: over 200 of 500 cases are healthy."""
COLOUR = (0.3, 0.6)
"""AR(1) coefficients of correlated noise."""


@dataclass(frozen=True)
class Hidden:
    """One hidden effect."""

    name: str
    amplitude: float
    value: float | None
    """Size in the catalogue's unit; None where the parametrisations are not comparable."""
    unit: str
    d: float | None
    known: bool
    channels: tuple[str, ...] = ()
    way: dict[str, float] = field(default_factory=dict)
    """Parameter -> its signed size or entry, up to a common factor; empty where an effect has no sign."""


@dataclass(frozen=True)
class Case:
    """Truth of a case, for the score card."""

    name: str
    kind: str
    plans: tuple[str, ...]
    duration_s: float
    hidden: tuple[Hidden, ...] = ()
    equivalents: tuple[str, ...] = ()
    """Names that count as right answers."""
    invisible: bool = False
    settled_by: str = ""
    knobs: dict[str, float] = field(default_factory=dict)
    """Drawn nuisances."""


def nuisances_of(
    rng: np.random.Generator,
    edge: bool = False,
    heavy: bool = False,
    coloured: bool = False,
    uneven: bool = False,
) -> dict[str, float]:
    """Draw a healthy vehicle; at the edges of all priors if ``edge``."""

    def around(width: float) -> float:
        return float(1.0 + width * (rng.choice([-1.0, 1.0]) if edge else rng.uniform(-1.0, 1.0)))

    def between(low: float, high: float) -> float:
        return (
            float(rng.choice([low, high])) if edge else float(np.exp(rng.uniform(np.log(low), np.log(high))))
        )

    k = {name: HEALTHY[name] for name in HEALTHY}
    for name, width in (("gain", 0.05), ("drag", 0.1), ("lag", 0.1), ("tilt_std", 0.2), ("spin_std", 0.2)):
        k[name] *= around(width)
    for name in ("shake_std", "heave_std", "n_gyro", "n_accel", "n_attitude", "n_flow", "n_echo"):
        k[name] *= around(0.2)
    k["tilt_tau"], k["spin_tau"] = between(0.15, 0.4), between(0.2, 0.5)
    k["shake_tau"], k["datum"] = between(0.05, 0.25), 0.01 * (around(1.0) - 1.0)
    k["charge"], k["tails"] = float(rng.uniform(0.55, 0.95)), float(heavy)
    if coloured:
        k["colour"] = float(rng.uniform(*COLOUR))
    if uneven:
        # What noise may be more or less than nominal is all taken by its changes within the flight.
        k.update(dict.fromkeys(("n_gyro", "n_accel", "n_attitude", "n_flow", "n_echo"), 1.0))
        k["uneven"] = 0.2
    return k


@dataclass(frozen=True)
class Outing:
    """Flights of a case before an effect is hidden."""

    seed: int
    index: int
    plans: tuple[str, ...]
    duration_s: float
    one_heading: bool = False

    def rng(self, flight: int, purpose: int) -> np.random.Generator:
        """Return an independent random stream."""
        return np.random.Generator(
            np.random.Philox(np.random.SeedSequence((self.seed, self.index, flight, purpose)))
        )

    def stick(self, flight: int) -> np.ndarray:
        """As given, on the plans' grid."""
        return stick_of(self.plans[flight], self.duration_s, self.rng(flight, 0))

    def start(self, flight: int) -> np.ndarray:
        """x y z yaw."""
        start = start_of(self.plans[flight], self.rng(flight, 1))
        return np.array([*start[:3], 0.7]) if self.one_heading else start

    def fly(self, members: Sequence[tuple[int, Knobs]], h: float, restless: bool) -> vehicle.Path:
        """(flight, knobs) side by side."""
        sticks, noises = [], []
        for flight, knobs in members:
            given = np.repeat(self.stick(flight), round(GRID_S / h), axis=0)
            sticks.append(vehicle.obeyed(given, knobs, h, self.rng(flight, 2)))
            noises.append(vehicle.unrest(knobs, len(given), h, self.rng(flight, 3)) if restless else None)
        noise = np.stack(noises, axis=-1) if restless else None
        starts = np.stack([self.start(flight) for flight, _ in members], axis=-1)
        return vehicle.fly([k for _, k in members], np.stack(sticks, axis=-1), starts, noise, h)

    def traces(self, base: Knobs, others: Sequence[Knobs], kept: Sequence[str]) -> np.ndarray:
        """(values, others) whitened differences that changed knobs make over all flights."""
        flights = range(len(self.plans))
        members = [(f, k) for f in flights for k in (base, *others)]
        path = self.fly(members, COARSE_S, restless=False)
        each = 1 + len(others)
        # The first of each flight's members is the healthy one.
        seen = [outputs(path, m, kept, beside=m - m % each) for m in range(len(members))]
        change = {
            axis: np.stack(
                [seen[f * each + m][axis] - seen[f * each][axis] for f in flights for m in range(1, each)],
                axis=-1,
            )
            for axis in seen[0]
        }
        found = whitened(change, base)
        # (samples, channels, flights x others) to (values, others).
        return np.reshape(
            np.moveaxis(found.reshape(*found.shape[:2], len(flights), len(others)), -1, 0), (len(others), -1)
        ).T


def sized(
    outing: Outing, base: dict[str, float], fault: Fault, target: float | None, kept: Sequence[str]
) -> tuple[dict[str, float], Hidden, np.ndarray]:
    """Knobs, what was hidden, and its trace; of strength ``target`` as near as its amplitudes allow."""

    def knobs(a: float) -> dict[str, float]:
        return {**base, **fault.apply(a, base, outing.rng(99, 4))}

    steps = [{**base, n: base[n] + step} for n, (step, _) in NUISANCES.items()]
    halves = [half / abs(step) for step, half in NUISANCES.values()]
    amplitude = float(np.sqrt(fault.low * fault.high))
    if not fault.scaled:
        amplitude = float(outing.rng(99, 5).uniform(fault.low, fault.high))
    first = outing.traces(base, [*steps, knobs(amplitude)], kept)
    trace, nuisances = first[:, -1:], first[:, :-1]
    d = float(strengths(trace, nuisances, halves)[0])
    for _ in range(3):
        if target is None or not fault.scaled or abs(d / target - 1.0) < 0.05:
            break
        amplitude = float(np.clip(amplitude * target / max(d, 1e-6), fault.low, fault.high))
        trace = outing.traces(base, [knobs(amplitude)], kept)
        d = float(strengths(trace, nuisances, halves)[0])
    value = None if fault.value is None else float(fault.value(amplitude, base))
    shown = None if fault.name in (*CHANCE, *CONTACT) or fault in (*SEEN, *SEEN_STRANGE) else d
    changed = knobs(amplitude)
    way = {name: changed[knob] for name, knob in SENSES.get(fault.name, {}).items()}
    hidden = Hidden(fault.name, amplitude, value, fault.unit, shown, fault.known, fault.channels, way)
    return changed, hidden, trace


def _is_of_the_floor(fault: Fault) -> bool:
    """Return whether a fault changes the floor. Its flights do not land, as legs know only a level floor."""
    return fault.family == "place"


def go_together(one: Fault, other: Fault) -> bool:
    """Return whether flights can show both effects: one that only landings show needs a floor to land on."""
    both = ((one, other), (other, one))
    landed = any(a.needs == (LANDING,) and _is_of_the_floor(b) for a, b in both)
    return one.family != other.family and not landed


def plans_for(faults: Sequence[Fault], flights: int, rng: np.random.Generator) -> tuple[str, ...]:
    """Choose one plan that shows each fault, the others at random."""
    chosen: list[str] = []
    barred = {LANDING} if any(map(_is_of_the_floor, faults)) else set()
    for fault in faults:
        if fault.needs and not set(fault.needs) & set(chosen):
            plan = str(rng.choice(fault.needs))
            while plan in barred:
                plan = str(rng.choice(fault.needs))
            chosen.append(plan)
    rest = [p for p in PLANS if p not in chosen and p not in barred]
    chosen += [str(p) for p in rng.permutation(rest)]
    return tuple(str(p) for p in rng.permutation(chosen[:flights]))


def make(
    kind: str,
    seed: int,
    index: int,
    home: Path,
    flights: int = 4,
    duration_s: float = 40.0,
    fault: str | None = None,
    d: float | None = None,
    coloured: bool = False,
) -> Case:
    """Draw a case, write its flights below ``home`` and tell what is true.

    ``fault`` and ``d`` may be set, and noise may be ``coloured`` in any kind of case.
    """
    assert kind in KINDS, kind
    rng = np.random.Generator(np.random.Philox(np.random.SeedSequence((seed, index))))
    coloured = coloured or kind == "null_coloured"
    base = nuisances_of(rng, kind == "null_edge", kind == "null_heavy", coloured, kind == "null_uneven")
    target = d or float(np.exp(rng.uniform(np.log(5.0), np.log(20.0))))
    kept: tuple[str, ...] = tuple(RATE_HZ)
    case = Case(name_of(index), kind, (), duration_s, knobs=base)
    faults: list[Fault] = []
    blind: Blind | None = None
    if kind in POOLS:
        pool = POOLS[kind]
        faults = [BY_NAME[fault] if fault else pool[rng.integers(len(pool))]]
        if kind in ("strange", "stranger") and d is None:
            # What no term of the catalogue imitates must stand out, not only the whole of it.
            target *= 3.0
    elif kind == "pair":
        target = max(target, 10.0)
        scaled = [f for f in FAULTS if f.scaled]
        faults = [scaled[i] for i in rng.permutation(len(scaled))]
        faults = [faults[0], next(f for f in faults if go_together(faults[0], f))]
    elif kind == "untellable":
        found = [b for b in UNTELLABLE if fault in (None, b.fault)]
        blind = found[rng.integers(len(found))]
        # Far beyond the required size any two causes can be separated.
        faults = [replace(BY_NAME[blind.fault], scaled=True)]
        target, kept = blind.strength, blind.streams
    plans = plans_for(faults, flights, rng)
    if blind is not None:
        plans = tuple(str(rng.choice(blind.plans)) for _ in range(flights))
        case = replace(case, invisible=blind.strength is None, settled_by=blind.settled_by)
    outing = Outing(seed, index, plans, duration_s, one_heading=blind is not None)
    knobs, hidden = dict(base), []
    for f in faults:
        with_it, what, _ = sized(outing, base, f, target, kept)
        knobs.update({n: v for n, v in with_it.items() if v != base[n]})
        hidden.append(what)
    names = tuple(h.name for h in hidden)
    case = replace(case, plans=plans, hidden=tuple(hidden), equivalents=blind.equivalents if blind else names)
    write(outing, knobs, kept, home / case.name, kind in PICTURED)
    return case


def write(outing: Outing, knobs: Knobs, kept: Sequence[str], home: Path, pictured: bool) -> None:
    """Measure the flights, with pictures if ``pictured``, all over one floor."""
    flights = range(len(outing.plans))
    path = outing.fly([(f, knobs) for f in flights], FINE_S, restless=True)
    ground = floor(outing.rng(99, 8)) if pictured else None
    for f in flights:
        rng = outing.rng(f, 6)
        stick = outing.stick(f)
        seen = {n: s for n, s in streams(path, f, stick, rng).items() if n in kept}
        seen["command0"] = folder.logged(stick, GRID_S)
        name = f"flight_{f:02d}"
        shots = pictures(path, f, ground, outing.rng(f, 7)) if ground is not None else []
        folder.write(home / name, name, float(rng.integers(100, 900)), seen, shots)


def name_of(index: int) -> str:
    """Return the name of a case and of its folder."""
    return f"case_{index:03d}"


def suite(count: int, kinds: Sequence[str]) -> list[tuple[str, str | None]]:
    """Return kind and fault of each case: kinds by their shares, faults in turn."""
    turn = [k for k in KINDS if k in kinds for _ in range(SHARE[k])]
    order = np.random.Generator(np.random.Philox(11)).permutation(len(turn))
    pools = {k: [f.name for f in pool] for k, pool in POOLS.items()}
    pools["untellable"] = [b.fault for b in UNTELLABLE]
    # In an order of its own: neighbours in the lists are of one family.
    pools = {
        k: [str(n) for n in np.random.Generator(np.random.Philox(12)).permutation(p)]
        for k, p in pools.items()
    }
    met = dict.fromkeys(KINDS, 0)
    out: list[tuple[str, str | None]] = []
    for i in range(count):
        kind = turn[order[i % len(order)]]
        pool = pools.get(kind)
        out.append((kind, pool[met[kind] % len(pool)] if pool else None))
        met[kind] += 1
    return out
