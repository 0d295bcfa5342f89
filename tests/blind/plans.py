"""Flight plans: stick positions over time, random for each flight. All changes are on a 5 ms grid."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

GRID_S = 0.005
Piece = tuple[float, float, float, float, float]
"""Seconds, forward, left, up, yaw."""
Rng = np.random.Generator


def _in_direction(size: float, rng: Rng) -> tuple[float, float]:
    forward = rng.uniform() < 0.6
    signed = size * rng.choice([-1.0, 1.0])
    return (signed, 0.0) if forward else (0.0, signed)


def hover(rng: Rng) -> Iterator[Piece]:
    while True:
        yield (5.0, 0.0, 0.0, 0.0, 0.0)


def pulse_and_coast(rng: Rng) -> Iterator[Piece]:
    while True:
        f, left = _in_direction(rng.uniform(0.1, 0.34), rng)
        span = rng.uniform(0.6, 1.3)
        yield (span, f, left, 0.0, 0.0)
        yield (rng.uniform(2.0, 3.2), 0.0, 0.0, 0.0, 0.0)


def reversing_steps(rng: Rng) -> Iterator[Piece]:
    while True:
        f, left = _in_direction(1.0, rng)
        high = rng.uniform(0.22, 0.36)
        for size in (high, 0.4 * high, -0.6 * high, -0.25 * high, 0.3 * high):
            yield (rng.uniform(1.0, 1.7), size * f, size * left, 0.0, 0.0)
        yield (rng.uniform(0.8, 1.4), 0.0, 0.0, 0.0, 0.0)


def tilt_pulses(rng: Rng) -> Iterator[Piece]:
    while True:
        f, left = _in_direction(rng.uniform(0.35, 0.6), rng)
        span = rng.uniform(0.14, 0.3)
        yield (span, f, left, 0.0, 0.0)
        yield (span, -f, -left, 0.0, 0.0)
        yield (rng.uniform(0.8, 1.6), 0.0, 0.0, 0.0, 0.0)


def square(rng: Rng) -> Iterator[Piece]:
    while True:
        size = rng.uniform(0.16, 0.27)
        for f, left in ((1, 0), (0, 1), (-1, 0), (0, -1)):
            yield (1.1, size * f, size * left, 0.0, 0.0)
            yield (0.6, -0.7 * size * f, -0.7 * size * left, 0.0, 0.0)
            yield (rng.uniform(0.8, 1.2), 0.0, 0.0, 0.0, 0.0)


def vertical_square(rng: Rng) -> Iterator[Piece]:
    while True:
        size, up = rng.uniform(0.14, 0.24), rng.uniform(0.35, 0.6)
        rise = rng.uniform(1.2, 1.9)
        for f, climb in ((0, up), (size, 0), (0, -up), (-size, 0)):
            yield (rise, f, 0.0, climb, 0.0)
            yield (rng.uniform(0.7, 1.1), -0.5 * f, 0.0, 0.0, 0.0)
            yield (0.6, 0.0, 0.0, 0.0, 0.0)


def two_heights(rng: Rng) -> Iterator[Piece]:
    up, climb = 1.0, rng.uniform(0.5, 0.8)
    while True:
        for _ in range(2):
            f, left = _in_direction(rng.uniform(0.15, 0.3), rng)
            yield (0.7, f, left, 0.0, 0.0)
            yield (0.7, -f, -left, 0.0, 0.0)
            yield (rng.uniform(1.2, 1.8), 0.0, 0.0, 0.0, 0.0)
        yield (2.0, 0.0, 0.0, up * climb, 0.0)
        yield (1.5, 0.0, 0.0, 0.0, 0.0)
        up = -up


def yaw_repeat(rng: Rng) -> Iterator[Piece]:
    turn = rng.choice([-1.0, 1.0]) * np.pi / 1.5 / 2.6
    size = rng.uniform(0.15, 0.28)
    while True:
        yield (0.9, size, 0.0, 0.0, 0.0)
        yield (0.9, -size, 0.0, 0.0, 0.0)
        yield (rng.uniform(1.5, 2.5), 0.0, 0.0, 0.0, 0.0)
        yield (2.6 * rng.choice([0.5, 1.0]), 0.0, 0.0, 0.0, turn)
        yield (rng.uniform(1.2, 2.0), 0.0, 0.0, 0.0, 0.0)


def figure_eight(rng: Rng) -> Iterator[Piece]:
    yield (1.0, 0.0, 0.0, 0.0, 0.0)
    size, period, t = rng.uniform(0.14, 0.24), rng.uniform(7.0, 10.0), 0.0
    while True:
        phase = 2.0 * np.pi * t / period
        yield (0.05, size * np.cos(phase), 0.8 * size * np.cos(2.0 * phase), 0.0, 0.0)
        t += 0.05


def touchdown(rng: Rng) -> Iterator[Piece]:
    yield (2.0, 0.0, 0.0, 0.0, 0.0)
    while True:
        f, left = _in_direction(rng.uniform(0.12, 0.25), rng)
        yield (0.8, f, left, 0.0, 0.0)
        yield (0.8, -f, -left, 0.0, 0.0)
        yield (2.0, 0.0, 0.0, 0.0, 0.0)
        yield (6.0, 0.0, 0.0, -0.3, 0.0)
        yield (rng.uniform(1.5, 2.5), 0.0, 0.0, 0.0, 0.0)
        yield (2.2, 0.0, 0.0, 0.5, 0.0)
        yield (1.5, 0.0, 0.0, 0.0, 0.0)


def onward(rng: Rng) -> Iterator[Piece]:
    """Fly one way without a stop: all deceleration is coasting, at speed."""
    f, left = _in_direction(1.0, rng)
    while True:
        size = rng.uniform(0.1, 0.2)
        yield (rng.uniform(0.6, 1.2), size * f, size * left, 0.0, 0.0)
        yield (rng.uniform(1.0, 1.8), 0.0, 0.0, 0.0, 0.0)


def swell(rng: Rng) -> Iterator[Piece]:
    """Fly slow waves only: a latency and a lag have the same effect."""
    size, period, t = rng.uniform(0.14, 0.24), rng.uniform(7.0, 10.0), 0.0
    while True:
        phase = 2.0 * np.pi * t / period
        yield (0.05, size * np.sin(phase), 0.8 * size * np.sin(2.0 * phase), 0.0, 0.0)
        t += 0.05


LANDING = "touchdown"
UNTELLING: dict[str, Callable[[Rng], Iterator[Piece]]] = {p.__name__: p for p in (onward, swell)}
"""Plans for cases in which causes are indistinguishable."""
PLANS: dict[str, Callable[[Rng], Iterator[Piece]]] = {
    p.__name__: p
    for p in (
        hover, pulse_and_coast, reversing_steps, tilt_pulses, square, vertical_square, two_heights,
        yaw_repeat,
        figure_eight, touchdown,
    )
}  # fmt: skip


def stick_of(plan: str, duration_s: float, rng: Rng) -> np.ndarray:
    """(duration / GRID_S, 4) forward left up yaw as given, rounded as a log would."""
    out = np.zeros((round(duration_s / GRID_S), 4))
    at = round(rng.uniform(1.5, 3.0) / GRID_S)
    for seconds, *values in (PLANS | UNTELLING)[plan](rng):
        if at >= len(out):
            return out
        end = at + max(round(seconds / GRID_S), 1)
        out[at:end] = np.round(values, 3)
        at = end
    raise AssertionError


def start_of(plan: str, rng: Rng) -> np.ndarray:
    """x y z yaw."""
    z = {"touchdown": (0.9, 1.2), "two_heights": (0.8, 1.2)}.get(plan, (1.0, 1.8))
    return np.array([rng.uniform(-2, 2), rng.uniform(-2, 2), rng.uniform(*z), rng.uniform(-np.pi, np.pi)])
