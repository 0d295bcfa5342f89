"""Terms of the camera: lens, mount, shutter and automatic exposure.

Symbols: f the focal length in px, h the height above the floor, r the distance from the image centre over
half the image's diagonal, omega the body rate.
"""

from __future__ import annotations

from math import radians

from slam.simulation.terms.term import Parameter, Term, signed, size

CAMERA = (
    Term(
        "focal_length",
        "camera",
        "image",
        (signed("eps", "1", 0.03, 0.5),),
        "the lens has (1 + eps) times the focal length that its sensor.yaml names",
        ("flow_scale", "sonar_scale"),
        "turns (px = f omega), or a target of known size; translation alone cannot tell it from the height",
    ),
    Term(
        "radial_distortion",
        "camera",
        "image",
        (signed("k1", "1", 0.3, 0.6),),
        "x -> x (1 + k1 |x|^2), x in units of the focal length",
        ("focal_length",),
        "features at the centre and at the edge",
    ),
    Term(
        "camera_tilt",
        "camera",
        "image",
        (signed("x", "rad", radians(5), 0.5), signed("y", "rad", radians(5), 0.5)),
        "the camera is turned about the body's x and y by these angles against its T_BS",
        ("trim_offset",),
        "climbs, and yaw on the spot",
    ),
    Term(
        "camera_time_offset",
        "camera",
        "clock",
        (signed("offset", "s", 0.08, 2.0),),
        "a picture stamped t shows what was at t - offset",
        ("clock_drift", "rolling_shutter"),
        "brisk tilts, over some minutes",
    ),
    Term(
        "rolling_shutter",
        "camera",
        "image",
        (size("readout", "s", 0.01, 0.05, 0.2),),
        "row i of n is exposed readout i / (n - 1) after the stamp",
        ("camera_time_offset",),
        "brisk tilts and yaw: the offset grows with the row",
    ),
    Term(
        "motion_blur",
        "camera",
        "image",
        (size("exposure", "s", 0.002, 0.03, 0.2),),
        "the picture is the mean over the exposure: a smear of f v exposure / h px",
        ("exposure_variation",),
        "the same speed in two lights",
    ),
    Term(
        "exposure_variation",
        "camera",
        "image",
        (
            size("gain", "1", 0.02, 0.2, 1.0),
            size("gamma", "1", 0.05, 0.4, 1.0),
            Parameter("tau", "s", 0.5, 0.2, 2.0, 0.0, 60.0),
        ),
        "I' = g_c I^gamma: log g of each colour and log gamma wander as Ornstein-Uhlenbeck processes of these"
        " standard deviations and this correlation time, 0 for each picture anew",
        ("motion_blur", "specular_highlights"),
        "the same speed in two lights",
    ),
    Term(
        "vignetting",
        "camera",
        "image",
        (size("a", "1", 0.05, 0.5, 1.0),),
        "I' = I (1 - a r^2)",
        (),
        "yaw and translation: shading of the floor stays with the floor",
    ),
    Term(
        "specular_highlights",
        "camera",
        "image",
        (size("strength", "1", 0.1, 1.0, 5.0),),
        "a spot of light in the mirror direction of a lamp overhead, strength times white at its centre",
        ("moving_objects", "exposure_variation"),
        "yaw on the spot",
    ),
    Term(
        "dropped_frames",
        "camera",
        "image",
        (size("share", "1", 0.005, 0.1, 0.9),),
        "each picture is lost with this probability",
        ("timestamp_jitter",),
        "any flight: displacements are whole multiples",
    ),
    Term(
        "flow_derotation",
        "camera",
        "sensor",
        (signed("kappa", "1", 0.1, 1.0),),
        "the flow speed keeps a share of the turning: v_x += kappa q h, v_y -= kappa p h",
        ("camera_time_offset",),
        "brisk tilts at two heights",
    ),
)
