"""Hills, roofs and trees against solids as half spaces, and against rays that are marched in small steps."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from frontend.camera import Camera
from slam.core.errors import InputError
from slam.simulation.camera.optics import expose
from slam.simulation.place.ground import Hill
from slam.simulation.place.obstacles import BASE, Box, Pylon, Tree, top
from slam.simulation.place.scene import build_scene
from slam.simulation.place.terrain import elevation, first_echo
from slam.simulation.place.world import World, check_world

HILL = Hill((2.2, 1.2), 0.5, 0.3)
RELIEF = World(
    "plain", (0.0, 0.0, 3.0, 3.0), 0.6, 0.004,
    boxes=(Box((1.0, 1.2), (0.5, 0.3, 0.2), 25.0, roof_m=0.15), Box((2.1, 1.1), (0.3, 0.3, 0.25))),
    pylons=(Pylon((1.5, 2.1), 0.1, 0.3),), trees=(Tree((1.6, 1.4), 0.2, 0.4), Tree((2.4, 1.5), 0.15, 0.3)),
    hills=(HILL,), slope=(0.05, -0.02),
)  # fmt: skip


def below_half_spaces(obstacle, base, w_p):
    """Whether points lie in a roofed box or cone, as an intersection of half spaces."""
    x, y, z = (w_p - [*obstacle.center_m, base]).T
    if isinstance(obstacle, Tree):
        turns = np.linspace(0, 2 * np.pi, 720)
        out = x[:, None] * np.cos(turns) + y[:, None] * np.sin(turns)
        return (out + obstacle.radius_m / obstacle.height_m * z[:, None] <= obstacle.radius_m).all(1)
    turn = np.radians(obstacle.heading_deg)
    along, across = np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x
    length, width, height = obstacle.size_m
    eaves = (np.abs(across) * obstacle.roof_m / (width / 2) + z - height) <= obstacle.roof_m
    return (np.abs(along) <= length / 2) & (np.abs(across) <= width / 2) & eaves


@pytest.mark.parametrize("obstacle", [RELIEF.boxes[0], RELIEF.trees[0]])
def test_roofs_and_trees_end_where_their_half_spaces_end(obstacle):
    one = {"boxes": (obstacle,)} if isinstance(obstacle, Box) else {"trees": (obstacle,)}
    world = World("plain", RELIEF.extent_m, 0.6, 0.004, **one)
    rng = np.random.default_rng(0)
    w_p = rng.uniform([0.6, 0.8, 0.0], [2.0, 1.8, 0.5], (5000, 3))
    inside = below_half_spaces(obstacle, 0.0, w_p)
    assert 0.02 < inside.mean() < 0.5
    assert np.mean((elevation(world, *w_p[:, :2].T) >= w_p[:, 2]) != inside) < 2e-3
    # A ray straight down meets the same surface, a slanted one ends on it.
    above = np.column_stack([w_p[:, :2], np.full(5000, 2.0)])
    down = first_echo(world, above, np.tile([0.0, 0.0, -1.0], (5000, 1)))
    assert np.allclose(2.0 - down, elevation(world, *w_p[:, :2].T), atol=1e-9)


def test_slanted_rays_end_on_the_surface():
    """In a world without upright walls a ray ends where the surface has its height."""
    world = replace(RELIEF, boxes=(), pylons=())
    rng = np.random.default_rng(1)
    origin = np.column_stack([*rng.uniform(0.8, 2.4, (2, 3000)), rng.uniform(1.0, 1.5, 3000)])
    axis = np.column_stack([rng.normal(0, 0.4, (3000, 2)), np.full(3000, -1.0)])
    reach = first_echo(world, origin, axis)
    end = origin + reach[:, None] * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    assert np.allclose(end[:, 2], elevation(world, *end[:, :2].T), atol=1e-4)


def test_a_picture_shows_what_marched_rays_meet():
    scene = build_scene(RELIEF, ())
    texels = scene.textures.texels.copy()
    for k, faces in enumerate(scene.textures.levels):
        for first, height, width in faces.reshape(-1, 3):
            texels[first : first + height * width] = (20 + 30 * k, 255, 0)
    scene = replace(scene, textures=replace(scene.textures, texels=texels))
    camera = Camera((300.0, 300.0), (159.5, 119.5), (320, 240))
    w_T_b = np.eye(4)
    w_T_b[:3, :3] = Rotation.from_euler("ZYX", [30, 6, -5], degrees=True).as_matrix()
    w_T_b[:3, 3] = 1.6, 1.4, 1.3
    picture, w_T_c = expose(scene, camera, w_T_b), w_T_b @ camera.b_T_c
    pixel = np.random.default_rng(2).integers(3, [317, 237], (400, 2))
    reached = w_T_c[:3, 3] + np.linspace(0, 1.6, 2000)[:, None, None] * (camera.rays(pixel) @ w_T_c[:3, :3].T)
    first = (reached[..., 2] <= elevation(RELIEF, reached[..., 0], reached[..., 1])).argmax(axis=0)
    end = reached[first, np.arange(400)]
    tops = np.array([top(prism, end[:, 0], end[:, 1]) for prism in scene.fixed_prisms])
    ground = RELIEF.ground.height(end[:, 0], end[:, 1])
    base = scene.fixed_prisms[:, BASE, None]
    met = np.vstack([(tops >= end[:, 2] - 1e-3) & (base <= end[:, 2] + 1e-3), ground >= end[:, 2] - 1e-3])
    patch = [picture[v - 1 : v + 2, u - 1 : u + 2].reshape(9, 3) for u, v in pixel]
    inner = np.array([np.ptp(p, axis=0).max() <= 1 for p in patch])
    green = np.array([p[4, 1] == 255 for p in patch])
    shown = np.where(green, np.rint((np.array([p[4, 0] for p in patch]) - 20.0) / 30), -1)
    assert met[shown.astype(int), np.arange(400)][inner].mean() > 0.99
    assert len(set(shown[inner])) >= 5


def test_the_floor_is_painted_on_the_hill():
    """A mark on a hill is seen where the camera projects its place on the ground."""
    world = replace(RELIEF, boxes=(), pylons=(), trees=(), mark_diameter_m=0.1)
    at = (2.0, 1.4)
    camera = Camera((400.0, 400.0), (199.5, 199.5), (400, 400))
    w_T_b = np.eye(4)
    w_T_b[:3, 3] = 1.5, 1.5, 1.6
    with_mark, without = (
        expose(build_scene(world, marks), camera, w_T_b).astype(float) for marks in ((("A", *at),), ())
    )
    changed = np.abs(with_mark - without).sum(axis=2)
    v, u = np.unravel_index(np.arange(changed.size), changed.shape)
    seen = np.array([np.average(u, weights=changed.ravel()), np.average(v, weights=changed.ravel())])
    w_p = np.array([*at, float(world.ground.height(*at))])
    c_p = (np.linalg.inv(w_T_b @ camera.b_T_c) @ np.append(w_p, 1.0))[:3]
    assert np.abs(camera.project(c_p[None])[0] - seen).max() < 2.0
    off_m = np.abs(camera.project((c_p + [0, 0, w_p[2]])[None])[0] - seen).max()
    assert off_m > 10.0  # the hill moves it by this much


def test_a_hill_too_steep_to_be_seen_whole_is_refused():
    with pytest.raises(InputError, match=r"world\.hills\[0\].*make it lower or wider"):
        check_world(replace(RELIEF, hills=(Hill((1.0, 1.0), 0.1, 0.5),)))
