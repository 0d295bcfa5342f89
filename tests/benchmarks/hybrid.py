"""Real motion and sensors of an AR.Drone 2 over a photographed floor, compared with motion capture."""

from __future__ import annotations

from dataclasses import replace

from slam.core.instrument_errors import AccelerometerErrors
from slam.evaluation import evaluate
from slam.inertial.navigate import navigate
from slam.io.flight_folder import read_flight
from slam.mapping.pipeline import optimize
from tests.benchmarks.measured import folder
from tests.benchmarks.metric import Metric, at_most, reported, within


def measure() -> list[Metric]:
    """Return position errors and consistency."""
    flight = read_flight(folder("flights/ardrone2-hybrid"))
    estimate = optimize(flight)
    run, found = evaluate(estimate, flight), estimate.instruments.accelerometer
    assert run.nees is not None
    assert found is not None
    pose = run.nees.pose
    pairs = {
        "camera and sonar": optimize(replace(flight, imu=None)),
        "camera and IMU": optimize(replace(flight, sonar=None)),
        "IMU and sonar": navigate(replace(flight, camera=None, frames=None, velocity=None)).estimate,
    }
    error_m = {name: evaluate(pair, flight).ate_m.rmse for name, pair in pairs.items()}
    return [
        at_most("position error after similarity (ate_sim3_m)", run.ate_sim3_m.rmse, "m", 0.02),
        at_most(
            "position error (ate_m)",
            run.ate_m.rmse,
            "m",
            0.05,
            "first keyframe's position and yaw aligned; its height sensor reads 3 to 5 % short",
        ),
        *(reported(f"the same from {name} alone", error, "m") for name, error in error_m.items()),
        at_most(
            "the same over the best of any two",
            run.ate_m.rmse / min(error_m.values()),
            "x",
            1.0,
            "one draw of two gains; over many: instruments together, simulated flights",
        ),
        reported(
            "accelerometer's offset upwards, estimated",
            found.offset_m_s2[2],
            "m/s^2",
            "-0.7 by its readings at rest",
        ),
        reported(
            "accelerometer's position on the body, upwards, estimated",
            1e3 * found.arm_m[2],
            "mm",
            _aside(found),
        ),
        reported("scale of the similarity", run.scale, ""),
        within("mean NEES of poses", pose.mean, "", (pose.lower95, pose.upper95), "95 % band; 6 expected"),
    ]


def _aside(found: AccelerometerErrors) -> str:
    return f"{1e3 * found.arm_m[0]:.0f} mm forward, {1e3 * found.arm_m[1]:.0f} mm left of the body's origin"
