"""Terms of the motion: command, tilt, drag, wind, climb and yaw.

They act inside ``dynamics.derivative``, with two exceptions: ``control_latency`` (on the command before it)
and ``gusts`` (through the noise). Symbols: f, l, u, y the stick, a the
largest tilt, G the gain, k the drag, v the velocity that drag acts on, tau the attitude's time constant;
primes are time derivatives.
"""

from __future__ import annotations

from math import pi, radians

from slam.simulation.terms.term import FAST_TILTS, WORLD_AXES, Parameter, Term, signed, size

MOTION = (
    Term(
        name="control_latency",
        title="a delay of the sticks",
        meaning="the vehicle obeys the sticks late",
        family="motion",
        acts_on="command",
        parameters=(size("T", "s", 0.03, 0.25, 2.0, step=0.002, quantity="delay"),),
        equation="the vehicle follows the stick s(t - T)",
        confounders=("attitude_lag",),
        excitation=(
            "pulses of 0.3 s or less at half stick, logged at 50 Hz or more; a clock offset of the log has "
            "the same effect"
        ),
    ),
    Term(
        name="attitude_lag",
        title="a faster or slower tilt",
        meaning="the vehicle reaches the commanded tilt faster or slower",
        family="motion",
        acts_on="command",
        parameters=(
            Parameter(
                name="tau",
                quantity="time in which the tilt follows",
                unit="s",
                neutral=0.10,
                low=0.05,
                high=0.3,
                least=0.01,
                most=2.0,
                slot="vehicle.attitude_time_s",
            ),
        ),
        equation="theta' = (target - theta) / tau; tau is the whole time constant",
        confounders=("control_latency",),
        excitation=FAST_TILTS,
    ),
    Term(
        name="active_braking",
        title="braking by itself",
        meaning="it brakes by itself when the stick is released",
        family="motion",
        acts_on="force",
        parameters=(
            size("k_b", "1/s", 0.2, 2.0, 20.0, step=0.01, alone=True, quantity="rate of braking"),
            size(
                "lean",
                "1/s",
                0.2,
                2.0,
                20.0,
                step=0.01,
                alone=True,
                quantity="rate of braking by leaning back",
            ),
        ),
        equation=(
            "while forward and left are both 0: with k_b, v' -= k_b v; with lean, the vehicle leans against "
            "its velocity: the commanded tilt minus lean v / g"
        ),
        confounders=("asymmetric_drag",),
        excitation=(
            "stick ahead from 0.25 of full to 0, to 0.10 and to -0.15, 1.5 s each: active braking acts only "
            "while the stick is at 0"
        ),
    ),
    Term(
        name="asymmetric_drag",
        title="more drag when slowing down",
        meaning="it slows down harder than it speeds up",
        family="motion",
        acts_on="force",
        parameters=(size("alpha", "1", 0.1, 1.0, 10.0, step=0.01, quantity="additional drag"),),
        equation="k (1 + alpha) while the vehicle slows down: v . v' < 0",
        confounders=("active_braking",),
        excitation="stick ahead from 0.25 of full to 0.10, and from 0.25 to -0.15, 1.5 s each",
    ),
    Term(
        name="quadratic_drag",
        title="drag with the square of the speed",
        meaning="the air's drag grows with the square of the speed",
        family="motion",
        acts_on="force",
        parameters=(
            size("c", "1/m", 0.02, 0.3, 5.0, step=0.005, quantity="drag over the square of the speed"),
        ),
        equation="v' -= c |v| v",
        confounders=("active_braking", "command_nonlinearity"),
        excitation="steady flight at three or more speeds, in both directions",
    ),
    Term(
        name="command_nonlinearity",
        title="an uneven answer to the stick",
        meaning="tilt does not grow in proportion to the stick",
        family="motion",
        acts_on="command",
        parameters=(
            signed("eps", "1", 1.0, 10.0, step=0.02, quantity="cubic part"),
            size("dead_band", "1", 0.005, 0.03, 0.5, step=0.001, quantity="dead band of the stick"),
        ),
        equation="forward and left become s + eps s^3 beyond a dead band",
        confounders=("quadratic_drag", "tilt_limit"),
        excitation="steady flight at three or more stick positions: here the tilt changes too",
    ),
    Term(
        name="tilt_limit",
        title="a limit of the tilt",
        meaning="it never tilts beyond a limit, however far the stick is pushed",
        family="motion",
        acts_on="command",
        parameters=(
            Parameter(
                name="limit",
                quantity="greatest tilt",
                unit="rad",
                neutral=pi / 2,
                low=radians(5),
                high=radians(25),
                least=radians(0.5),
                most=pi / 2,
            ),
        ),
        equation="the commanded tilt is clipped at +-limit, roll and pitch each",
        confounders=("command_nonlinearity",),
        excitation="two stick values above the limit",
    ),
    Term(
        name="battery_sag",
        title="weaker sticks on a low battery",
        meaning="it answers the sticks less and less as the battery runs down",
        family="motion",
        acts_on="command",
        parameters=(
            size("loss", "1", 0.02, 0.2, 0.9, step=0.01, quantity="loss of the sticks' effect at the end"),
        ),
        equation="G (1 - loss d), d from 0 to 1 with the charge drawn over the flight",
        confounders=("clock_drift", "sonar_temperature"),
        excitation="the same pulses early and late, with the voltage logged",
    ),
    Term(
        name="trim_offset",
        title="a tilt with centred sticks",
        meaning="it tilts when the sticks are centred, whatever its heading",
        family="motion",
        acts_on="command",
        parameters=(
            signed("roll", "rad", radians(3), 0.5, step=0.001, quantity="roll"),
            signed("pitch", "rad", radians(3), 0.5, step=0.001, quantity="pitch"),
        ),
        equation="added to the commanded tilt, in body axes",
        confounders=("steady_wind", "canted_thrust", "accel_bias"),
        excitation="rotation by 180 deg; at one heading it has the same effect as wind",
    ),
    Term(
        name="canted_thrust",
        title="rotors that push aside",
        meaning="its rotors push aside while it flies level, whatever its heading",
        family="motion",
        acts_on="force",
        parameters=(
            signed("ahead", "rad", radians(3), 0.5, step=0.001, quantity="cant ahead"),
            signed("left", "rad", radians(3), 0.5, step=0.001, quantity="cant to the left"),
        ),
        equation="v' += g (ahead, left) in the heading frame: the thrust is not along the body's z",
        confounders=("steady_wind", "trim_offset", "accel_bias"),
        excitation=(
            "rotation by 180 deg; at one heading it has the same effect as wind, and without a measured "
            "attitude the same as a trim"
        ),
    ),
    Term(
        name="steady_wind",
        title="a steady wind",
        meaning="a steady wind carries it",
        family="motion",
        acts_on="wind",
        parameters=(
            signed("x", "m/s", 1.0, 20.0, step=0.02, quantity=WORLD_AXES["x"]),
            signed("y", "m/s", 1.0, 20.0, step=0.02, quantity=WORLD_AXES["y"]),
        ),
        equation="drag acts on v - wind, world axes",
        confounders=("trim_offset", "canted_thrust"),
        excitation="rotation by 180 deg",
    ),
    Term(
        name="gusts",
        title="gusts",
        meaning="the wind comes in gusts",
        family="motion",
        acts_on="wind",
        parameters=(
            size("sigma", "m/s", 0.05, 0.5, 10.0, quantity="speed of the gusts"),
            Parameter(
                name="tau",
                unit="s",
                neutral=1.0,
                low=0.5,
                high=5.0,
                least=0.05,
                most=60.0,
                quantity="duration of a gust",
            ),
        ),
        equation="wind as an Ornstein-Uhlenbeck process in x and y: a change of covariance, not of the mean",
        confounders=(),
        excitation="a long hover",
    ),
    Term(
        name="ground_effect",
        title="lift near the floor",
        meaning="near the floor its own downwash lifts it",
        family="motion",
        acts_on="force",
        parameters=(
            size("radius", "m", 0.05, 0.4, 1.0, step=0.01, squared=True, quantity="radius of the rotors"),
        ),
        equation="vz' += g (T/T0 - 1), T/T0 = 1 / (1 - (radius / 4 z)^2)",
        confounders=("sonar_dead_zone", "sonar_bias"),
        excitation="a slow descent, with the accelerometer",
    ),
    Term(
        name="climb_asymmetry",
        title="unequal climb and descent",
        meaning="it descends and climbs at different rates for the same stick",
        family="motion",
        acts_on="force",
        parameters=(signed("eps", "1", 0.5, 0.95, step=0.01, quantity="difference of the descent"),),
        equation="down stick commands (1 + eps) of the climb rate",
        confounders=("sonar_lag",),
        excitation="steps up and down",
    ),
    Term(
        name="yaw_drag",
        title="a wrong rate of turn",
        meaning="it turns faster or slower than the stick commands",
        family="motion",
        acts_on="force",
        parameters=(signed("eps", "1", 0.3, 0.95, step=0.01, quantity="error of the rate of turn"),),
        equation="r' = (r_max y - (1 + eps) r) / tau_r",
        confounders=("gyro_scale",),
        excitation="yaw steps, with the heading from the camera",
    ),
    Term(
        name="position_hold",
        title="holding its place",
        meaning="it holds its place when the stick is released",
        family="motion",
        acts_on="force",
        parameters=(
            size("stiffness", "1/s^2", 0.5, 40.0, 400.0, quantity="stiffness"),
            size("damping", "1/s", 0.5, 20.0, 40.0, quantity="damping"),
            Parameter(
                name="capture_speed",
                unit="m/s",
                neutral=0.3,
                low=0.1,
                high=0.5,
                least=0.01,
                most=5.0,
                quantity="speed below which it holds",
            ),
        ),
        equation=(
            "v' -= h (stiffness (p - p_hold) + damping (v + w)), h = 1 / (1 + (|v| / "
            "capture_speed)^4) while forward and left are 0, else h = 0; p_hold follows p as 1 - h"
        ),
        confounders=("active_braking",),
        excitation="a hover of half a minute",
    ),
)
