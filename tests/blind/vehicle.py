"""Independent quadrotor, flown by sticks: the measured side of the blind tests.

Written from the description of the healthy vehicle alone; it shares no code with the simulator or the critic.
All knobs are one flat dict; healthy ones switch every effect off. Many members (flights, or one flight with
and without an effect) fly side by side as arrays. The autopilot polls the stick every ``h`` seconds; within a
step the tilt is exact, the speed a midpoint rule, and near the floor the height is stepped ten times finer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

G = 9.80665
FULL_TILT, CLIMB, YAW_RATE = 0.5236, 1.0, 1.5
CLIMB_S, YAW_S, POLE_S = 0.30, 0.05, 0.020
LEGS = 0.08
FADE = 0.04
SPRING, DAMPER, RUB = 2500.0, 60.0, 12.0
SWING_S = 0.25
KNOCKED_AT = 0.5
"""Elapsed share of the flight when an impact occurs."""

HEALTHY: dict[str, float] = {
    "gain": 1.0, "drag": G * 0.057, "lag": 0.10, "datum": 0.0,
    "tilt_std": np.radians(0.4), "tilt_tau": 0.25, "spin_std": np.radians(1.0), "spin_tau": 0.35,
    "shake_std": 0.034, "shake_tau": 0.12, "heave_std": 0.012,
    "n_gyro": 1.0, "n_accel": 1.0, "n_attitude": 1.0, "n_flow": 1.0, "n_echo": 1.0,
    "tails": 0.0, "colour": 0.0, "uneven": 0.0,
    # command and motion
    "late": 0.0, "late_spread": 0.0, "sticky_up": 0.0, "curve": 0.0, "slack": 0.0, "limit": 10.0,
    "brake_p": 0.0, "brake_i": 0.0, "brake_most": 0.25, "inflow": 0.0, "cd_area": 0.0, "sag": 0.0,
    "charge": 0.7,
    "lean_roll": 0.0, "lean_pitch": 0.0, "wind_x": 0.0, "wind_y": 0.0, "gust": 0.0, "gust_tau": 1.5,
    "cushion": 0.0, "sink": 0.0, "spin_drag": 0.0, "load": 0.0, "load_hz": 0.6, "askew": 0.0, "nose_up": 0.0,
    "swing_over": 0.0, "lazy_servo": 0.0, "knock_roll": 0.0, "knock_pitch": 0.0, "swirl": 0.0,
    "tilt_turns": 0.0, "cant_ahead": 0.0, "cant_left": 0.0,
    # instruments
    "flow_eps": 0.0, "flow_turn": 0.0, "flow_top": 0.0, "flow_stuck": 0.0, "late_level": 0.0,
    "echo_fast": 0.0, "pulled": 0.0,
    "cone": 0.0, "echo_x": 0.0, "echo_y": 0.0, "echo_eps": 0.0, "echo_add": 0.0, "warm_k": 0.0,
    "echo_step": 0.0,
    "echo_floor": 0.0, "echo_lag": 0.0, "echo_twice": 0.0,
    "gyro_x": 0.0, "gyro_y": 0.0, "gyro_z": 0.0, "gyro_eps": 0.0, "accel_x": 0.0, "accel_y": 0.0,
    "accel_z": 0.0,
    "accel_eps": 0.0, "turn_x": 0.0, "turn_y": 0.0, "turn_z": 0.0, "hum": 0.0, "hum_hz": 17.0,
    "iron": 0.0, "iron_x": 0.0, "iron_y": 0.0, "false_level": 0.0, "arm_x": 0.0, "arm_y": 0.0, "arm_z": 0.0,
    "flow_askew": 0.0,
    # clocks and place
    "ppm": 0.0, "stamp_jitter": 0.0, "slope_x": 0.0, "slope_y": 0.0, "box": 0.0, "box_share": 0.2,
    "box_seed": 0.0,
    # camera
    "zoom": 0.0, "barrel": 0.0, "mount_x": 0.0, "mount_y": 0.0, "stamp_late": 0.0, "readout": 0.0,
    "open_s": 0.0, "adapt": 0.0, "adapt_s": 0.6, "dark_edge": 0.0, "shine": 0.0, "lost": 0.0, "crowd": 0.0,
    "creep": 0.0, "squeeze": 0.0, "drop": 0.0, "torn": 0.0, "hunting": 0.0, "flicker": 0.0,
    "dirt": 0.0, "haze": 0.0,
}  # fmt: skip
"""Knob -> healthy value, SI units; what each does stands where it is read."""

Knobs = Mapping[str, float]


def stacked(members: Sequence[Knobs]) -> dict[str, np.ndarray]:
    """One (members,) array a knob."""
    unknown = {k for m in members for k in m} - set(HEALTHY)
    assert not unknown, unknown
    return {name: np.array([m.get(name, value) for m in members]) for name, value in HEALTHY.items()}


@dataclass(frozen=True)
class Path:
    """True motion: nodes every ``h`` seconds, (steps + 1, members) each."""

    h: float
    knobs: dict[str, np.ndarray]
    state: np.ndarray
    """(steps + 1, 14, members): x y z vx vy vz roll pitch yaw yaw_rate, load x vx y vy."""
    held: np.ndarray
    """(steps, 7, members): roll and pitch asked for, up, yaw, gust x, gust y, slowing (unused in flight)."""
    noise: np.ndarray
    """(steps + 1, 9, members): roll pitch yaw-rate, o_x o_y o_z before the pole, w_x w_y w_z behind it."""


def ornstein(steps: int, h: float, tau: float, rng: np.random.Generator) -> np.ndarray:
    """(steps + 1,) stationary, of unit variance."""
    a = np.exp(-h / tau)
    kicks = rng.standard_normal(steps + 1) * np.sqrt(1.0 - a * a)
    kicks[0] /= np.sqrt(1.0 - a * a)
    return lfilter([1.0], [1.0, -a], kicks)


def unrest(knobs: Knobs, steps: int, h: float, rng: np.random.Generator) -> np.ndarray:
    """(steps + 1, 11) one member's hold noise and its gusts; ``Path.noise`` and two columns of wind."""
    k = {**HEALTHY, **knobs}
    early = int(np.ceil(1.0 / h))
    out = np.zeros((steps + 1, 11))
    out[:, 0] = k["tilt_std"] * ornstein(steps, h, k["tilt_tau"], rng)
    out[:, 1] = k["tilt_std"] * ornstein(steps, h, k["tilt_tau"], rng)
    out[:, 2] = k["spin_std"] * ornstein(steps, h, k["spin_tau"], rng)
    before = np.sqrt((k["shake_tau"] + POLE_S) / k["shake_tau"])
    a, m = np.exp(-h / POLE_S), (1.0 - np.exp(-h / POLE_S)) * POLE_S / h
    for axis, std in enumerate((k["shake_std"], k["shake_std"], k["heave_std"])):
        o = std * before * ornstein(steps + early, h, k["shake_tau"], rng)
        # Exact for an input linear over each step.
        w = lfilter([1.0 - m, m - a], [1.0, -a], o)
        out[:, 3 + axis], out[:, 6 + axis] = o[early:], w[early:]
    for axis in range(2):
        # Slow and quick eddies together: not the one time constant of the catalogue's own.
        slow = ornstein(steps, h, 1.5 * k["gust_tau"], rng)
        quick = ornstein(steps, h, 0.5 * k["gust_tau"], rng)
        out[:, 9 + axis] = k["gust"] * (0.8 * slow + 0.6 * quick)
    return out


