"""What the instruments of the blind tests' quadrotor read: exact values at any moment, and noisy streams."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from tests.blind.vehicle import FADE, POLE_S, YAW_RATE, YAW_S, G, Path, calm, climbed, lift, push

RATE_HZ = {"imu0": 100.0, "attitude0": 50.0, "velocity0": 60.0, "sonar0": 25.0, "battery0": 5.0}
NOISE = {
    "gyro": 1.5e-3 * np.sqrt(RATE_HZ["imu0"]), "accel": 5.0e-2 * np.sqrt(RATE_HZ["imu0"]),
    "attitude": np.radians(0.3), "velocity": 0.03, "sonar": 0.01, "battery": 0.02,
}  # fmt: skip
"""Standard deviation of a sample."""
RANGE_M = (0.25, 6.0)
STUCK = 20
"""Readings for which the flow sensor stays where it was."""


@dataclass(frozen=True)
class Moments:
    """One member at some moments, (n,) or (n, axes) each."""

    t: np.ndarray
    k: dict[str, np.ndarray]
    place: np.ndarray
    angles: np.ndarray
    """roll pitch yaw."""
    turning: np.ndarray
    """Their rates."""
    spinning: np.ndarray
    """And the rates of these."""
    speed: np.ndarray
    """(n, 3) v + w, world."""
    acceleration: np.ndarray
    """(n, 3) its derivative."""

    @property
    def w_R_b(self) -> Rotation:
        """Intrinsic z-y-x."""
        return Rotation.from_euler("ZYX", self.angles[:, ::-1])

    @property
    def body_rate(self) -> np.ndarray:
        """(n, 3) p q r."""
        (dr, dp, dy), (r, p, _) = self.turning.T, self.angles.T
        return np.column_stack(
            [
                dr - np.sin(p) * dy,
                np.cos(r) * dp + np.sin(r) * np.cos(p) * dy,
                -np.sin(r) * dp + np.cos(r) * np.cos(p) * dy,
            ]
        )

    @property
    def in_heading(self) -> np.ndarray:
        """(n, 4) forward and left speed, forward and left acceleration."""
        c, s = np.cos(self.angles[:, 2]), np.sin(self.angles[:, 2])
        both = [
            f(a)
            for a in (self.speed, self.acceleration)
            for f in (lambda a: c * a[:, 0] + s * a[:, 1], lambda a: c * a[:, 1] - s * a[:, 0])
        ]
        return np.column_stack(both)


def moments(path: Path, member: int, t: np.ndarray, rng: np.random.Generator | None = None) -> Moments:
    """Exact within the integrator's own steps; ``rng`` adds the shaking's roughness inside a step."""
    k = {name: value[member] for name, value in path.knobs.items()}
    t = np.clip(t, 0.0, path.h * len(path.held) - 1e-9)
    i = np.minimum((t / path.h).astype(int), len(path.held) - 1)
    past = t - i * path.h
    a, held, n = path.state[i, :, member].T, path.held[i, :, member].T, path.noise[i, :, member].T
    after = path.noise[i + 1, :, member].T
    part = past / path.h
    share = calm(a[2])
    now = a.copy()
    turning = np.zeros((3, len(t)))
    for axis in range(2):
        target = held[axis] + share * n[axis]
        now[6 + axis] = target + (a[6 + axis] - target) * np.exp(-past / k["lag"])
        turning[axis] = (target - now[6 + axis]) / k["lag"]
    free = 1.0 + k["spin_drag"]
    target = (YAW_RATE * held[3] + share * n[2]) / free
    gone = np.exp(-past * free / YAW_S)
    now[9] = target + (a[9] - target) * gone
    now[8] = a[8] + target * past + (a[9] - target) * (1.0 - gone) * YAW_S / free
    turning[2] = now[9]
    spinning = np.stack([-turning[0] / k["lag"], -turning[1] / k["lag"], (target - now[9]) * free / YAW_S])
    w = n[6:9] + part * (after[6:9] - n[6:9])
    o = n[3:6] + part * (after[3:6] - n[3:6])
    if rng is not None:
        std = np.array([k["shake_std"], k["shake_std"], k["heave_std"]])
        std = std * np.sqrt((k["shake_tau"] + POLE_S) / k["shake_tau"])
        bridge = np.sqrt(2.0 / k["shake_tau"] * past * (path.h - past) / path.h)
        o = o + std[:, None] * bridge * rng.standard_normal(o.shape)
    drift = share * 0.5 * (n[8] + w[2])
    now[2], now[5] = climbed(k, a[2], a[5], held[2], drift, past)
    ax, ay = push(k, a, held[4:6])
    mid = a + 0.0
    mid[6:9] = 0.5 * (a[6:9] + now[6:9])
    mid[3], mid[4] = a[3] + 0.5 * past * ax, a[4] + 0.5 * past * ay
    mx, my = push(k, mid, held[4:6])
    now[3], now[4] = a[3] + past * mx, a[4] + past * my
    for axis in range(2):
        now[axis] = a[axis] + part * (path.state[i + 1, axis, member] - a[axis])
    share = calm(now[2])
    speed = now[3:6] + share * w
    ax, ay = push(k, now, held[4:6])
    fading = np.where((share > 0.0) & (share < 1.0), speed[2] / FADE, 0.0)
    force = np.stack([ax, ay, lift(k, now[2], now[5], held[2])])
    return Moments(
        t,
        k,
        now[:3].T,
        now[6:9].T,
        turning.T,
        spinning.T,
        speed.T,
        (force + share * (o - w) / POLE_S + fading * w).T,
    )


def inertial(m: Moments) -> np.ndarray:
    """(n, 6) gyro and accelerometer."""
    k = m.k
    frame = Rotation.from_rotvec(np.array([k["turn_x"], k["turn_y"], k["turn_z"]]))
    warm = 0.9 + 0.3 * np.exp(-m.t / 12.0)
    gyro = frame.inv().apply(m.body_rate) * (1.0 + k["gyro_eps"])
    gyro = gyro + warm[:, None] * np.array([k["gyro_x"], k["gyro_y"], k["gyro_z"]])
    arm, rate = np.array([k["arm_x"], k["arm_y"], k["arm_z"]]), m.body_rate
    felt = m.w_R_b.inv().apply(m.acceleration + np.array([0.0, 0.0, G]))
    # Off the centre; tilts are small, so that their second derivatives are the body's.
    felt = felt + np.cross(m.spinning, arm) + np.cross(rate, np.cross(rate, arm))
    force = frame.inv().apply(felt)
    force = force * (1.0 + k["accel_eps"]) + np.array([k["accel_x"], k["accel_y"], k["accel_z"]])
    # Masses in the gyro that give way to what the vehicle feels beyond its weight.
    gyro = gyro + k["pulled"] * (felt - np.array([0.0, 0.0, G]))[:, [1, 2, 0]]
    hum = k["hum"] * np.sin(2.0 * np.pi * k["hum_hz"] * m.t)
    gyro[:, 0] += hum / 40.0
    force[:, 1] += hum
    return np.column_stack([gyro, force])


def attitude(m: Moments) -> np.ndarray:
    """(n, 3) roll pitch yaw, yaw unwrapped."""
    k, out = m.k, m.angles.copy()
    far = (m.place[:, 0] - k["iron_x"]) ** 2 + (m.place[:, 1] - k["iron_y"]) ** 2
    out[:, 2] += k["iron"] * np.exp(-far / (2.0 * 0.9**2))
    out[:, 0] += k["false_level"] * m.in_heading[:, 3] / G
    out[:, 1] -= k["false_level"] * m.in_heading[:, 2] / G
    return out


def velocity(m: Moments) -> np.ndarray:
    """(n, 2) forward and left."""
    k, v, rate = m.k, m.in_heading[:, :2].copy(), m.body_rate
    v[:, 0] += k["flow_turn"] * rate[:, 1] * m.place[:, 2]
    v[:, 1] -= k["flow_turn"] * rate[:, 0] * m.place[:, 2]
    v *= 1.0 + k["flow_eps"]
    c, s = np.cos(k["flow_askew"]), np.sin(k["flow_askew"])
    v = np.column_stack([c * v[:, 0] - s * v[:, 1], s * v[:, 0] + c * v[:, 1]])
    if k["flow_top"] > 0.0:
        v /= (1.0 + (np.abs(v) / k["flow_top"]) ** 4) ** 0.25
    return v


def echo(m: Moments) -> np.ndarray:
    """(n,) range, out of range included."""
    k = m.k
    axis = Rotation.from_rotvec(np.array([k["echo_x"], k["echo_y"], 0.0])).apply([0.0, 0.0, -1.0])
    beam = m.w_R_b.apply(axis)
    height = m.place[:, 2].copy()
    if k["cone"] > 0.0:
        off = np.arccos(np.clip(-beam[:, 2], -1.0, 1.0))
        out = height / np.cos(np.maximum(off - k["cone"], 0.0))
    else:
        slope = np.array([k["slope_x"], k["slope_y"]])
        hit = m.place[:, :2] + (height / -beam[:, 2])[:, None] * beam[:, :2]
        if k["box"] > 0.0:
            cell = np.floor(hit / 0.6).astype(np.int64)
            mixed = (cell[:, 0] * 73856093) ^ (cell[:, 1] * 19349663) ^ (int(k["box_seed"]) * 83492791)
            height = height - k["box"] * ((mixed * 2654435761 % 4294967296) / 4294967296 < k["box_share"])
        out = (height - m.place[:, :2] @ slope) / (-beam[:, 2] + beam[:, :2] @ slope)
    # Speed of sound from the absolute temperature.
    rise = k["warm_k"] * (1.0 - np.exp(-m.t / 25.0))
    out = out / np.sqrt(1.0 + rise / 293.15)
    out = out + k["echo_fast"] * np.hypot(m.speed[:, 0], m.speed[:, 1])
    return out * (1.0 + k["echo_eps"]) + k["echo_add"]


def heard(path: Path, member: int, t: np.ndarray) -> np.ndarray:
    """(n,) range with the sonar's own averaging: a window of twice the lag, and the floor's datum."""
    lag = path.knobs["echo_lag"][member]
    parts = np.linspace(0.05, 0.95, 10) * 2.0 * lag if lag > 0.0 else np.zeros(1)
    mean = np.mean([echo(moments(path, member, t - back)) for back in parts], axis=0)
    return mean + path.knobs["datum"][member]


def stuck(value: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """Readings (n, columns) of which a share repeats an earlier one, ``STUCK`` on end."""
    begins = np.flatnonzero(rng.uniform(size=len(value)) < share / STUCK)
    source = np.arange(len(value))
    for begin in begins:
        source[begin : begin + STUCK] = source[begin]
    return value[source]


def stamps(rate_hz: float, duration_s: float, rng: np.random.Generator) -> np.ndarray:
    """Regular, at a rate and phase of their own."""
    rate = rate_hz * rng.uniform(0.996, 1.004)
    first = rng.uniform(0.0, 0.25)
    return first + np.arange(int((duration_s - first) * rate)) / rate


def noisier(m: Moments, stream: str) -> np.ndarray:
    """(n, 1) how many times its usual noise a stream has, from ``k["uneven"]`` below 1 to as much above.

    That of flow and sonar grows with the height, that of the others with the speed.
    """
    if stream in ("velocity0", "sonar0"):
        grown = (m.place[:, 2] - 0.5) / 1.5
    else:
        grown = np.hypot(m.speed[:, 0], m.speed[:, 1]) / 0.8
    return 1.0 + m.k["uneven"] * (2.0 * np.clip(grown, 0.0, 1.0)[:, None] - 1.0)


def noisy(
    value: np.ndarray, std: np.ndarray | float, k: dict[str, float], rng: np.random.Generator
) -> np.ndarray:
    """White noise; of Student's t with four degrees of freedom and the same spread if ``k["tails"]``; a first
    order autoregression of that spread, ``k["colour"]`` from one sample to the next, if that is not 0."""
    shape = (len(value), value.size // len(value))
    draw = rng.standard_t(4, shape) / np.sqrt(2.0) if k["tails"] else rng.standard_normal(shape)
    if k["colour"]:
        draw[1:] *= np.sqrt(1.0 - k["colour"] ** 2)
        draw = lfilter([1.0], [1.0, -k["colour"]], draw, axis=0)
    return value + std * draw.reshape(value.shape)


def streams(path: Path, member: int, stick: np.ndarray, rng: np.random.Generator) -> dict[str, tuple]:
    """Stream -> (stamps in s on the recorder's clock, (n, columns) values), noise and rounding included."""
    k = {name: float(value[member]) for name, value in path.knobs.items()}
    duration = path.h * len(path.held)
    t = {name: stamps(rate, duration, rng) for name, rate in RATE_HZ.items()}
    loud = {
        name: noisier(moments(path, member, when), name) if k["uneven"] else 1.0 for name, when in t.items()
    }
    imu = inertial(moments(path, member, t["imu0"], rng))
    gyro = noisy(imu[:, :3], NOISE["gyro"] * k["n_gyro"] * loud["imu0"], k, rng)
    accel = noisy(imu[:, 3:], NOISE["accel"] * k["n_accel"] * loud["imu0"], k, rng)
    angles = attitude(moments(path, member, t["attitude0"] - k["late_level"]))
    angles = noisy(angles, NOISE["attitude"] * k["n_attitude"] * loud["attitude0"], k, rng)
    angles[:, 2] = (angles[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    flow = velocity(moments(path, member, t["velocity0"], rng))
    if k["flow_stuck"] > 0.0:
        flow = stuck(flow, k["flow_stuck"], np.random.default_rng(member))
    flow = noisy(flow, NOISE["velocity"] * k["n_flow"] * loud["velocity0"], k, rng)
    reach = heard(path, member, t["sonar0"])
    twice = rng.uniform(size=len(reach)) < k["echo_twice"]
    reach = noisy(
        np.where(twice, 1.98 * reach, reach)[:, None], NOISE["sonar"] * k["n_echo"] * loud["sonar0"], k, rng
    )[:, 0]
    if k["echo_step"] > 0.0:
        reach = np.floor(reach / k["echo_step"] + 0.5) * k["echo_step"]
    reach = np.maximum(reach, k["echo_floor"])
    reach[(reach < RANGE_M[0]) | (reach > RANGE_M[1])] = np.nan
    volts = noisy(
        voltage(stick, k["charge"], duration, t["battery0"]),
        NOISE["battery"],
        {"tails": 0.0, "colour": 0.0},
        rng,
    )
    values = {
        "imu0": np.column_stack([gyro.round(5), accel.round(4)]), "attitude0": angles.round(5),
        "velocity0": flow.round(4), "sonar0": reach[:, None].round(4), "battery0": volts[:, None].round(3),
    }  # fmt: skip
    out = {}
    for name, when in t.items():
        jitter = k["stamp_jitter"] * (rng.gamma(4.0, 0.5, len(when)) - 2.0)
        # A recorder stamps in the order of arrival.
        out[name] = (np.sort(when * (1.0 + 1e-6 * k["ppm"]) + jitter), values[name])
    return out


def voltage(stick: np.ndarray, charge: float, duration: float, t: np.ndarray) -> np.ndarray:
    """Three cells: falling with the charge drawn, with a knee when nearly empty, and dips under load."""
    current = 1.0 + 0.5 * np.abs(stick[:, :2]).sum(axis=1) + 0.6 * np.maximum(stick[:, 2], 0.0)
    drawn = np.cumsum(current) / len(current)
    at = np.minimum((t / duration * len(stick)).astype(int), len(stick) - 1)
    left = charge * (1.0 - 0.6 * drawn[at])
    return 3.0 * (3.3 + 0.75 * left - 0.5 * np.exp(-left / 0.06)) - 0.12 * current[at]
