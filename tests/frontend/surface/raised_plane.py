"""Pictures of a plane above the floor that the map assumes, and a box on a floor."""

import numpy as np

from frontend.camera import Camera
from frontend.mosaic.pictures import Pictures
from frontend.mosaic.plan import plan_mosaic
from frontend.mosaic.surface import HeightSource, Surface
from frontend.surface.misregistration import (
    measure_misregistration,
)
from tests.frontend.mosaic.scene import photograph, pose, smooth_floor

HEIGHT_M = 0.2
"""True height of the ground over the floor that the map assumes."""
GSD_M = 0.00625
CAMERA = Camera((320.0, 320.0), (159.5, 119.5), (320, 240), (-0.05, 0.02, 0.001, -0.001))
POSES = np.array([pose(0.3 * (k % 3) - 0.3, 0.35 * (k // 3), 2.0, 0.1 * k, 0.02, -0.03) for k in range(6)])


def photographs():
    """Return the picture of each pose."""
    return [photograph(smooth_floor(0, 640, 0.006, 1.0), CAMERA, w_T_b, oversample=1) for w_T_b in POSES]


def measured(pictures, poses, floor_z_m, surface=None):
    plan = plan_mosaic(CAMERA, poses, floor_z_m, GSD_M, surface=surface)
    return plan, measure_misregistration(plan, Pictures(plan, pictures.__getitem__))


def boxed(height_m=0.5):
    heights = np.zeros((60, 60), np.float32)
    heights[20:35, 25:40] = height_m
    source = np.where(heights > 0, HeightSource.PICTURES, HeightSource.FLOOR).astype(np.uint8)
    return Surface(-0.6, 0.6, 0.02, heights, np.zeros_like(heights), source)
