"""A real AR.Drone 2's motion and sensors over a photographed floor, against motion capture."""

from __future__ import annotations

from slam.evaluation import evaluate
from slam.io.flight_folder import read_flight
from slam.pipeline import optimize
from tests.benchmarks.measured import folder
from tests.benchmarks.metric import Metric, at_most, told, within


def measure() -> list[Metric]:
    """Position errors and consistency."""
    flight = read_flight(folder("flights/ardrone2-hybrid"))
    run = evaluate(optimize(flight), flight)
    assert run.nees is not None
    pose = run.nees.pose
    return [
        at_most("position error after similarity (ate_sim3_m)", run.ate_sim3_m.rmse, "m", 0.02),
        at_most(
            "position error (ate_m)",
            run.ate_m.rmse,
            "m",
            0.12,
            "first keyframe's position and yaw aligned; its height sensor reads 3 to 5 % short",
        ),
        told("scale that the similarity takes out", run.scale, ""),
        within("mean NEES of poses", pose.mean, "", (pose.lower95, pose.upper95), "95 % band; 6 expected"),
    ]
