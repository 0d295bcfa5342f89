"""Terms of the place: deviations from a level and empty floor."""

from __future__ import annotations

from slam.simulation.terms.term import Term, signed, size

PLACE = (
    Term(
        "floor_slope",
        "place",
        "place",
        (signed("x", "1", 0.05, 0.5), signed("y", "1", 0.05, 0.5)),
        "the floor lies at x_slope x + y_slope y instead of 0",
        ("sonar_tilt",),
        "the same track in both directions",
    ),
    Term(
        "floor_steps",
        "place",
        "place",
        (size("height", "m", 0.02, 0.4, 2.0), size("share", "1", 0.05, 0.3, 0.9)),
        "boxes of this height cover this share of the floor",
        ("sonar_spikes",),
        "fly the track again: steps stay where they are",
    ),
    Term(
        "moving_objects",
        "place",
        "image",
        (size("count", "1", 1.0, 4.0, 50.0),),
        "so many discs, larger than a picture's tenth, move over the floor",
        ("specular_highlights",),
        "yaw on the spot",
    ),
)
