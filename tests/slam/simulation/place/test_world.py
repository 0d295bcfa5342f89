from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image as Photograph

from slam.core.errors import InputError
from slam.simulation.place.puzzle import puzzle_tile
from slam.simulation.place.world import World, build_floor, check_world

SMALL = World(extent_m=(0.0, 0.0, 1.6, 1.2), margin_m=0.2, metres_per_px=0.004, tile_m=0.4)


def texel(floor, x, y, level=0):
    u, v, _ = floor.texel_H_world(level) @ [x, y, 1]
    return floor.levels[level][round(v), round(u), :3]


def test_a_floor_is_the_same_for_the_same_world_and_another_for_another_seed():
    one = build_floor(SMALL, ())
    build_floor.cache_clear()
    again, other = build_floor(SMALL, ()), build_floor(replace(SMALL, seed=1), ())
    assert np.array_equal(one.levels[0], again.levels[0])
    assert not np.array_equal(one.levels[0], other.levels[0])


def test_the_texture_covers_extent_and_margin():
    floor = build_floor(SMALL, ())
    height, width, channels = floor.levels[0].shape
    assert channels == 4, "OpenCV takes twice the time for three"
    assert floor.corner_m == pytest.approx((-0.2, 1.4))
    assert (width - 16) * 0.004 < 2.0 <= width * 0.004 + 1e-9
    assert (height - 16) * 0.004 < 1.6 <= height * 0.004 + 1e-9


def test_each_mip_level_shows_the_same_place():
    floor = build_floor(replace(SMALL, texture="plain"), (("A", 0.7, 0.5),))
    for level, image in enumerate(floor.levels):
        share = np.abs(image[..., 0].astype(float) - 128)
        rows, cols = np.indices(share.shape)
        weight = share / share.sum()
        found = np.array([(cols * weight).sum(), (rows * weight).sum(), 1])
        world = np.linalg.inv(floor.texel_H_world(level)) @ found
        assert np.hypot(world[0] - 0.7, world[1] - 0.5) < 0.004


def inside_tile(floor, world, row, col):
    n = round(world.tile_m / world.metres_per_px)
    u, v, _ = floor.texel_H_world(0) @ [world.extent_m[0], world.extent_m[3], 1]
    u, v = round(u + 0.5), round(v + 0.5)
    return floor.levels[0][v + row * n : v + (row + 1) * n, u + col * n : u + (col + 1) * n].astype(float)


def test_a_repeated_floor_is_the_same_tile_everywhere_but_for_the_marks():
    world = replace(SMALL, repeat=True)
    floor = build_floor(world, ())
    first = inside_tile(floor, world, 0, 0)
    for row, col in ((0, 1), (1, 2), (2, 3)):
        assert np.array_equal(first, inside_tile(floor, world, row, col))
    marked = build_floor(world, (("A", 0.6, 1.0),))
    assert not np.array_equal(inside_tile(marked, world, 0, 1), inside_tile(floor, world, 0, 1))
    assert np.array_equal(inside_tile(marked, world, 2, 3), inside_tile(floor, world, 2, 3))


def test_the_default_floor_repeats_its_puzzle_but_not_its_wear():
    world = replace(SMALL, extent_m=(0.0, 0.0, 3.2, 1.6), tile_m=1.6)
    floor = build_floor(world, ())
    a, b = inside_tile(floor, world, 0, 0), inside_tile(floor, world, 0, 1)
    assert np.corrcoef(a.ravel(), b.ravel())[0, 1] > 0.5
    fine = [tile - cv2.GaussianBlur(tile, (0, 0), 3) for tile in (a, b)]
    assert not np.array_equal(a, b)
    assert np.abs(a - b).mean() > 8
    assert np.corrcoef(fine[0].ravel(), fine[1].ravel())[0, 1] < 0.8


def test_a_puzzle_tile_wraps_around():
    """Across the seam pixels differ no more than across a line inside the tile."""
    tile = puzzle_tile(400, np.random.default_rng(0)).astype(float)

    def step(a, b):
        return np.abs(a - b).mean()

    # Pieces end at multiples of 50 px: the border is one of these lines, like any other.
    lines = [step(tile[:, c - 1], tile[:, c]) for c in range(50, 400, 50)]
    assert step(tile[:, -1], tile[:, 0]) < 1.5 * max(lines)
    assert step(tile[-1], tile[0]) < 1.5 * max(step(tile[r - 1], tile[r]) for r in range(50, 400, 50))
    # A knob reaches through the border: the row of pixels beside it is not one colour a piece.
    assert step(np.roll(tile, 200, 1)[:, 199], np.roll(tile, 200, 1)[:, 200]) > 0


