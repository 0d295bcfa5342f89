"""Terms of the motion: command, tilt, drag, wind, climb and yaw.

They act inside ``dynamics.derivative``, with three exceptions: ``control_latency`` (on the command before
it), ``gusts`` (through the noise) and ``flow_scale`` (on an instrument). Symbols: f, l, u, y the stick, a the
largest tilt, G the gain, k the drag, v the velocity that drag acts on, tau the attitude's time constant;
primes are time derivatives.
"""

from __future__ import annotations

from math import pi, radians

from slam.simulation.terms.term import Parameter, Term, signed, size

MOTION = (
    Term(
        "control_latency",
        "motion",
        "command",
        (size("T", "s", 0.03, 0.25, 2.0),),
        "the vehicle obeys s(t - T)",
        ("attitude_lag",),
        "pulses of 0.3 s and less, logged at 50 Hz and more; a clock offset of the log looks the same",
    ),
    Term(
        "attitude_lag",
        "motion",
        "command",
        (Parameter("tau", "s", 0.10, 0.05, 0.3, 0.01, 2.0, slot="vehicle.attitude_time_s"),),
        "theta' = (target - theta) / tau; tau is the whole time constant",
        ("control_latency",),
        "pulses of 0.3 s and less",
    ),
    Term(
        "active_braking",
        "motion",
        "force",
        (size("k_b", "1/s", 0.2, 2.0, 20.0), size("lean", "1/s", 0.2, 2.0, 20.0)),
        "while forward and left are both 0: v' -= k_b v; or the vehicle leans against its speed, the tilt"
        " asked for less lean v / g",
        ("asymmetric_drag",),
        "steps from 0.25 to 0.10 and from 0.25 to -0.15: slowing down with the stick out",
    ),
    Term(
        "asymmetric_drag",
        "motion",
        "force",
        (size("alpha", "1", 0.1, 1.0, 10.0),),
        "k (1 + alpha) while the vehicle slows down: v . v' < 0",
        ("active_braking",),
        "steps from 0.25 to 0.10 and from 0.25 to -0.15",
    ),
    Term(
        "quadratic_drag",
        "motion",
        "force",
        (size("c", "1/m", 0.02, 0.3, 5.0),),
        "v' -= c |v| v",
        ("active_braking", "command_nonlinearity"),
        "steady flight at three speeds and more, in both directions",
    ),
    Term(
        "command_nonlinearity",
        "motion",
        "command",
        (signed("eps", "1", 1.0, 10.0), size("dead_band", "1", 0.005, 0.03, 0.5)),
        "forward and left become s + eps s^3 beyond a dead band",
        ("quadratic_drag", "tilt_limit"),
        "steady flight at three sticks and more: here the tilt changes too",
    ),
    Term(
        "tilt_limit",
        "motion",
        "command",
        (Parameter("limit", "rad", pi / 2, radians(5), radians(25), radians(0.5), pi / 2),),
        "the tilt asked for is cut at +-limit, roll and pitch each",
        ("command_nonlinearity",),
        "two stick values above the limit",
    ),
    Term(
        "flow_scale",
        "motion",
        "sensor",
        (signed("eps", "1", 0.25, 0.9),),
        "the on-board flow speed reads (1 + eps) v",
        ("focal_length", "quadratic_drag"),
        "a reference for the place, or the camera's own metric motion",
    ),
    Term(
        "battery_sag",
        "motion",
        "command",
        (size("loss", "1", 0.02, 0.2, 0.9),),
        "G (1 - loss d), d from 0 to 1 with the charge drawn over the flight",
        ("clock_drift", "sonar_temperature"),
        "the same pulses early and late, with the voltage logged",
    ),
    Term(
        "trim_offset",
        "motion",
        "command",
        (signed("roll", "rad", radians(3), 0.5), signed("pitch", "rad", radians(3), 0.5)),
        "added to the tilt asked for, in body axes",
        ("steady_wind", "accel_bias"),
        "turn by 180 deg; at one heading it looks like wind",
    ),
    Term(
        "steady_wind",
        "motion",
        "wind",
        (signed("x", "m/s", 1.0, 20.0), signed("y", "m/s", 1.0, 20.0)),
        "drag acts on v - wind, world axes",
        ("trim_offset",),
        "turn by 180 deg",
    ),
    Term(
        "gusts",
        "motion",
        "wind",
        (size("sigma", "m/s", 0.05, 0.5, 10.0), Parameter("tau", "s", 1.0, 0.5, 5.0, 0.05, 60.0)),
        "wind as an Ornstein-Uhlenbeck process in x and y: a change of covariance, not of the mean",
        (),
        "a long hover",
    ),
    Term(
        "ground_effect",
        "motion",
        "force",
        (size("radius", "m", 0.05, 0.4, 1.0),),
        "vz' += g (T/T0 - 1), T/T0 = 1 / (1 - (radius / 4 z)^2)",
        ("sonar_dead_zone", "sonar_bias"),
        "a slow descent, with the accelerometer",
    ),
    Term(
        "climb_asymmetry",
        "motion",
        "force",
        (signed("eps", "1", 0.5, 0.95),),
        "down stick asks for (1 + eps) of the climb rate",
        ("sonar_lag",),
        "steps up and down",
    ),
    Term(
        "yaw_drag",
        "motion",
        "force",
        (signed("eps", "1", 0.3, 0.95),),
        "r' = (r_max y - (1 + eps) r) / tau_r",
        ("gyro_scale",),
        "yaw steps, with the heading from the camera",
    ),
    Term(
        "position_hold",
        "motion",
        "force",
        (
            size("stiffness", "1/s^2", 0.5, 40.0, 400.0),
            size("damping", "1/s", 0.5, 20.0, 40.0),
            Parameter("capture_speed", "m/s", 0.3, 0.1, 0.5, 0.01, 5.0),
        ),
        "v' -= h (stiffness (p - p_hold) + damping (v + w)), h = 1 / (1 + (|v| / capture_speed)^4) while"
        " forward and left are 0, else h = 0; p_hold follows p as 1 - h",
        ("active_braking",),
        "a hover of half a minute",
    ),
)
