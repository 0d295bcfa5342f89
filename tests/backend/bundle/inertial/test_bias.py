"""The prior on the IMU's bias counts once, however often readings are lost."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X as POSE

from backend.bundle.factors import MOUNT, WORLD, WORLD_SIZE
from backend.bundle.frame_poses import FramePoses
from backend.bundle.homography_factor import ImagePlane
from backend.bundle.inertial.factor import gain_effect
from backend.bundle.inertial.graph import NOMINAL_INERTIAL_NOISE, InertialPart, add_inertial
from backend.bundle.path_nodes import PathNodes
from backend.bundle.pose_side_factors import PoseSideFactors
from backend.bundle.world import WorldTransform
from backend.measurements import GRAVITY_M_S2, Inertial, InertialNoise, InertialReadings
from backend.preintegration.intervals import NO_BIAS, chains, preintegrate
from tests.backend.made_floor import NADIR

STEP_S = 0.2
NODES_S = np.arange(0.1, 6.0, STEP_S)
NOISE = InertialNoise(gyro_density=1e-4, accel_density=1e-3)


def hovered(lost_s: tuple[float, ...], jump_m_s2: float = 0.0) -> tuple[InertialPart, gtsam.Values, float]:
    """The part of a level hover, the optimum, and what that tells of the mount's roll as a deviation.

    Readings within 0.03 s of each of ``lost_s`` are lost; the bias jumps at the first one.
    """
    t = np.arange(0.0, 6.2, 0.01)
    force = np.tile([0.0, 0.0, GRAVITY_M_S2], (len(t), 1))
    if jump_m_s2:
        force[t > lost_s[0], 0] += jump_m_s2
    kept = np.all([abs(t - at_s) > 0.03 for at_s in lost_s], axis=0) & np.ones(len(t), bool)
    inertial = Inertial(InertialReadings(t[kept], np.zeros((kept.sum(), 3)), force[kept]), NOISE)
    keys = tuple(POSE(k) for k in range(len(NODES_S)))
    frames = FramePoses((), ImagePlane(np.array([300.0, 300.0]), np.array([160.0, 120.0])))
    path = PathNodes(keys, NODES_S, frames)
    still = gain_effect(np.eye(3), np.zeros((2, 3)), np.zeros((2, 3)), STEP_S)
    part = InertialPart(inertial, path, preintegrate(inertial, NODES_S), NO_BIAS, 0.0, {})
    part = replace(part, by_gain={one.i: still for one in part.intervals})
    above = NADIR.copy()
    above[2, 3] = 1.0
    graph, values, world = gtsam.NonlinearFactorGraph(), gtsam.Values(), np.zeros(WORLD_SIZE)
    for key in keys:
        values.insert(key, gtsam.Pose3(above))
        model = gtsam.noiseModel.Isotropic.Sigma(6, 1e-4)
        graph.push_back(gtsam.PriorFactorPose3(key, gtsam.Pose3(above), model))
    values.insert(WORLD, world)
    sigmas = np.full(WORLD_SIZE, 1e-5)
    sigmas[MOUNT] = 0.2
    graph.push_back(gtsam.PriorFactorVector(WORLD, world, gtsam.noiseModel.Diagonal.Sigmas(sigmas)))
    start = part.start(values, WorldTransform(world, NADIR))
    readings = PoseSideFactors()
    add_inertial(readings, part, start, NADIR, NOMINAL_INERTIAL_NOISE)
    graph.push_back(readings.graph)
    found = gtsam.LevenbergMarquardtOptimizer(graph, start).optimize()
    covariance = gtsam.Marginals(graph, found).marginalCovariance(WORLD)
    return part, found, float(np.sqrt(covariance[MOUNT, MOUNT][0, 0]))


def test_lost_readings_make_a_constant_bias_no_better_known():
    whole, broken = hovered(()), hovered((1.15, 2.15, 3.15, 4.15))
    assert len(list(chains(broken[0].intervals))) == 5
    assert whole[2] == pytest.approx(NOISE.accel_offset_m_s2 / GRAVITY_M_S2, rel=0.05)
    assert broken[2] == pytest.approx(whole[2], rel=0.02)


def test_a_bias_may_jump_where_readings_are_lost():
    part, found, _ = hovered((3.15,), 0.2)
    biases = part.biases(found)[:, 0]
    assert biases[-1] - biases[0] == pytest.approx(0.2, abs=0.01)
