"""Pictures over a raised surface: what a box hides, and where the lens projects raised ground."""

from dataclasses import replace

import numpy as np

from frontend.camera import Camera
from frontend.mosaic.view import Lattice, MosaicView, mosaic_view, raised_maps
from tests.frontend.mosaic.scene import FLOOR_Z_M, pose
from tests.frontend.surface.raised_plane import CAMERA, POSES, boxed


def test_ground_behind_a_box_is_hidden():
    """Against rays in small steps; cells within two of the outline of the shadow may differ."""
    surface, camera = boxed(), Camera((300.0, 300.0), (149.5, 149.5), (300, 300))
    view = mosaic_view(camera, 0, pose(-0.7, -0.9, 1.5) - FLOOR_Z_M * np.eye(4)[:, 2:3] @ np.eye(4)[3:], 0.0)
    assert isinstance(view, MosaicView)
    lattice = Lattice(-0.59, 0.59, 0.02, 60, 60)
    hidden = surface.hidden(view, lattice)
    x, y = np.meshgrid(-0.59 + 0.02 * np.arange(60), 0.59 - 0.02 * np.arange(60))
    ground = np.stack([x, y, surface.height_m], axis=-1)
    camera_at = np.array([*view.w_p_c_m[:2], view.height_m])
    true = np.zeros_like(hidden)
    for share in np.linspace(0.001, 0.6, 600):
        at = ground + share * (camera_at - ground)
        c, r = (
            np.floor((at[..., 0] + 0.6) / 0.02).astype(int),
            np.floor((0.6 - at[..., 1]) / 0.02).astype(int),
        )
        on = (r >= 0) & (r < 60) & (c >= 0) & (c < 60)
        true[on] |= surface.height_m[r[on], c[on]] > at[..., 2][on] + 0.01
    assert 0.03 < true.mean() < 0.2
    assert np.mean(hidden != true) < 0.02
    assert not replace(surface, height_m=0 * surface.height_m).hidden(view, lattice).any()


def test_raised_ground_is_seen_where_the_lens_projects_it():
    view = mosaic_view(CAMERA, 0, POSES[3], FLOOR_Z_M)
    assert isinstance(view, MosaicView)
    lattice = Lattice(-0.4, 0.4, 0.02, 40, 40)
    heights = np.random.default_rng(1).uniform(0, 0.5, (40, 40)).astype(np.float32)
    u, v = raised_maps(CAMERA, view, lattice, heights)
    x, y = np.meshgrid(-0.4 + 0.02 * np.arange(40), 0.4 - 0.02 * np.arange(40))
    w_p = np.stack([x, y, heights + FLOOR_Z_M, np.ones_like(x)], axis=-1).reshape(-1, 4)
    c_p = w_p @ np.linalg.inv(POSES[3] @ CAMERA.b_T_c).T
    pixel = CAMERA.project(c_p[:, :3])
    inside = ((pixel > 0) & (pixel < np.array(CAMERA.size_px) - 1)).all(axis=1)
    assert inside.sum() > 500
    assert np.abs(np.column_stack([u.ravel(), v.ravel()]) - pixel)[inside].max() < 0.03