def calm(z: np.ndarray) -> np.ndarray:
    """Share of the hold noise that is left: it fades over the last 4 cm."""
    return np.clip((z - LEGS) / FADE, 0.0, 1.0)


def obeyed(stick: np.ndarray, knobs: Knobs, h: float, rng: np.random.Generator) -> np.ndarray:
    """(steps, 4) what reaches the autopilot of what was given: a queue with jitter, a sticky throttle."""
    out = stick
    late, spread = knobs.get("late", 0.0), knobs.get("late_spread", 0.0)
    if late > 0.0:
        begins = np.flatnonzero(np.any(np.diff(stick, axis=0, prepend=stick[:1] + 1.0) != 0.0, axis=1))
        # Mean delay ``late``: the poll waits half a step more; no message overtakes another.
        release = begins * h + np.maximum(late - 0.5 * h + spread * rng.standard_normal(len(begins)), 0.0)
        release = np.maximum.accumulate(release)
        polls = np.arange(len(stick)) * h
        newest = np.searchsorted(release, polls + 1e-9, side="right") - 1
        out = np.where((newest >= 0)[:, None], stick[begins[np.maximum(newest, 0)]], 0.0)
    play = knobs.get("sticky_up", 0.0)
    if play > 0.0:
        up, last = out[:, 2].copy(), 0.0
        for i, asked in enumerate(out[:, 2]):
            last = asked if abs(asked - last) > play else last
            up[i] = last
        out = np.column_stack([out[:, :2], up, out[:, 3]])
    return out


