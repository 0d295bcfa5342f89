"""Terms of the sonar. Symbols: z the height above the surface below, theta and phi the tilt, r the
reading."""

from __future__ import annotations

from math import radians

from slam.simulation.terms.term import Parameter, Term, signed, size

SONAR = (
    Term(
        "sonar_slant",
        "sonar",
        "sensor",
        (Parameter("c", "1", 1.0, 0.0, 1.0, -1.0, 2.0),),
        "r = z (1 + c (1 / (cos theta cos phi) - 1)): 1 is a pencil beam, 0 the first echo of a wide one",
        ("sonar_scale", "sonar_temperature"),
        "tilts of 10 to 20 deg",
    ),
    Term(
        "sonar_tilt",
        "sonar",
        "sensor",
        (signed("x", "rad", radians(5), 0.5), signed("y", "rad", radians(5), 0.5)),
        "the beam is turned about the body's x and y by these angles:"
        " to first order r += z (x tan phi + y tan theta)",
        ("floor_slope",),
        "the same track in both directions",
    ),
    Term(
        "sonar_scale",
        "sonar",
        "sensor",
        (signed("eps", "1", 0.05, 0.5),),
        "r (1 + eps)",
        ("sonar_bias", "sonar_temperature"),
        "two heights",
    ),
    Term(
        "sonar_bias",
        "sonar",
        "sensor",
        (signed("b", "m", 0.05, 1.0),),
        "r + b",
        ("sonar_scale",),
        "a touchdown; the floor's datum looks the same",
    ),
    Term(
        "sonar_temperature",
        "sonar",
        "sensor",
        (signed("rise", "K", 15.0, 60.0),),
        "r c(20) / c(T), c = 331.3 + 0.606 T, T rises from 20 degrees by this much over the flight",
        ("sonar_scale", "battery_sag"),
        "log the temperature",
    ),
    Term(
        "sonar_quantisation",
        "sonar",
        "sensor",
        (size("step", "m", 0.01, 0.05, 1.0),),
        "r is rounded to whole steps",
        (),
        "a slow climb",
    ),
    Term(
        "sonar_dead_zone",
        "sonar",
        "sensor",
        (size("limit", "m", 0.25, 0.4, 2.0),),
        "below the limit r stays at the limit",
        ("ground_effect",),
        "a slow descent",
    ),
    Term(
        "sonar_lag",
        "sonar",
        "sensor",
        (size("T", "s", 0.04, 0.15, 2.0),),
        "r(t - T)",
        ("climb_asymmetry",),
        "steps up and down",
    ),
    Term(
        "sonar_spikes",
        "sonar",
        "sensor",
        (size("share", "1", 0.001, 0.05, 0.5),),
        "this share of the readings is the second echo, near 2 r",
        ("floor_steps",),
        "fly the track again: spikes do not repeat",
    ),
)