def test_a_floor_of_lines_looks_the_same_all_along_a_line_between_two_cross_lines():
    world = World("lines", (0.0, 0.0, 8.0, 4.0), 0.5, 0.005)
    floor = build_floor(world, ()).levels[0].astype(int)
    changes = np.flatnonzero((np.diff(floor, axis=1) != 0).any(axis=(0, 2)))
    assert 4 <= len(changes) <= 10  # two edges of each cross line, 2.4 to 4.2 m apart, over 9 m
    rows = np.flatnonzero((np.diff(floor, axis=0) != 0).any(axis=(1, 2)))
    assert 6 <= len(rows) <= 18


def test_a_blank_piece_of_floor_has_no_texture_and_the_rest_is_as_before():
    before, after = (
        build_floor(replace(SMALL, blanks_m=blanks), ()) for blanks in ((), ((0.4, -1, 0.8, 5),))
    )
    inside = (texel(after, x, y) for x in (0.41, 0.6, 0.79) for y in (-0.15, 0.5, 1.35))
    assert all((colour == 128).all() for colour in inside)
    for x in (0.39, 0.81):
        assert np.array_equal(texel(before, x, 0.5), texel(after, x, 0.5))
    with pytest.raises(InputError, match=r"blanks_m\[0\].*is empty"):
        check_world(replace(SMALL, blanks_m=((0.8, 0, 0.4, 1),)))


@pytest.mark.parametrize("texture", ["puzzle", "gym"])
def test_features_are_found_all_over_the_floor(texture):
    floor = build_floor(replace(SMALL, texture=texture, metres_per_px=0.002), ())
    grey = cv2.cvtColor(floor.levels[1], cv2.COLOR_BGR2GRAY)
    points = np.array([p.pt for p in cv2.SIFT_create().detect(grey, None)])
    height, width = grey.shape
    counts, *_ = np.histogram2d(points[:, 1], points[:, 0], bins=(6, 8), range=((0, height), (0, width)))
    # Each cell is 0.27 m x 0.25 m: a picture from 0.8 m shows a dozen of them.
    assert counts.min() >= 10


def test_a_photograph_lies_at_the_lower_left_corner_and_is_mirrored_beyond(tmp_path):
    photo = np.random.default_rng(0).integers(0, 255, (120, 150, 3), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "floor.png"), photo)
    world = World(str(tmp_path / "floor.png"), (0.0, 0.0, 3.2, 3.2), 0.0, 0.01)
    floor = build_floor(world, ())
    assert np.array_equal(floor.levels[0][-120:, :150, :3], photo)
    assert np.array_equal(texel(floor, 0.005, 0.005), photo[-1, 0])
    assert np.array_equal(texel(floor, 1.505, 0.005), photo[-1, 149])
    assert np.array_equal(texel(floor, 1.705, 0.005), photo[-1, 129])
    assert np.array_equal(texel(floor, 0.005, 1.215), photo[1, 0])


@pytest.mark.parametrize(
    ("world", "said"),
    [
        (World(extent_m=(0, 0, 0, 1)), "empty"),
        (World(extent_m=(0, 0, float("nan"), 1)), "empty"),
        (World(extent_m=(0, 0, 1e6, 1e6)), "too large"),
        (World(extent_m=(0, 0, 1e300, 1)), "too large"),
        (World(extent_m=(-1e308, 0, 1e308, 1)), "too large"),
        (World(tile_m=50, metres_per_px=0.0005, extent_m=(0, 0, 1, 1)), "too large"),
        (World("missing.jpg"), "no such file"),
        (World("."), "no such file"),
    ],
)
def test_a_floor_that_cannot_be_is_refused_in_one_line(world, said):
    with pytest.raises(InputError, match=said) as caught:
        check_world(world)
    assert "\n" not in str(caught.value)


def test_a_texture_that_is_no_picture_or_a_bomb_is_refused(tmp_path):
    (tmp_path / "text.jpg").write_text("no picture")
    with pytest.raises(InputError, match="not a picture"):
        check_world(World(str(tmp_path / "text.jpg")))
    Photograph.new("1", (12_000, 12_000)).save(tmp_path / "bomb.png")
    with pytest.raises(InputError, match=r"more than 64000000 px"):
        check_world(World(str(tmp_path / "bomb.png")))


def test_a_damaged_photograph_is_refused_in_one_line(tmp_path):
    photo = np.random.default_rng(0).integers(0, 255, (64, 64, 3), dtype=np.uint8)
    whole = cv2.imencode(".png", photo)[1].tobytes()
    (tmp_path / "half.png").write_bytes(whole[: len(whole) // 2])
    world = World(str(tmp_path / "half.png"), (0.0, 0.0, 1.0, 1.0), 0.0, 0.01)
    check_world(world)
    with pytest.raises(InputError, match=r"half\.png"):
        build_floor(world, ())
