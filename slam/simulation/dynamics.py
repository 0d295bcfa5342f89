"""The compiled equations of motion: the nominal vehicle and every motion term of the catalogue.

``derivative`` is one pure function of state, command, noise and parameters. The simulator and the replay
integrate it, and criticism linearises it in a Kalman filter: there is no second set of equations. The neutral
value of its parameters switches a term off, so a model is a vector.

Frames and signs are the flight format's: world z up, R_wb = Rz(yaw) Ry(pitch) Rx(roll), forward stick and
pitch > 0 fly forward, left stick asks for roll < 0. Source: IMAV 2011 paper, section 3.2 (stick to tilt to
force, drag linear in velocity, strong yaw drag).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from backend.compilation import allocating_kernel, discard_stale, inner_kernel, kernel
from backend.measurements import GRAVITY_M_S2
from slam.simulation.state import HOLD_X as HOLD_X
from slam.simulation.state import HOLD_Y as HOLD_Y
from slam.simulation.state import PITCH as PITCH
from slam.simulation.state import ROLL as ROLL
from slam.simulation.state import STATE as STATE
from slam.simulation.state import VX as VX
from slam.simulation.state import VY as VY
from slam.simulation.state import VZ as VZ
from slam.simulation.state import YAW as YAW
from slam.simulation.state import YAW_RATE as YAW_RATE
from slam.simulation.state import X as X
from slam.simulation.state import Y as Y
from slam.simulation.state import Z as Z

Array = NDArray[np.float64]

discard_stale(
    [
        Path(__file__),
        Path(__file__).with_name("state.py"),
        Path(__file__).parents[2] / "backend" / "measurements" / "__init__.py",
    ]
)

STEP_S = 0.002
"""Step of the integration: RK4, a fiftieth of the vehicle's fastest own lag."""

COMMAND = (
    "forward", "left", "up", "yaw",  # the stick, -1..1
    "centred",  # share of the time that forward and left were both 0
    "discharge",  # share of the flight's charge already drawn: 0 at the start, 1 at the end
)  # fmt: skip
"""Names of the command's entries: averages over the step."""
(FORWARD, LEFT, UP, TURN, CENTRED, DISCHARGE) = range(len(COMMAND))

NOISE = (
    "roll", "pitch",  # added to the attitude targets [rad]
    "yaw_rate",  # added to the yaw-rate target [rad/s]
    "w_x", "w_y", "w_z",  # velocity on top of v, world [m/s]
    "gust_x", "gust_y",  # wind on top of the steady one, world [m/s]
)  # fmt: skip
"""Names of the noise's entries; each is linear between the nodes of the integration."""
(ROLL_NOISE, PITCH_NOISE, TURN_NOISE, WX, WY, WZ, GUST_X, GUST_Y) = range(len(NOISE))

PARAMETERS = (
    "vehicle.max_tilt_rad",
    "vehicle.gain",
    "vehicle.drag_1_s",
    "vehicle.attitude_time_s",
    "vehicle.climb_rate_m_s",
    "vehicle.climb_time_s",
    "vehicle.yaw_rate_rad_s",
    "vehicle.yaw_time_s",
    "vehicle.gear_height_m",
    "vehicle.fade_height_m",
    "vehicle.small_angle",
    "active_braking.k_b",
    "active_braking.lean",
    "asymmetric_drag.alpha",
    "quadratic_drag.c",
    "command_nonlinearity.eps",
    "command_nonlinearity.dead_band",
    "tilt_limit.limit",
    "battery_sag.loss",
    "trim_offset.roll",
    "trim_offset.pitch",
    "canted_thrust.ahead",
    "canted_thrust.left",
    "steady_wind.x",
    "steady_wind.y",
    "ground_effect.radius",
    "climb_asymmetry.eps",
    "yaw_drag.eps",
    "position_hold.stiffness",
    "position_hold.damping",
    "position_hold.capture_speed",
)
"""Entries of the parameter vector: constants of the vehicle, then ``TERM.PARAMETER`` of the motion terms."""