def _shaped(s: np.ndarray, k: dict[str, np.ndarray]) -> np.ndarray:
    """The stick's curve as a table of 21 points, after a soft dead band."""
    slack = k["slack"]
    soft = s * s**2 / (s**2 + slack**2 + 1e-300) if slack.any() else s
    if not k["curve"].any():
        return soft
    x = np.abs(soft) * 20.0
    low = np.minimum(np.floor(x), 19.0)
    at = [(low + i) / 20.0 for i in (0, 1)]
    knots = [a + k["curve"] * a**3 for a in at]
    return np.sign(soft) * (knots[0] + (x - low) * (knots[1] - knots[0]))


def strength(k: dict[str, np.ndarray], drawn: float) -> np.ndarray:
    """Share of thrust left after a share ``drawn`` (0 to 1) of the flight: a voltage with a knee."""

    def volts(left: np.ndarray) -> np.ndarray:
        return 0.9 + 0.1 * left - 0.16 * np.exp(-np.maximum(left, 0.0) / 0.09)

    return 1.0 - k["sag"] * (1.0 - volts(k["charge"] * (1.0 - drawn)) / volts(k["charge"])) / (
        1.0 - volts(k["charge"] * 0.0) / volts(k["charge"])
    )


@dataclass(frozen=True)
class Memory:
    """State of the autopilot, (2, members) each."""

    integral: np.ndarray
    """The brake's, ahead and left."""
    servo: np.ndarray
    """Roll and pitch that a servo of limited speed has got to, ..."""
    followed: np.ndarray
    """... and that one with a swing comes back to."""

    @staticmethod
    def of(members: int) -> Memory:
        """Return the state at rest."""
        return Memory(*(np.zeros((2, members)) for _ in range(3)))


