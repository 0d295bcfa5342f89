"""Strength d of an effect in standard deviations, computed by the generator itself.

Noise-free outputs with and without the effect are compared with the noise of a hovering vehicle. A Kalman
filter (linear, one axis at a time) whitens the difference; d is its length after the healthy nuisances are
projected out with their priors.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import expm

from tests.blind.instruments import NOISE, RANGE_M, RATE_HZ, attitude, heard, inertial, moments, velocity
from tests.blind.vehicle import CLIMB_S, FADE, HEALTHY, LEGS, POLE_S, YAW_S, G, Knobs, Path

STEP_S = 0.02
NUISANCES = {"gain": (0.05, 0.05), "drag": (0.0559, 0.0559), "lag": (0.01, 0.01), "datum": (0.01, 0.01)}
"""Knob -> (step, half width of its uniform prior)."""


def outputs(
    path: Path, member: int, streams: Sequence[str], beside: int | None = None
) -> dict[str, np.ndarray]:
    """Axis -> (samples, channels) noise-free readings every ``STEP_S``; ahead and left are by the heading of
    member ``beside``, by default its own."""
    # Between the moments at which the stick may jump: on them the least drift would pass for a whole jump.
    t = np.arange(0.3 + STEP_S / 8, path.h * len(path.held) - 0.01, STEP_S)
    clock = t * (1.0 - 1e-6 * path.knobs["ppm"][member])
    m = moments(path, member, clock)
    behind = moments(path, member, clock - path.knobs["late_level"][member])
    imu, angles, flow = inertial(m), attitude(behind), velocity(m)
    reach = np.maximum(heard(path, member, clock), path.knobs["echo_floor"][member])
    reach[(reach < RANGE_M[0]) | (reach > RANGE_M[1])] = np.nan
    # The moment of contact is the hold noise's: what the legs do then tells nothing.
    near = np.convolve(m.place[:, 2] < LEGS + FADE, np.ones(25), mode="same") > 0.5
    imu[near, 3:], flow[near] = np.nan, np.nan
    has = {name: np.where(name in streams, 1.0, np.nan) for name in RATE_HZ}
    ahead = [imu[:, 1] * has["imu0"], angles[:, 1] * has["attitude0"], flow[:, 0], imu[:, 3] * has["imu0"]]
    left = [-imu[:, 0] * has["imu0"], -angles[:, 0] * has["attitude0"], flow[:, 1], imu[:, 4] * has["imu0"]]
    # Axes that do not turn: what drifts ahead before a turn drifts to the side after it, which is no news.
    # They are the same with an effect and without: who turns otherwise has turned, and not drifted as well.
    turned = m.angles[:, 2:] if beside is None else moments(path, beside, clock).angles[:, 2:]
    c, s = np.cos(turned), np.sin(turned)
    ahead, left = np.column_stack(ahead), np.column_stack(left)
    return {
        "ahead": c * ahead - s * left,
        "left": s * ahead + c * left,
        "up": np.column_stack([reach, imu[:, 5] * has["imu0"]]),
        "turn": np.column_stack([imu[:, 2] * has["imu0"], angles[:, 2] * has["attitude0"]]),
    }


def whitened(difference: dict[str, np.ndarray], k: Knobs) -> np.ndarray:
    """(samples, all channels, members) innovations of unit variance of (samples, channels, members) an axis.

    A missing reading (not a number) tells nothing.
    """
    k = {**HEALTHY, **k}
    return np.concatenate([_filtered(d, *_axis(axis, k)) for axis, d in difference.items()], axis=1)


def _axis(axis: str, k: Knobs) -> tuple[np.ndarray, ...]:
    """Rates, densities of the kicks, first covariance, readings and their covariance of one axis at hover."""
    per = {name: 1.0 / (rate * STEP_S) for name, rate in RATE_HZ.items()}
    gyro = (NOISE["gyro"] * k["n_gyro"]) ** 2 * per["imu0"]
    accel = (NOISE["accel"] * k["n_accel"]) ** 2 * per["imu0"]
    angle = (NOISE["attitude"] * k["n_attitude"]) ** 2 * per["attitude0"]
    tau_n, tau_w, lag, drag = k["tilt_tau"], k["shake_tau"], k["lag"], k["drag"]
    before = (tau_w + POLE_S) / tau_w
    if axis == "turn":
        rates = np.array([[-1 / YAW_S, 0, 1 / YAW_S], [1, 0, 0], [0, 0, -1 / k["spin_tau"]]])
        kicks, first = [0, 0, 2 * k["spin_std"] ** 2 / k["spin_tau"]], [0, 10.0, k["spin_std"] ** 2]
        return (
            rates,
            np.diag(kicks),
            np.diag(first),
            np.array([[1.0, 0, 0], [0, 1, 0]]),
            np.diag([gyro, angle]),
        )
    if axis == "up":
        std = k["heave_std"]
        rates = np.array(
            [[-1 / CLIMB_S, 0, 0, 0], [1, 0, 1, 0], [0, 0, -1 / POLE_S, 1 / POLE_S], [0, 0, 0, -1 / tau_w]]
        )
        kicks, first = [0, 0, 0, 2 * std**2 * before / tau_w], [0, 10.0, std**2, std**2 * before]
        read = np.array([[0, 1.0, 0, 0], [-1 / CLIMB_S, 0, -1 / POLE_S, 1 / POLE_S]])
        reach = (NOISE["sonar"] * k["n_echo"]) ** 2 * per["sonar0"]
        return rates, np.diag(kicks), np.diag(first), read, np.diag([reach, accel])
    std, tilt = k["shake_std"], k["tilt_std"]
    rates = np.zeros((5, 5))
    rates[0, :2], rates[1, 1], rates[2, [0, 2]] = (-1 / lag, 1 / lag), -1 / tau_n, (G, -drag)
    rates[3, 3:], rates[4, 4] = (-1 / POLE_S, 1 / POLE_S), -1 / tau_w
    kicks = [0, 2 * tilt**2 / tau_n, 0, 0, 2 * std**2 * before / tau_w]
    first = [0, tilt**2, 0, std**2, std**2 * before]
    read = np.array(
        [
            [-1 / lag, 1 / lag, 0, 0, 0],
            [1, 0, 0, 0, 0],
            [0, 0, 1, 1, 0],
            [0, 0, -drag, -1 / POLE_S, 1 / POLE_S],
        ]
    )
    flow = (NOISE["velocity"] * k["n_flow"]) ** 2 * per["velocity0"]
    return rates, np.diag(kicks), np.diag(first), read, np.diag([gyro, angle, flow, accel])


def _filtered(
    d: np.ndarray, rates: np.ndarray, kicks: np.ndarray, p: np.ndarray, read: np.ndarray, noise: np.ndarray
) -> np.ndarray:
    """(samples, channels, members) whitened innovations of the same."""
    count = len(rates)
    # Van Loan: transition and covariance of the kicks over a step.
    loan = expm(STEP_S * np.block([[-rates, kicks], [np.zeros_like(rates), rates.T]]))
    move = loan[count:, count:].T
    spread = move @ loan[:count, count:]
    x = np.zeros((count, d.shape[2]))
    out = np.empty_like(d)
    settled = None
    noise = noise * np.where(np.isnan(d).all(axis=(0, 2)), 1e12, 1.0)
    for i, y in enumerate(d):
        if settled is None:
            s = read @ p @ read.T + noise
            white = np.linalg.inv(np.linalg.cholesky(s))
            gain = move @ np.linalg.solve(s, read @ p).T
            after = move @ p @ move.T - gain @ read @ p @ move.T + spread
            # The covariance does not know the data: once it stands still, so do the gains.
            settled = (white, gain) if i > 50 and np.allclose(after, p, rtol=1e-9, atol=0.0) else None
            p = after
        e = np.nan_to_num(y - read @ x)
        out[i] = white @ e
        x = move @ x + gain @ e
    return out


def strengths(effects: np.ndarray, nuisances: np.ndarray, halves: Sequence[float]) -> np.ndarray:
    """(effects,) d of whitened differences (values, effects) beside (values, nuisances) a step each."""
    precision = np.diag(3.0 / np.square(halves))
    explained = nuisances.T @ effects
    information = nuisances.T @ nuisances + precision
    taken = np.einsum("ij,ij->j", explained, np.linalg.solve(information, explained))
    return np.sqrt(np.maximum(np.einsum("ij,ij->j", effects, effects) - taken, 0.0))
