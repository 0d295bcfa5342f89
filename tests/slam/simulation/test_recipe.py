import re
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from slam import simulate
from slam.cli.demo import DEMO_RECIPE
from slam.core.errors import InputError
from slam.simulation import model as models
from slam.simulation import recipe as recipes
from slam.simulation.recipe import load_recipe, recipe_from, shipped_recipes
from slam.simulation.terms import CATALOGUE

RECIPES_PAGE = Path(__file__).parents[3] / "docs" / "recipes.md"
MINIMAL = {"name": "m", "maneuver": {"way_points": [[0, 0], [1, 0]]}}


def refused(mapping, folder=Path()):
    with pytest.raises(InputError) as caught:
        recipe_from(mapping, "flight.toml", folder)
    message = str(caught.value)
    assert message.startswith("flight.toml: ")
    assert "\n" not in message
    return message


def merged(**tables):
    return {**MINIMAL, **tables}


@pytest.mark.parametrize("name", ["figure_eight", "square"])
def test_shipped_recipes_are_found_by_name(name):
    assert name in shipped_recipes()
    assert load_recipe(name).name == name
    assert load_recipe(Path(recipes.shipped_folder()) / f"{name}.toml") == load_recipe(name)


def test_the_installed_place_comes_before_the_checkout(tmp_path, monkeypatch):
    installed = tmp_path / "slam"
    (installed / "datasets").mkdir(parents=True)
    monkeypatch.setattr(models.resources, "files", lambda package: tmp_path / package)
    assert recipes.shipped_folder() == installed / "datasets"
    (installed / "datasets").rmdir()
    assert recipes.shipped_folder() == tmp_path / "datasets"


def test_the_demo_flies_the_figure_eight_at_the_same_length():
    """Only the floor and the velocity differ."""
    demo, paper = load_recipe(DEMO_RECIPE), load_recipe("figure_eight")
    assert len(demo.world.blanks_m) == 2
    assert replace(demo, name=paper.name, world=paper.world, model=paper.model) == paper
    assert replace(demo.world, blanks_m=()) == paper.world
    assert replace(demo.model, velocity=paper.model.velocity) == paper.model


def test_the_figure_eight_is_the_papers():
    """Distances of the paper's tables 3 and 4, given back by its errors in metres over errors in percent."""
    recipe = load_recipe("figure_eight")
    place = {name: np.array(xy) for name, xy in recipe.landmarks.items()}
    distance = {a + b: np.linalg.norm(place[a] - place[b]) for a, b in recipe.landmark_pairs + recipe.gaps}
    paper = {
        "AB": 2.1, "BC": 4.5, "CD": 2.1, "DE": 4.5, "EF": 2.1, "FG": 4.5, "GH": 2.1, "HA": 4.5,
        "BG": 6.36, "AE": 0.3,
    }  # fmt: skip
    assert distance == pytest.approx(paper, rel=0.003)
    assert recipe.maneuver.way_points == tuple("ABCDEFGHA")
    assert recipe.model.sonar.datum_m == 0


def test_the_square_is_the_papers():
    recipe = load_recipe("square")
    place = {name: np.array(xy) for name, xy in recipe.landmarks.items()}
    distance = {a + b: np.linalg.norm(place[a] - place[b]) for a, b in recipe.landmark_pairs}
    assert distance == pytest.approx({"AB": 1.3, "BC": 1.3, "CD": 1.3, "DA": 1.3, "BD": 1.84}, rel=0.003)
    assert recipe.camera.camera().focal_px[0] == pytest.approx(140.8, abs=0.05)


def test_a_texture_starts_at_the_recipes_folder(tmp_path):
    cv2.imwrite(str(tmp_path / "floor.png"), np.zeros((20, 20, 3), np.uint8))
    file = tmp_path / "r.toml"
    file.write_text('name = "r"\n[maneuver]\nway_points = [[0, 0], [1, 0]]\n[world]\ntexture = "floor.png"\n')
    assert load_recipe(file).world.texture == str(tmp_path / "floor.png")