def asked_tilt(
    k: dict[str, np.ndarray],
    stick: np.ndarray,
    state: np.ndarray,
    memory: Memory,
    drawn: float,
    h: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Roll and pitch that the autopilot asks for; moves its memory on (in place)."""
    reach = FULL_TILT * k["gain"] * (strength(k, drawn) if k["sag"].any() else 1.0)
    # The pilot's ahead and the autopilot's.
    c, s = np.cos(k["askew"]), np.sin(k["askew"])
    pitch = reach * _shaped(c * stick[0] - s * stick[1], k)
    roll = -reach * _shaped(s * stick[0] + c * stick[1], k)
    if (k["limit"] < 1.5).any():
        # Smooth saturation of order 12.
        pitch = pitch / (1.0 + np.abs(pitch / k["limit"]) ** 12) ** (1 / 12)
        roll = roll / (1.0 + np.abs(roll / k["limit"]) ** 12) ** (1 / 12)
    if k["brake_p"].any():
        idle = (stick[0] == 0.0) & (stick[1] == 0.0)
        nose = np.exp(-1j * state[8]) * (state[3] + 1j * state[4])
        ahead, left = nose.real, nose.imag
        memory.integral[:] += np.where(idle, h * np.stack([ahead, left]), -memory.integral)
        top = np.where(idle, k["brake_most"], 0.0)
        pitch = pitch - np.clip((k["brake_p"] * ahead + k["brake_i"] * memory.integral[0]) / G, -top, top)
        roll = roll + np.clip((k["brake_p"] * left + k["brake_i"] * memory.integral[1]) / G, -top, top)
    if k["lazy_servo"].any():
        # No faster than so many rad/s.
        most = np.where(k["lazy_servo"] > 0.0, h * k["lazy_servo"], np.inf)
        memory.servo[:] += np.clip(np.stack([roll, pitch]) - memory.servo, -most, most)
        roll, pitch = memory.servo.copy()
    if k["swing_over"].any():
        over = np.stack([roll, pitch]) - memory.followed
        memory.followed[:] += over * (1.0 - np.exp(-h / SWING_S))
        roll, pitch = roll + k["swing_over"] * over[0], pitch + k["swing_over"] * over[1]
    knocked = drawn > KNOCKED_AT
    roll, pitch = roll + k["lean_roll"] + knocked * k["knock_roll"], pitch + k["lean_pitch"]
    return roll, pitch + knocked * k["knock_pitch"] - k["nose_up"] * stick[2]


def push(k: dict[str, np.ndarray], state: np.ndarray, gust: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Horizontal acceleration v' in the world: tilt against the air, the load, the floor's friction."""
    z, vx, vy, roll, pitch, yaw = (state[i] for i in (2, 3, 4, 6, 7, 8))
    c, s = np.cos(yaw), np.sin(yaw)
    # The rotors push along (cant_ahead, cant_left, 1) of the body, as hard as carries the weight.
    nose, side = k["cant_ahead"], k["cant_left"]
    up = np.cos(pitch) * np.cos(roll) - np.sin(pitch) * nose + np.cos(pitch) * np.sin(roll) * side
    ahead = (np.sin(pitch) * np.cos(roll) + np.cos(pitch) * nose + np.sin(pitch) * np.sin(roll) * side) / up
    left = (np.cos(roll) * side - np.sin(roll)) / up
    fx, fy = G * (c * ahead - s * left), G * (s * ahead + c * left)
    # A boundary layer: the wind is as named at 1 m and falls towards the floor.
    layer = np.log1p(np.maximum(z, 0.0) / 0.02) / np.log1p(1.0 / 0.02)
    rx, ry = vx - k["wind_x"] * layer - gust[0], vy - k["wind_y"] * layer - gust[1]
    drag = k["drag"] + 0.5 * 1.2 / 0.42 * k["cd_area"] * np.hypot(rx, ry)
    if k["inflow"].any():
        # A disc that slows down sees its inflow turned: the share grows with the slowing per drag.
        speed = np.hypot(vx, vy)
        along = (vx * (fx - drag * rx) + vy * (fy - drag * ry)) / (speed + 0.02)
        turned = -along / (0.15 + 0.05 * speed)
        drag = drag * (1.0 + k["inflow"] * 0.5 * (1.0 + turned / np.sqrt(1.0 + turned**2)))
    ax, ay = fx - drag * rx, fy - drag * ry
    if k["load"].any():
        stiff = (2.0 * np.pi * k["load_hz"]) ** 2
        ax, ay = ax + k["load"] * stiff * state[10], ay + k["load"] * stiff * state[12]
    down = z < LEGS
    return np.where(down, -RUB * vx, ax), np.where(down, -RUB * vy, ay)


def lift(k: dict[str, np.ndarray], z: np.ndarray, vz: np.ndarray, up: np.ndarray) -> np.ndarray:
    """vz': the climb loop, the cushion of air (Hayden's power law), the legs."""
    asked = CLIMB * up * (1.0 + k["sink"] * (up < 0.0))
    # Hayden 1976: power in ground effect 1 / (0.9926 + 0.0379 (D/z)^2), thrust as its 2/3, 1 far away.
    ratio = (1.0 + 0.0379 / 0.9926 * (2.0 * k["cushion"] / np.maximum(z, 0.05)) ** 2) ** (2 / 3)
    az = (asked - vz) / CLIMB_S + G * (ratio - 1.0)
    sunk = LEGS - z
    return az + np.where(sunk > 0.0, np.maximum(SPRING * sunk - DAMPER * vz, 0.0), 0.0)


def fly(
    members: Sequence[Knobs], sticks: np.ndarray, starts: np.ndarray, noise: np.ndarray | None, h: float
) -> Path:
    """Integrate: sticks (steps, 4, members) obeyed, starts (4, members) x y z yaw, noise of ``unrest``."""
    k = stacked(members)
    steps, _, count = sticks.shape
    if noise is None:
        noise = np.zeros((steps + 1, 11, count))
    state = np.zeros((steps + 1, 14, count))
    state[0, [0, 1, 2, 8]] = starts
    held = np.zeros((steps, 7, count))
    memory = Memory.of(count)
    half, whole = np.exp(-0.5 * h / k["lag"]), np.exp(-h / k["lag"])
    # Yaw: rate and angle exact for a held target.
    free = 1.0 + k["spin_drag"]
    spin = np.exp(-h * free / YAW_S)
    for i in range(steps):
        now, n, stick = state[i], noise[i], sticks[i]
        share = calm(now[2])
        roll_t, pitch_t = asked_tilt(k, stick, now, memory, i / steps, h)
        held[i, 0], held[i, 1] = roll_t, pitch_t
        held[i, 2], held[i, 3] = stick[2], stick[3] + k["tilt_turns"] * (now[6] + now[7])
        # A breeze that turns round once in a flight.
        round_ = 2.0 * np.pi * i / steps
        held[i, 4:6] = n[9:11] * share + k["swirl"] * np.array([[np.cos(round_)], [np.sin(round_)]])
        roll_t, pitch_t = roll_t + share * n[0], pitch_t + share * n[1]
        rate_t = (YAW_RATE * held[i, 3] + share * n[2]) / free
        mid = now.copy()
        mid[6], mid[7] = roll_t + (now[6] - roll_t) * half, pitch_t + (now[7] - pitch_t) * half
        ax, ay = push(k, now, held[i, 4:6])
        new = state[i + 1]
        new[6], new[7] = roll_t + (now[6] - roll_t) * whole, pitch_t + (now[7] - pitch_t) * whole
        new[9] = rate_t + (now[9] - rate_t) * spin
        new[8] = now[8] + rate_t * h + (now[9] - rate_t) * (1.0 - spin) * YAW_S / free
        mid[3], mid[4] = now[3] + 0.5 * h * ax, now[4] + 0.5 * h * ay
        mid[8] = now[8] + 0.5 * h * now[9]
        mx, my = push(k, mid, held[i, 4:6])
        new[3], new[4] = now[3] + h * mx, now[4] + h * my
        w = 0.5 * (share * n[6:9] + calm(now[2]) * noise[i + 1, 6:9])
        new[2], new[5] = climbed(k, now[2], now[5], stick[2], w[2], h)
        new[0] = now[0] + h * (mid[3] + w[0])
        new[1] = now[1] + h * (mid[4] + w[1])
        if k["load"].any():
            stiff = (2.0 * np.pi * k["load_hz"]) ** 2
            for q, a in ((10, mx), (12, my)):
                new[q + 1] = now[q + 1] + h * (-stiff * now[q] - 0.1 * np.sqrt(stiff) * now[q + 1] - a)
                new[q] = now[q] + h * new[q + 1]
    return Path(h, k, state, held, noise[:, :9])


def climbed(
    k: dict[str, np.ndarray],
    z: np.ndarray,
    vz: np.ndarray,
    up: np.ndarray,
    w: np.ndarray,
    span: np.ndarray | float,
) -> tuple[np.ndarray, np.ndarray]:
    """Height and climb after ``span``: midpoint rule, in ten steps where anybody is near the floor."""
    parts = 10 if (z < 0.12).any() else 1
    h = span / parts
    for _ in range(parts):
        a = lift(k, z, vz, up)
        z_mid, vz_mid = z + 0.5 * h * (vz + w), vz + 0.5 * h * a
        z, vz = z + h * (vz_mid + w), vz + h * lift(k, z_mid, vz_mid, up)
    return z, vz