(
    MAX_TILT, GAIN, DRAG, ATTITUDE_TIME, CLIMB_RATE, CLIMB_TIME, MAX_YAW_RATE, YAW_TIME, GEAR, FADE,
    SMALL_ANGLE, BRAKING, BRAKING_LEAN, ASYMMETRY, QUADRATIC, CUBIC, DEAD_BAND, TILT_LIMIT, SAG,
    TRIM_ROLL, TRIM_PITCH, CANT_AHEAD, CANT_LEFT, WIND_X, WIND_Y, ROTOR_RADIUS, CLIMB_ASYMMETRY, YAW_DRAG,
    HOLD_STIFFNESS, HOLD_DAMPING, HOLD_CAPTURE,
) = range(len(PARAMETERS))  # fmt: skip

FLOOR_STIFFNESS = 2500.0
"""Stiffness of the landing gear, in 1/s^2."""
FLOOR_DAMPING = 60.0
"""Damping of the landing gear, in 1/s: the vehicle comes to rest in about 0.1 s without a bounce."""
SLIDING_1_S = 12.0
"""Rate at which a vehicle on the floor stops sliding, in 1/s."""
DECELERATION_M_S2 = 0.1
"""Width of the smooth change between speeding up and slowing down in ``asymmetric_drag``."""
HOLD_FOLLOW_1_S = 10.0
"""Rate at which the set point follows a vehicle that is being flown, in 1/s."""


@inner_kernel
def _stick(s: float, parameters: Array) -> float:
    """Apply ``command_nonlinearity`` to a stick: first the dead band, then the cubic."""
    beyond = max(abs(s) - parameters[DEAD_BAND], 0.0)
    return math.copysign(beyond + parameters[CUBIC] * beyond**3, s)


@inner_kernel
def noise_share(z: float, parameters: Array) -> float:
    """Return the share of the hold noise at height z: 1 in the air, 0 on the floor."""
    return float(min(max((z - parameters[GEAR]) / parameters[FADE], 0.0), 1.0))


@inner_kernel
def thrust(roll: float, pitch: float, parameters: Array) -> tuple[float, float]:
    """Return the horizontal force over the weight, forward and left: (R13, R23) / R33 at yaw 0."""
    if parameters[SMALL_ANGLE] < 0.5:
        return math.tan(pitch), -math.tan(roll) / math.cos(pitch)
    return pitch, -roll


@kernel
def derivative(state: Array, command: Array, noise: Array, parameters: Array, rate: Array) -> None:
    """Write d(state)/dt into ``rate``. Shapes: ``STATE``, ``COMMAND``, ``NOISE``, ``PARAMETERS``, ``STATE``.

    Everything but ``rate`` is read only. The function is continuous in all arguments except at floor contact.
    """
    ahead, aside = thrust(state[ROLL], state[PITCH], parameters)
    rates(state, math.cos(state[YAW]), math.sin(state[YAW]), ahead, aside, command, noise, parameters, rate)