@pytest.mark.parametrize(
    ("mapping", "said"),
    [
        (merged(camera={"rate_h": 15}), "unknown key 'camera.rate_h'; did you mean 'camera.rate_hz'?"),
        (merged(sonr={}), "did you mean 'sonar'?"),
        (merged(sonar={"rate_hz": 0}), "sonar.rate_hz: should be greater than 0, got 0"),
        (merged(imu={"rate_hz": -1}), "imu.rate_hz: should be greater than 0"),
        (merged(attitude={"rate_hz": float("inf")}), "attitude.rate_hz: should be less than"),
        (merged(camera={"rate_hz": 0}), "camera.rate_hz"),
        (merged(camera={"size_px": [0, 240]}), "camera.size_px[0]"),
        (merged(camera={"horizontal_fov_deg": 180}), "camera.horizontal_fov_deg"),
        (merged(sonar={"min_range_m": 3, "max_range_m": 2}), "min_range_m must be below"),
        (merged(maneuver={"way_points": [[0, 0], [7, 0]]}), "leaves the floor"),
        (merged(maneuver={"way_points": [[0, 0, -1]]}), "ground"),
        (merged(maneuver={"way_points": ["A"]}), "no landmark 'A'; there are: none"),
        (merged(maneuver={"way_points": []}), "maneuver.way_points"),
        (merged(maneuver={"way_points": [[0, 0]], "height_m": -0.8}), "maneuver.height_m"),
        (merged(maneuver={"way_points": [[0, 0]], "heading": "wobble"}), "'fixed' or 'along_path'"),
        (merged(world={"texture": "gone.jpg"}), "gone.jpg': no such file"),
        (merged(landmarks={"A": [9, 9]}), "landmarks.A (9, 9) lies off the floor"),
        (merged(landmarks={"A\n,B": [0, 0]}), "use 1 to 8 letters"),
        (merged(landmark_pairs=[["A", "B"]]), "landmark_pairs[0]: no landmark 'A'"),
        (merged(name="../../x"), "name: '../../x' holds more than letters, digits, spaces and _ . + -"),
        (merged(velocity={"rate_hz": 0}), "velocity.rate_hz: should be greater than 0"),
        (merged(command={"rate_hz": 0}), "command.rate_hz: should be greater than 0"),
        (merged(battery={"rate_hz": 0.0}), "battery.rate_hz: should be greater than 0"),
        (merged(vehicle={"drag": 1}), "unknown key 'vehicle.drag'; did you mean 'vehicle.drag_1_s'?"),
        (merged(terms={"quadratic_drg": {}}), "did you mean 'terms.quadratic_drag'"),
        (merged(terms={"control_latency": {"T": 80}}), "terms.control_latency.T: give 0 to 2 s, got 80"),
        (merged(model="nomnal"), "no such model; did you mean 'nominal'"),
        (merged(model=3), "model: give the name"),
        (merged(camera="yes"), "camera"),
        (merged(maneuver={"script": []}), "way_points: none; give one, or a script"),
        (merged(maneuver={"script": [[0, 0, 0, 0, 0]]}), "at least a command and a last line"),
        (merged(maneuver={"script": [[0, 0, 0, 0, 0], [0, 0, 0, 0, 0]]}), "not after the one before"),
        (merged(maneuver={"script": [[0, 20, 0, 0, 0], [9, 0, 0, 0, 0]]}), "the stick goes from -1 to 1"),
        (merged(maneuver={"script": [[0, 0, 0, 0], [9, 0, 0, 0, 0]]}), "script: Tuple should have at least"),
        (merged(maneuver={"script": [[0, 0, 0, 0, 0], [9e9, 0, 0, 0, 0]]}), "6 h is the most"),
        (merged(maneuver={"script": "gone.csv"}), "gone.csv: no such script"),
        (merged(maneuver={"script": [[0, 0, 0, 0, 0], [9, 0, 0, 0, 0]], "way_points": [[0, 0]]}), "one of"),
        ({"name": "m"}, "'maneuver' is missing"),
    ],
)  # fmt: skip
def test_a_bad_recipe_is_refused_in_one_line(mapping, said):
    assert said in refused(mapping)


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("figure_eight.toml", "did you mean 'figure_eight'"),
        ("figure_eigth", "did you mean 'figure_eight'"),
        ("nowhere/flight.toml", "does not exist"),
        ("", "no such recipe"),
    ],
)
def test_a_recipe_that_is_not_there_is_refused_in_one_line(source, said):
    with pytest.raises(InputError, match=said) as caught:
        load_recipe(source)
    assert "\n" not in str(caught.value)


def test_a_changed_recipe_is_checked_again():
    recipe = load_recipe("figure_eight")
    high = replace(recipe, maneuver=replace(recipe.maneuver, way_points=("A", "Z")))
    with pytest.raises(InputError, match=r"recipe.*no landmark 'Z'"):
        recipes.check(high, "recipe")


def test_the_readme_names_every_key_of_a_recipe_and_a_model():
    text = RECIPES_PAGE.read_text(encoding="utf-8")
    recipe = load_recipe("square")
    parts = [recipe, *vars(recipe).values(), *vars(recipe.model).values()]
    keys = {field.name for part in parts if is_dataclass(part) for field in fields(part)}
    assert len(keys) > 60
    missing = {key for key in keys if f"`{key}`" not in text and f"[{key}]" not in text}
    assert missing == {"terms", "std"}
    assert "[terms.NAME]" in text
    assert "[std.NAME]" in text


@pytest.mark.slow
def test_the_readme_s_examples_fly_as_they_stand(tmp_path):
    text = RECIPES_PAGE.read_text(encoding="utf-8")
    examples = re.findall(r"`(\w+\.toml)`[^`]*```toml\n(.+?)```", text, re.DOTALL)
    assert [name for name, _ in examples] == ["two_rows.toml", "my_drone.toml"]
    for name, content in examples:
        (tmp_path / name).write_text(content, encoding="utf-8")
        assert f"`{name}`" in text
    own, drone = (tmp_path / name for name, _ in examples)
    flight = simulate(load_recipe(own, drone), seed=0)
    assert flight.frames[0].read().shape == (240, 320, 3)
    assert flight.sonar.noise_std_m == 0.02
    # Over the way points at 1 m height the sonar reads 3 % short.
    assert np.nanmedian(flight.sonar.range_m) == pytest.approx(0.97, abs=0.02)
    assert load_recipe("square", drone).model.terms["steady_wind"] == {"x": 0.5, "y": 0.0}


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_the_recipes_page_agrees_with_the_catalogue(name):
    text = RECIPES_PAGE.read_text(encoding="utf-8")
    row = next(line for line in text.splitlines() if line.startswith(f"| `{name}` |"))
    term = CATALOGUE[name]
    assert all(f"`{parameter.name}`" in row for parameter in term.parameters)
    assert term.equation.replace("|", "&#124;") in row
    mistaken_for, to_fly = row.split(" | ")[-2:]
    assert mistaken_for == (", ".join(f"`{other}`" for other in term.confounders) or "–")
    assert to_fly == f"{term.excitation} |"


def test_a_model_that_there_is_not_is_no_fault_of_the_recipe():
    with pytest.raises(InputError, match=r"^nope: no such model"):
        load_recipe("hover", "nope")
