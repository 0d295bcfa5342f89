"""Obstacles against a slow ray caster of our own: solids as intersections of half spaces."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam.core.errors import InputError
from slam.simulation.camera.optics import CameraModel, expose
from slam.simulation.place.obstacles import Box, Pylon, steps
from slam.simulation.place.scene import build_scene
from slam.simulation.place.terrain import elevation, first_echo
from slam.simulation.place.textures import METRES_PER_TEXEL, draw_textures
from slam.simulation.place.world import World, check_world, with_place_terms
from slam.simulation.recipe import recipe_from

FLAT = World("plain", (0.0, 0.0, 3.0, 3.0), 0.6, 0.004)
OBSTACLES = (
    Box((1.30, 1.45), (0.30, 0.20, 0.35), 25.0),
    Box((1.75, 1.50), (0.25, 0.25, 0.28)),
    Box((1.52, 1.20), (0.30, 0.12, 0.22), -70.0),
)
PYLONS = (Pylon((1.50, 1.80), 0.07, 0.5), Pylon((1.10, 1.75), 0.05, 1.4))
GYM = replace(FLAT, boxes=OBSTACLES, pylons=PYLONS)


def pose(x, y, z, roll_deg, pitch_deg, yaw_deg):
    w_T_b = np.eye(4)
    w_T_b[:3, :3] = Rotation.from_euler("ZYX", np.radians([yaw_deg, pitch_deg, roll_deg])).as_matrix()
    w_T_b[:3, 3] = x, y, z
    return w_T_b


def half_spaces(obstacle, slope=(0.0, 0.0)):
    """Outward normals (n, 3) and offsets: inside is normal . p <= offset. The first is the top."""
    x, y = obstacle.center_m
    base = slope[0] * x + slope[1] * y
    if isinstance(obstacle, Box):
        length, width, height = obstacle.size_m
        turns = np.radians(obstacle.heading_deg) + np.pi / 2 * np.arange(4)
        reach = np.array([length, width, length, width]) / 2
    else:
        height = obstacle.height_m
        turns = 2 * np.pi * np.arange(2000) / 2000
        reach = np.full(2000, obstacle.radius_m)
    sides = np.column_stack([np.cos(turns), np.sin(turns), 0 * turns])
    normal = np.vstack([[0, 0, 1], sides])
    return normal, np.concatenate([[base + height], reach + sides[:, :2] @ (x, y)])


def cast(obstacle, origin, ray, slope=(0.0, 0.0)):
    """Distance in lengths of the ray to where it enters (inf if not), and the number of the half space."""
    normal, offset = half_spaces(obstacle, slope)
    toward = normal @ ray
    apart = offset - normal @ origin
    at = apart / np.where(np.abs(toward) < 1e-15, 1e-15, toward)
    enter = np.where(toward < 0, at, -np.inf)
    leave = np.where(toward > 0, at, np.inf)
    s = enter.max()
    outside = ((toward == 0) & (apart < 0)).any()
    return (s, int(enter.argmax())) if 0 < s < leave.min() and not outside else (np.inf, -1)


def floor_at(origin, ray, slope):
    normal = np.array([-slope[0], -slope[1], 1.0])
    s = -(normal @ origin) / (normal @ ray)
    return s if s > 0 else np.inf


def colours(count):
    """Top and side of each obstacle in a colour of its own, far from the plain floor's grey."""
    return np.array(
        [[(20 + 35 * k, 250 * (face == 0), 200 - 30 * k) for face in (0, 1)] for k in range(count)]
    )


def plainly_painted(scene):
    """The scene with one colour a face."""
    texels = scene.textures.texels.copy()
    for k, faces in enumerate(scene.textures.levels):
        for face, levels in enumerate(faces):
            for first, height, width in levels:
                texels[first : first + height * width] = colours(len(scene.fixed_prisms))[k, face]
    return replace(scene, textures=replace(scene.textures, texels=texels))


def label(world, origin, ray):
    """(-1, -1) for the floor, else obstacle and face: 0 top, 1 side."""
    nearest, found = floor_at(origin, ray, world.slope), (-1, -1)
    for k, obstacle in enumerate((*world.boxes, *world.pylons)):
        s, plane = cast(obstacle, origin, ray, world.slope)
        if s < nearest:
            nearest, found = s, (k, int(plane > 0))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.2, -0.1)])
