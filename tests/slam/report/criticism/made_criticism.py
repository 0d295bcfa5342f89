"""A criticism made by hand, for each kind of verdict."""

from __future__ import annotations

from dataclasses import replace

from slam.criticism.cause import Cause, ChannelError, Gain, Interval
from slam.criticism.finding import ResidualPattern
from slam.criticism.verdict.criticism import ChannelCheck, Criticism, Rank
from slam.simulation.model import load_model

RANKING = (
    Rank("quadratic_drag", 0.97, 9.1),
    Rank("flow_scale", 0.02, 4.0),
    *(Rank(f"other_{k}", 0.0, 1.0) for k in range(20)),
    Rank("nothing", 0.0, 0.0),
    Rank("unknown", 0.01, 0.0),
)

REMAINDER = "named_with_remainder"


def made(verdict: str = "named") -> Criticism:
    gain = Gain(
        12.5,
        (4.0, 21.0),
        "flight",
        (8.0, -1.5, 6.0),
        (ChannelError("velocity_x", "m/s", 2.0, 0.31, 0.12), ChannelError("yaw", "rad", 2.0, 0.01, 0.011)),
    )
    cause = Cause("quadratic_drag", 0.97, {"c": Interval(0.08, "1/m", 0.07, 0.09)}, gain, 9.1, 20.0)
    return Criticism(
        verdict,  # type: ignore[arg-type]
        "The model lacks <quadratic> drag.",
        (cause,) if verdict.startswith("named") else (),
        ("quadratic_drag", "flow_scale") if verdict == "ambiguous" else (),
        (ResidualPattern.of("gyro_x ~ speed", 7.0),) if "remainder" in verdict else (),
        next_flight="steps of three sizes",
        noise=("Noise from reading to reading is larger than stated: gyro 29 times.",)
        if "remainder" in verdict
        else (),
        detectable={"sonar_lag": (0.012, "s")},
        ranking=RANKING,
        confusable=(("quadratic_drag", "flow_scale", 0.93),),
        nuisances={"vehicle.gain": Interval(0.96, "1", 0.95, 0.97)},
        noise_correlation={"accel": 0.437},
        checks=(ChannelCheck("gyro_x", 1000, 1.02, 0.01, (0.1,) * 10),),
        threshold=3.7,
        threshold_means="what chance <seldom> reaches",
        model=load_model("nominal"),
        extended=load_model("nominal").with_term("quadratic_drag", c=0.08),
        flights=("flight_00", "flight_01"),
        dropped=("flight_09: never moves",),
    )


def cause_that_may_be_none() -> Cause:
    """Return a cause whose interval holds no effect."""
    return replace(made().causes[0], name="gyro_scale", parameters={"eps": Interval(0.005, "1", -0.01, 0.02)})
