"""Terms of the sonar. Symbols: z the height above the surface below, theta and phi the tilt, r the
reading."""

from __future__ import annotations

from math import radians

from slam.simulation.terms.term import Parameter, Term, signed, size

SONAR = (
    Term(
        name="sonar_slant",
        family="sonar",
        acts_on="sensor",
        parameters=(Parameter(name="c", unit="1", neutral=1.0, low=0.0, high=1.0, least=-1.0, most=2.0),),
        equation=(
            "r = z (1 + c (1 / (cos theta cos phi) - 1)): 1 is a pencil beam, 0 the first echo of a wide one"
        ),
        confounders=("sonar_scale", "sonar_temperature"),
        excitation="tilts of 10 to 20 deg",
    ),
    Term(
        name="sonar_tilt",
        family="sonar",
        acts_on="sensor",
        parameters=(signed("x", "rad", radians(5), 0.5), signed("y", "rad", radians(5), 0.5)),
        equation=(
            "the beam is rotated about the body's x and y by these angles: to first order r += z (x tan phi"
            " + y tan theta)"
        ),
        confounders=("floor_slope",),
        excitation="the same track in both directions",
    ),
    Term(
        name="sonar_scale",
        family="sonar",
        acts_on="sensor",
        parameters=(signed("eps", "1", 0.05, 0.5),),
        equation="r (1 + eps)",
        confounders=("sonar_bias", "sonar_temperature"),
        excitation="two heights",
    ),
    Term(
        name="sonar_bias",
        family="sonar",
        acts_on="sensor",
        parameters=(signed("b", "m", 0.05, 1.0),),
        equation="r + b",
        confounders=("sonar_scale",),
        excitation="a touchdown; the floor's datum has the same effect",
    ),
    Term(
        name="sonar_temperature",
        family="sonar",
        acts_on="sensor",
        parameters=(signed("rise", "K", 15.0, 60.0),),
        equation=(
            "r c(20) / c(T), c = 331.3 + 0.606 T, T rises from 20 degrees Celsius by this much over the "
            "flight"
        ),
        confounders=("sonar_scale", "battery_sag"),
        excitation="a flight with the temperature logged",
    ),
    Term(
        name="sonar_quantisation",
        family="sonar",
        acts_on="sensor",
        parameters=(size("step", "m", 0.01, 0.05, 1.0),),
        equation="r is rounded to multiples of the step",
        confounders=(),
        excitation="a slow climb",
    ),
    Term(
        name="sonar_dead_zone",
        family="sonar",
        acts_on="sensor",
        parameters=(size("limit", "m", 0.25, 0.4, 2.0),),
        equation="below the limit r stays at the limit",
        confounders=("ground_effect",),
        excitation="a slow descent",
    ),
    Term(
        name="sonar_lag",
        family="sonar",
        acts_on="sensor",
        parameters=(size("T", "s", 0.04, 0.15, 2.0),),
        equation="r(t - T)",
        confounders=("climb_asymmetry",),
        excitation="steps up and down",
    ),
    Term(
        name="sonar_spikes",
        family="sonar",
        acts_on="sensor",
        parameters=(size("share", "1", 0.001, 0.05, 0.5),),
        equation="this share of the readings is the second echo, near 2 r",
        confounders=("floor_steps",),
        excitation="a second flight over the track: spikes do not repeat",
    ),
)