@pytest.mark.parametrize("distortion", [(0.0, 0.0, 0.0, 0.0), (-0.15, 0.05, 0.01, -0.01)])
@pytest.mark.parametrize("height_m", [0.7, 1.2])
def test_each_pixel_shows_what_its_rays_meet_first(height_m, distortion, slope):
    world = replace(GYM, slope=slope)
    scene = plainly_painted(build_scene(world, ()))
    camera = CameraModel(distortion=distortion).camera()
    w_T_b = pose(1.45, 1.5, height_m + 1.5 * sum(slope), 5, -7, 35)
    picture = expose(scene, camera, w_T_b)
    rng = np.random.default_rng(0)
    pixels = np.column_stack([rng.integers(0, 176, 500), rng.integers(0, 144, 500)])
    # The four samples of a pixel, and a margin about them: all see the same where no edge runs through it.
    around = np.array([(du, dv) for du in (-0.45, 0, 0.45) for dv in (-0.45, 0, 0.45)])
    w_T_c = w_T_b @ camera.b_T_c
    checked = set()
    for pixel in pixels:
        rays = camera.rays(camera.undistort(pixel + around)) @ w_T_c[:3, :3].T
        labels = {label(world, w_T_c[:3, 3], ray) for ray in rays}
        if len(labels) > 1:
            continue
        (k, face), shown = labels.pop(), picture[pixel[1], pixel[0]]
        checked.add((k, face))
        # The shadow on the floor is of no interest here.
        assert (shown == colours(5)[k, face]).all() if k >= 0 else len({*shown.tolist()}) == 1
    assert len(checked) >= 7


@pytest.mark.parametrize("k", [3, *(pytest.param(k, marks=pytest.mark.slow) for k in (0, 1, 2, 4))])
def test_a_skin_lies_on_its_obstacle_like_paper(k):
    """Grey levels that grow along the skin come out where the oracle's ray meets it."""
    obstacle = (*OBSTACLES, *PYLONS)[k]
    world = replace(FLAT, boxes=(obstacle,) if k < 3 else (), pylons=(obstacle,) if k >= 3 else ())
    scene = build_scene(world, ())
    textures, texels = scene.textures, scene.textures.texels.copy()
    for levels in textures.levels[0]:
        for first, height, width in levels:
            x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
            texels[first : first + height * width] = np.stack([250 * x, 250 * y, 0 * x], -1).reshape(-1, 3)
    scene = replace(scene, textures=replace(textures, texels=texels))
    camera = CameraModel((1056, 864), 90.0).camera()
    x, y = obstacle.center_m
    checked = []
    for turn in range(0, 360, 60):
        away = 0.24 * np.array([np.cos(np.radians(turn)), np.sin(np.radians(turn))])
        w_T_b = pose(x + away[0], y + away[1], 0.75, 0, 0, turn)
        picture = expose(scene, camera, w_T_b).astype(float)
        w_T_c = w_T_b @ camera.b_T_c
        for u, v in np.random.default_rng(turn).integers((8, 8), (1048, 856), (500, 2)):
            ray = w_T_c[:3, :3] @ camera.rays(np.array([[u, v]]))[0]
            s, plane = cast(obstacle, w_T_c[:3, 3], ray)
            # Across an edge of the face or the seam of the skin the grey levels jump.
            underground = s >= floor_at(w_T_c[:3, 3], ray, (0.0, 0.0))
            if underground or np.ptp(picture[v - 1 : v + 2, u - 1 : u + 2], axis=(0, 1)).max() > 40:
                continue
            expected = 250 * np.array(place_on_skin(obstacle, plane, w_T_c[:3, 3] + s * ray))
            assert picture[v, u, :2] == pytest.approx(expected, abs=6)
            checked.append(plane > 0)
    # The tall pylon's top is above the camera.
    assert sum(checked) > 10
    assert len(checked) - sum(checked) > 10 or k == 4


def place_on_skin(obstacle, plane, w_p):
    """Shares from the left and from the upper border of the top's or the side's picture."""
    turn = np.radians(obstacle.heading_deg) if isinstance(obstacle, Box) else 0.0
    x, y = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]]) @ (
        w_p[:2] - obstacle.center_m
    )
    if isinstance(obstacle, Pylon):
        height, r = obstacle.height_m, obstacle.radius_m
        if plane == 0:
            return (x + r) / (2 * r), (r - y) / (2 * r)
        return np.arctan2(y, x) / (2 * np.pi) % 1, 1 - w_p[2] / height
    length, width, height = obstacle.size_m
    if plane == 0:
        return (x + length / 2) / length, (width / 2 - y) / width
    # Counter-clockwise: front, left, rear, right.
    way = [y + width / 2, width + length / 2 - x, width + length + width / 2 - y]
    way.append(2 * width + length + x + length / 2)
    return way[plane - 1] / (2 * (length + width)), 1 - w_p[2] / height


def test_skins_are_as_fine_as_they_say_and_differ():
    scene = build_scene(GYM, ())
    _, height, width = scene.textures.levels[0, 0, 0]
    assert (width, height) == (round(0.30 / METRES_PER_TEXEL), round(0.20 / METRES_PER_TEXEL))
    again, other = (
        draw_textures(scene.fixed_prisms, GYM.seed),
        draw_textures(scene.fixed_prisms, GYM.seed + 1),
    )
    assert np.array_equal(scene.textures.texels, again.texels)
    assert not np.array_equal(scene.textures.texels, other.texels)
    # Rich enough that features are found on it.
    first, height, width = scene.textures.levels[0, 0, 0]
    top = scene.textures.texels[first : first + height * width].reshape(height, width, 3)
    assert len(cv2.SIFT_create().detect(cv2.cvtColor(top, cv2.COLOR_BGR2GRAY), None)) > 15