@inner_kernel
def rates(
    state: Array, c: float, s: float, ahead: float, aside: float, command: Array, noise: Array,
    parameters: Array, rate: Array,
) -> None:  # fmt: skip
    """Compute ``derivative`` from given cosine and sine of the heading and a given ``thrust``."""
    vx, vy, vz = state[VX], state[VY], state[VZ]
    roll, pitch = state[ROLL], state[PITCH]
    share = noise_share(state[Z], parameters)
    height = state[Z] - parameters[GEAR]
    on_floor = height < 0.0

    # Stick to tilt: a first-order lag behind gain times stick, clipped by tilt_limit.
    reach = parameters[MAX_TILT] * parameters[GAIN] * (1.0 - parameters[SAG] * command[DISCHARGE])
    limit = parameters[TILT_LIMIT]
    pitch_target = min(max(reach * _stick(command[FORWARD], parameters), -limit), limit)
    roll_target = min(max(-reach * _stick(command[LEFT], parameters), -limit), limit)
    if parameters[BRAKING_LEAN] != 0.0:
        lean = parameters[BRAKING_LEAN] * command[CENTRED] / GRAVITY_M_S2
        pitch_target -= lean * (c * vx + s * vy)
        roll_target += lean * (c * vy - s * vx)
    roll_off = roll_target + parameters[TRIM_ROLL] + share * noise[ROLL_NOISE] - roll
    pitch_off = pitch_target + parameters[TRIM_PITCH] + share * noise[PITCH_NOISE] - pitch
    rate[ROLL], rate[PITCH] = roll_off / parameters[ATTITUDE_TIME], pitch_off / parameters[ATTITUDE_TIME]

    # Yaw: drag determines both the steady rate and how fast the rate decays.
    yaw_push = parameters[MAX_YAW_RATE] * command[TURN] + share * noise[TURN_NOISE]
    rate[YAW] = state[YAW_RATE]
    rate[YAW_RATE] = (yaw_push - (1.0 + parameters[YAW_DRAG]) * state[YAW_RATE]) / parameters[YAW_TIME]

    # canted_thrust, to first order in its angles.
    ahead += parameters[CANT_AHEAD]
    aside += parameters[CANT_LEFT]
    ax = GRAVITY_M_S2 * (c * ahead - s * aside)
    ay = GRAVITY_M_S2 * (s * ahead + c * aside)

    # Drag against the air.
    air_x = vx - parameters[WIND_X] - share * noise[GUST_X]
    air_y = vy - parameters[WIND_Y] - share * noise[GUST_Y]
    drag = parameters[DRAG] + parameters[QUADRATIC] * math.sqrt(air_x * air_x + air_y * air_y)
    if parameters[ASYMMETRY] != 0.0:
        speed = math.sqrt(vx * vx + vy * vy) + 1e-6
        along = (vx * (ax - drag * air_x) + vy * (ay - drag * air_y)) / speed
        drag *= 1.0 + parameters[ASYMMETRY] * 0.5 * (1.0 - math.tanh(along / DECELERATION_M_S2))
    ax -= drag * air_x + parameters[BRAKING] * command[CENTRED] * vx
    ay -= drag * air_y + parameters[BRAKING] * command[CENTRED] * vy

    # position_hold takes over once the stick is centred and the vehicle is slow.
    slow = (vx * vx + vy * vy) / parameters[HOLD_CAPTURE] ** 2
    holding = command[CENTRED] / (1.0 + slow * slow)
    moving_x, moving_y = vx + share * noise[WX], vy + share * noise[WY]
    stiffness, damping = holding * parameters[HOLD_STIFFNESS], holding * parameters[HOLD_DAMPING]
    ax -= stiffness * (state[X] - state[HOLD_X]) + damping * moving_x
    ay -= stiffness * (state[Y] - state[HOLD_Y]) + damping * moving_y
    rate[HOLD_X] = HOLD_FOLLOW_1_S * (1.0 - holding) * (state[X] - state[HOLD_X])
    rate[HOLD_Y] = HOLD_FOLLOW_1_S * (1.0 - holding) * (state[Y] - state[HOLD_Y])

    # Climb is a first-order lag; ground effect pushes up near the floor (Cheeseman and Bennett).
    climb = parameters[CLIMB_RATE] * command[UP]
    if climb < 0.0:
        climb *= 1.0 + parameters[CLIMB_ASYMMETRY]
    az = (climb - vz) / parameters[CLIMB_TIME]
    near = min((parameters[ROTOR_RADIUS] / (4.0 * max(state[Z], 1e-3))) ** 2, 0.5)
    az += GRAVITY_M_S2 * near / (1.0 - near)

    if on_floor:
        az += max(-FLOOR_STIFFNESS * height - FLOOR_DAMPING * vz, 0.0)
        ax, ay = -SLIDING_1_S * vx, -SLIDING_1_S * vy
    rate[X], rate[Y], rate[Z] = moving_x, moving_y, vz + share * noise[WZ]
    rate[VX], rate[VY], rate[VZ] = ax, ay, az


@inner_kernel
def _copy(source: Array, into: Array) -> None:
    for i in range(source.shape[0]):  # an assignment of arrays takes seconds to compile
        into[i] = source[i]


