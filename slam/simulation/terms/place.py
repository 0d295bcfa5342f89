"""Terms of the place: deviations from a level and empty floor."""

from __future__ import annotations

from slam.simulation.terms.term import WORLD_AXES, Term, signed, size

PLACE = (
    Term(
        name="floor_slope",
        title="a sloping floor",
        meaning="the floor slopes",
        family="place",
        acts_on="place",
        parameters=(
            signed("x", "1", 0.05, 0.5, step=0.001, quantity=WORLD_AXES["x"]),
            signed("y", "1", 0.05, 0.5, step=0.001, quantity=WORLD_AXES["y"]),
        ),
        equation="the floor lies at x_slope x + y_slope y instead of 0",
        confounders=("sonar_tilt",),
        excitation="the same track in both directions",
        stream="sonar",
    ),
    Term(
        name="floor_steps",
        title="steps in the floor",
        meaning="there are steps in the floor",
        family="place",
        acts_on="place",
        parameters=(
            size("height", "m", 0.02, 0.4, 2.0, quantity="height of the steps"),
            size("share", "1", 0.05, 0.3, 0.9, quantity="share of the floor"),
        ),
        equation="boxes of this height cover this share of the floor",
        confounders=("sonar_spikes",),
        excitation="a second flight over the track: steps stay at their places",
        in_single_readings=True,
    ),
    Term(
        name="moving_objects",
        title="things that move on the floor",
        meaning="things move over the floor",
        family="place",
        acts_on="image",
        parameters=(size("count", "1", 1.0, 4.0, 50.0, quantity="number"),),
        equation="this number of discs, larger than a tenth of a picture, move over the floor",
        confounders=("specular_highlights",),
        excitation="yaw on the spot",
        in_single_readings=True,
    ),
)