def test_parallax_is_that_of_the_height():
    """A box's top corner moves f dx / (z - h) px between two pictures, the floor f dx / z."""
    world = replace(FLAT, boxes=(Box((1.5, 1.5), (0.4, 0.3, 0.3)),))
    scene = plainly_painted(build_scene(world, ()))
    camera = CameraModel((640, 480)).camera()
    edges = []
    for x in (1.40, 1.52):
        picture = expose(scene, camera, pose(x, 1.5, 1.0, 0, 0, 0))
        top = (picture == colours(1)[0, 0]).all(2)
        edges.append(np.flatnonzero(top[:, 320]).mean())
    assert edges[1] - edges[0] == pytest.approx(camera.focal_px[0] * 0.12 / 0.7, abs=0.6)


def test_elevation_is_what_falls_straight_down():
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0.9, 2.0, (2, 4000))
    heights = elevation(GYM, x, y)
    above = np.column_stack([x, y, np.full(4000, 5.0)])
    dropped = np.array(
        [min(cast(o, p, np.array([0, 0, -1.0]))[0] for o in (*OBSTACLES, *PYLONS)) for p in above]
    )
    assert np.mean((heights > 0) != (dropped < np.inf)) < 1e-3
    heights = np.where(dropped < np.inf, heights, 0.0)
    assert np.allclose(heights[dropped < np.inf], 5.0 - dropped[dropped < np.inf], atol=1e-9)
    assert 0.05 < (heights > 0).mean() < 0.5
    assert elevation(GYM, np.zeros((3, 4)), np.zeros((3, 4))).shape == (3, 4)
    # A beam of no width is that fall.
    echo = first_echo(GYM, above, np.tile([0, 0, -2.0], (4000, 1)))
    assert np.allclose(5.0 - echo, heights, atol=1e-9)


@pytest.mark.parametrize("share", [0.05, 0.3, 0.8])
def test_steps_cover_their_share_and_leave_the_marks_free(share):
    marks = (("A", 0.4, 0.4), ("B", 2.6, 1.1))
    terms = {"floor_steps": {"height": 0.1, "share": share}, "floor_slope": {"x": 0.03, "y": -0.01}}
    world = with_place_terms(FLAT, marks, terms)
    check_world(world)
    assert world.slope == (0.03, -0.01)
    assert all(box.size_m[2] == 0.1 for box in world.boxes)
    grid = np.linspace(0.005, 2.995, 300)
    x, y = np.meshgrid(grid, grid)
    covered = elevation(replace(world, slope=(0.0, 0.0)), x, y) > 0
    assert covered.mean() == pytest.approx(share, abs=0.02)
    for _, mx, my in marks:
        assert not covered[np.hypot(x - mx, y - my) < 0.06].any()
    assert with_place_terms(FLAT, marks, terms) == world
    assert with_place_terms(FLAT, marks, {}) == FLAT
    assert len(steps((0, 0, 30, 30), 0.1, 0.5, (), np.random.default_rng(0))) <= 200


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (
            {"boxes": (Box((5.0, 1.0), (0.2, 0.2, 0.2)),)},
            r"world\.boxes\[0\] at \(5, 1\) reaches off the floor",
        ),
        ({"boxes": (OBSTACLES[0], Box((0.1, 1.0), (0.3, 0.2, 0.2)))}, r"world\.boxes\[1\]"),
        ({"pylons": (Pylon((2.95, 1.0), 0.1, 1.0),)}, r"world\.pylons\[0\] .* off the floor"),
        ({"pylons": (Pylon((1.0, 1.0), 0.0, 1.0),)}, r"world\.pylons\[0\]: sizes \[0\.0, 1\.0\]"),
        ({"boxes": (Box((1.0, 1.0), (0.2, -0.2, 0.2)),)}, "must be above 0"),
        ({"boxes": (Box((float("nan"), 1.0), (0.2, 0.2, 0.2)),)}, "off the floor"),
        ({"boxes": (Box((1.0, 1.0), (0.2, float("inf"), 0.2)),)}, "must be above 0"),
    ],
)
def test_an_obstacle_that_cannot_stand_is_refused_in_one_line(changed, said):
    with pytest.raises(InputError, match=said) as caught:
        check_world(replace(FLAT, **changed))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("world", "said"),
    [
        ({"boxes": [{"center_m": [1, 1], "size_m": [0.2, 0, 0.2]}]}, r"world\.boxes.*greater than 0"),
        ({"boxes": [{"center_m": [1, 1]}]}, r"world\.boxes.*size_m"),
        ({"pylons": [{"center_m": [1, 1], "radius_m": 0.1, "height": 1}]}, "height_m"),
        ({"pylons": [{"center_m": [9, 1], "radius_m": 0.1, "height_m": 1}]}, "off the floor"),
        ({"slope": [0.9, 0]}, "slope"),
        ({"texture": "no_such.jpg"}, "no such file"),
    ],
)
def test_a_recipe_with_a_place_that_cannot_be_is_refused_in_one_line(world, said):
    recipe = {"name": "r", "maneuver": {"way_points": [[1.0, 1.0]]}, "world": world}
    with pytest.raises(InputError, match=said) as caught:
        recipe_from(recipe, "r.toml")
    assert "\n" not in str(caught.value)
