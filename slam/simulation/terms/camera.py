"""Terms of the camera: lens, mount, shutter and automatic exposure.

Symbols: f the focal length in px, h the height above the floor, r the distance from the image centre over
half the image's diagonal, omega the body rate.
"""

from __future__ import annotations

from math import radians

from slam.simulation.terms.term import Parameter, Term, signed, size

CAMERA = (
    Term(
        name="focal_length",
        family="camera",
        acts_on="image",
        parameters=(signed("eps", "1", 0.03, 0.5),),
        equation="the focal length is (1 + eps) times that of sensor.yaml",
        confounders=("flow_scale", "sonar_scale"),
        excitation=(
            "rotations (px = f omega), or a target of known size; translation alone cannot distinguish it "
            "from the height"
        ),
    ),
    Term(
        name="radial_distortion",
        family="camera",
        acts_on="image",
        parameters=(signed("k1", "1", 0.3, 0.6),),
        equation="x -> x (1 + k1 |x|^2), x in units of the focal length",
        confounders=("focal_length",),
        excitation="features at the centre and at the edge",
    ),
    Term(
        name="camera_tilt",
        family="camera",
        acts_on="image",
        parameters=(signed("x", "rad", radians(5), 0.5), signed("y", "rad", radians(5), 0.5)),
        equation="the camera is rotated about the body's x and y by these angles against its T_BS",
        confounders=("trim_offset",),
        excitation="climbs, and yaw on the spot",
    ),
    Term(
        name="camera_time_offset",
        family="camera",
        acts_on="clock",
        parameters=(signed("offset", "s", 0.08, 2.0),),
        equation="a picture stamped t was taken at t - offset",
        confounders=("clock_drift", "rolling_shutter"),
        excitation="fast tilts, over some minutes",
    ),
    Term(
        name="rolling_shutter",
        family="camera",
        acts_on="image",
        parameters=(size("readout", "s", 0.01, 0.05, 0.2),),
        equation="row i of n is exposed readout i / (n - 1) after the stamp",
        confounders=("camera_time_offset",),
        excitation="fast tilts and yaw: the offset grows with the row",
    ),
    Term(
        name="motion_blur",
        family="camera",
        acts_on="image",
        parameters=(size("exposure", "s", 0.002, 0.03, 0.2),),
        equation="the picture is the mean over the exposure time: a blur of f v exposure / h px",
        confounders=("exposure_variation",),
        excitation="the same speed at two light levels",
    ),
    Term(
        name="exposure_variation",
        family="camera",
        acts_on="image",
        parameters=(
            size("gain", "1", 0.02, 0.2, 1.0),
            size("gamma", "1", 0.05, 0.4, 1.0),
            Parameter(name="tau", unit="s", neutral=0.5, low=0.2, high=2.0, least=0.0, most=60.0),
        ),
        equation=(
            "I' = g_c I^gamma: log g of each colour and log gamma are Ornstein-Uhlenbeck processes of these"
            " standard deviations and this correlation time; with 0 they are independent between pictures"
        ),
        confounders=("motion_blur", "specular_highlights"),
        excitation="the same speed at two light levels",
    ),
    Term(
        name="vignetting",
        family="camera",
        acts_on="image",
        parameters=(size("a", "1", 0.05, 0.5, 1.0),),
        equation="I' = I (1 - a r^2)",
        confounders=(),
        excitation="yaw and translation: shading of the floor moves with the floor",
    ),
    Term(
        name="specular_highlights",
        family="camera",
        acts_on="image",
        parameters=(size("strength", "1", 0.1, 1.0, 5.0),),
        equation=(
            "a bright spot in the mirror direction of a lamp overhead, strength times white at its centre"
        ),
        confounders=("moving_objects", "exposure_variation"),
        excitation="yaw on the spot",
    ),
    Term(
        name="dropped_frames",
        family="camera",
        acts_on="image",
        parameters=(size("share", "1", 0.005, 0.1, 0.9),),
        equation="each picture is lost with this probability",
        confounders=("timestamp_jitter",),
        excitation="any flight: displacements are integer multiples",
    ),
    Term(
        name="flow_derotation",
        family="camera",
        acts_on="sensor",
        parameters=(signed("kappa", "1", 0.1, 1.0),),
        equation="the flow speed contains a share of the rotation: v_x += kappa q h, v_y -= kappa p h",
        confounders=("camera_time_offset",),
        excitation="fast tilts at two heights",
    ),
)