@inner_kernel
def _rk4(
    state: Array,
    command: Array,
    noise_begin: Array,
    noise_end: Array,
    parameters: Array,
    h: float,
    work: Array,
) -> None:
    """Advance ``state`` in place by h: constant command, linear noise. ``work`` is (6, STATE)."""
    k1, k2, k3, k4, at, noise = work[0], work[1], work[2], work[3], work[4], work[5, : noise_begin.shape[0]]
    n = state.shape[0]
    derivative(state, command, noise_begin, parameters, k1)
    for i in range(noise.shape[0]):
        noise[i] = 0.5 * (noise_begin[i] + noise_end[i])
    for i in range(n):
        at[i] = state[i] + 0.5 * h * k1[i]
    derivative(at, command, noise, parameters, k2)
    for i in range(n):
        at[i] = state[i] + 0.5 * h * k2[i]
    derivative(at, command, noise, parameters, k3)
    for i in range(n):
        at[i] = state[i] + h * k3[i]
    derivative(at, command, noise_end, parameters, k4)
    for i in range(n):
        state[i] += h * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]) / 6.0


@allocating_kernel
def integrate(start: Array, command: Array, noise: Array, parameters: Array, step_s: float) -> Array:
    """Return the states of all members at all nodes: (members, steps + 1, STATE).

    ``start`` is (members, STATE) and ``parameters`` (members, PARAMETERS). ``command`` (m, steps, COMMAND)
    holds the mean over each step. ``noise`` (m, steps + 1, NOISE) holds the values at the nodes. m is the
    number of members, or 1 where all share them.
    """
    members, steps = start.shape[0], command.shape[1]
    states = np.empty((members, steps + 1, start.shape[1]))
    work = np.empty((6, start.shape[1]))
    state = np.empty(start.shape[1])
    for j in range(members):
        commands = command[min(j, command.shape[0] - 1)]
        noises = noise[min(j, noise.shape[0] - 1)]
        _copy(start[j], state)
        _copy(state, states[j, 0])
        for k in range(steps):
            _rk4(state, commands[k], noises[k], noises[k + 1], parameters[j], step_s, work)
            _copy(state, states[j, k + 1])
    return states


class Moments(NamedTuple):
    """n moments of one member, between its nodes."""

    node: NDArray[np.int64]
    """(n,) node before each moment."""
    past_s: Array
    """(n,) time since that node."""
    average: Array
    """(n, COMMAND) mean of the command since the node."""
    command: Array
    """(n, COMMAND) command at the moment."""
    noise: Array
    """(n, NOISE) noise at the moment."""
    noise_rate: Array
    """(n, 3) derivative of w."""


@allocating_kernel
def read_out(states: Array, noise: Array, parameters: Array, moments: Moments) -> tuple[Array, Array, Array]:
    """Return state (n, STATE), its rate (n, STATE) and the acceleration d(v + w)/dt (n, 3) at n moments.

    ``states`` and ``noise`` hold one member's values at its nodes.
    """
    node, past_s, average, command, noise_at, noise_rate = moments
    count, width = node.shape[0], states.shape[1]
    at, rates, acceleration = np.empty((count, width)), np.empty((count, width)), np.empty((count, 3))
    work = np.empty((6, width))
    for i in range(count):
        k = node[i]
        _copy(states[k], at[i])
        if past_s[i] > 0.0:
            # A partial step, not an interpolation: this is exact even if the stick jumps between two nodes.
            _rk4(at[i], average[i], noise[k], noise_at[i], parameters, past_s[i], work)
        derivative(at[i], command[i], noise_at[i], parameters, rates[i])
        share = noise_share(at[i, Z], parameters)
        fading = rates[i, Z] / parameters[FADE] if 0.0 < share < 1.0 else 0.0
        for axis in range(3):
            w = noise_at[i, WX + axis]
            acceleration[i, axis] = rates[i, VX + axis] + share * noise_rate[i, axis] + fading * w
    return at, rates, acceleration
