"""The catalogue: all terms of a model, by their canonical names.

The simulator and criticism share these objects: one simulates the terms, the other selects and fits them.
"""

from __future__ import annotations

from slam.simulation.terms.camera import CAMERA
from slam.simulation.terms.imu import IMU
from slam.simulation.terms.motion import MOTION
from slam.simulation.terms.place import PLACE
from slam.simulation.terms.sonar import SONAR
from slam.simulation.terms.term import Parameter, Term
from slam.simulation.terms.timing import TIMING

__all__ = ["CATALOGUE", "Parameter", "Term"]

CATALOGUE: dict[str, Term] = {term.name: term for term in (*MOTION, *CAMERA, *SONAR, *IMU, *TIMING, *PLACE)}
