"""README and docs say what is so: the example runs, and every command, file, key and column is there."""

from __future__ import annotations

import contextlib
import io
import json
import re
import tomllib
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import get_args, get_type_hints

import numpy as np
import pytest
from PIL import Image
from typer.main import get_command

from backend.bundle.accuracy import systematic_errors
from backend.pose_graph.certificate import Certificate
from backend.pose_graph.solution import RangeErrors, RowMistake
from frontend.obstacles import ObstacleList
from slam.cli import app
from slam.cli.output_folder import EVALUATE_NAMES, OPTIMIZE_NAMES
from slam.core.control_points import PointResidual
from slam.core.estimate import GroundFacts
from slam.core.instrument_errors import InstrumentErrors
from slam.core.summary import summarise
from slam.criticism import Criticism
from slam.evaluation import evaluate
from slam.io.csv_header import header_of
from slam.io.estimate_arrays import SHAPES
from slam.io.exports.formats import FORMATS
from slam.io.landmark_table import HEADER
from slam.io.streams import COLUMNS, KNOWN_KEYS
from slam.mapping.config import PipelineConfig
from slam.report.criticism.write import VERDICTS
from slam.simulation.model import load_model
from slam.simulation.recipe import shipped_recipes
from tests.benchmarks.figures import HEADLINES, headlines
from tests.benchmarks.measured_studies import STUDIES
from tests.benchmarks.run import earlier, sections_of
from tests.slam.evaluation.scene import estimate_of, flight_of, smooth_poses
from tests.slam.made_estimate import made_estimate

ROOT = Path(__file__).parents[1]
PAGES = (
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "docs/architecture.md",
    "docs/library.md",
    "docs/output-files.md",
    "docs/exports.md",
    "docs/recipes.md",
    "docs/tutorial.md",
    *(f"docs/method/{path.name}" for path in sorted((ROOT / "docs" / "method").glob("*.md"))),
    "docs/flight-format.md",
    "docs/experiments.md",
    "docs/criticism.md",
    "docs/settings.md",
    *(f"docs/measured/{name}.md" for name in STUDIES),
)


def page(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


NAMED_BY_DATA = ("rpe", "landmarks", "loop_gap_m")
COUNTS = ("rejected", "timing_s", "left_out")


def keys(record: dict) -> set[str]:
    """All names in a JSON record but those that the flight gives."""
    found = set(record)
    for key, value in record.items():
        inner = value.values() if key in NAMED_BY_DATA and isinstance(value, dict) else [value]
        for each in inner:
            if isinstance(each, dict) and key not in COUNTS:
                found |= keys(each)
    return found


def test_the_example_runs_and_prints_a_map_that_is_right():
    (example,) = re.findall(r"```python\n(.*?)```", page("README.md"), re.DOTALL)
    assert len([line for line in example.splitlines() if line.strip()]) <= 10
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(example, "README.md", "exec"), {})
    first, *rows = printed.getvalue().splitlines()
    keyframes, loops = map(int, re.fullmatch(r"(\d+) keyframes, (\d+) loops", first).groups())
    assert keyframes > 20
    assert loops > 10, "the square is flown round more than once"
    figures = [re.fullmatch(r"(\w-\w): (\S+) m, chain (\S+), map (\S+)", row).groups() for row in rows]
    assert [pair for pair, *_ in figures] == ["A-B", "B-C", "C-D", "D-A", "B-D"]
    for _, true, chain, ours in figures:
        assert float(ours) == pytest.approx(float(true), rel=0.005)
        assert float(chain) == pytest.approx(float(true), rel=0.1)


def test_every_command_is_in_the_table_and_the_other_way_round():
    told = set(re.findall(r"^\| `slam (\w+)", page("README.md"), re.MULTILINE))
    assert told == set(get_command(app).commands)
    for command, rest in re.findall(r"slam (\w+)([^`\n]*)", page("README.md")):
        for option in re.findall(r"--[a-z]+(?:-[a-z]+)*", rest):
            options = {name for p in get_command(app).commands[command].params for name in p.opts}
            assert option in options, (command, option)


def test_make_has_the_targets():
    targets = set(re.findall(r"^(\w+):", page("Makefile"), re.MULTILINE))
    for name in PAGES:
        assert set(re.findall(r"`make (\w+)", page(name))) <= targets


def anchors(path: Path) -> list[str]:
    """What a page's headings of plain words are linked by."""
    words = re.findall(r"^#+ (.+)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return [w.lower().replace(" ", "-") for w in words]


def test_links_lead_somewhere():
    for name in PAGES:
        for link in re.findall(r"\]\(([^)]+)\)", page(name)):
            if link.startswith("https://"):
                continue
            file, _, heading = link.partition("#")
            target = (ROOT / name).parent / file
            assert target.exists(), (name, link)
            assert not heading or heading in anchors(target), (name, link)


@pytest.mark.parametrize("name", STUDIES)
def test_a_page_of_measured_flights_tells_its_verdict_and_shows_it(name):
    text = page(f"docs/measured/{name}.md")
    verdict, sentence = re.search(r"^\*\*(\w+)\*\*: (.+)$", text, re.MULTILINE).groups()
    assert verdict in VERDICTS
    assert sentence.endswith((".", ".)"))
    assert STUDIES[name].shown in text
    assert f"](measured/{name}.md)" in page("docs/criticism.md")
    load_model(ROOT / "docs" / "measured" / f"{name}.toml")
    pictures = re.findall(r"!\[[^]]+\]\(([^)]+)\)", text)
    assert len(pictures) >= 3
    assert all((ROOT / "docs" / "measured" / p).stat().st_size < 150_000 for p in pictures)


def test_the_picture_is_small():
    path = ROOT / "docs" / "figure_eight.jpg"
    assert path.stat().st_size < 300_000
    with Image.open(path) as picture:
        assert picture.width >= 1000


@pytest.mark.parametrize("name", ["README.md", "docs/figures.md"])
def test_the_figures_have_their_place(name):
    text = page(name)
    assert text.count("<!-- figures -->") == text.count("<!-- /figures -->") == 1
    assert text.index("<!-- figures -->") < text.index("<!-- /figures -->")


def test_the_readme_s_few_figures_are_those_that_were_measured():
    """None of them went missing under another name, and none was edited by hand."""
    sections = sections_of(earlier())
    assert set(HEADLINES) <= {m.key for section in sections for m in section.metrics}
    assert headlines(sections) in page("README.md")


def test_the_demo_shows_what_loops_do():
    """Without loops it is off by several percent, which a reader sees at once; with them by a tenth."""
    figures = {m.key: m.value for m in earlier()["demo"].metrics}
    largest, gain = (
        "seed 0: largest landmark error",
        "largest landmark error without loops over that with loops",
    )
    assert figures[f"{largest}, chain of homographies"] > 3.0
    assert figures[f"{largest}, optimized without loops"] > 3.0
    assert figures[f"{largest}, with loops"] < 0.1, "as the README says"
    assert min(figures[f"seed 0: {gain}"], figures[f"5 seeds, least: {gain}"]) >= 10.0


def test_every_output_file_is_named():
    for file in (*OPTIMIZE_NAMES, *EVALUATE_NAMES):
        assert f"`{file}`" in page("docs/output-files.md"), file


def test_every_export_format_has_its_row_and_the_other_way_round():
    rows = re.findall(r"^\| `(\w+)` \| `DIR(\S*)` \|", page("docs/exports.md"), re.MULTILINE)
    assert rows == [(known.name, known.ending) for known in FORMATS]


def test_every_key_and_array_is_explained():
    text = page("docs/output-files.md") + page("docs/method/evaluation.md")
    summary = summarise(made_estimate(), graph_alone=True).to_json()
    poses = smooth_poses(np.random.default_rng(0), 60)
    surveyed = {"A": np.zeros(3), "B": np.array([0.5, 0.0, 0.0])}
    flight = flight_of(poses, landmarks=surveyed, gaps=(("A", "B"),))
    evaluation = evaluate(estimate_of(poses), flight).to_json()
    assert all(evaluation[key] for key in NAMED_BY_DATA), "nothing is left unchecked"
    arrays = {*SHAPES, "record"}
    for word in keys(summary) | keys(evaluation) | arrays:
        assert f"`{word}`" in text, word


def records(hint: object) -> set[type]:
    """All dataclasses in a type, and in those of their fields."""
    found = {hint} if is_dataclass(hint) else set()
    types = get_type_hints(hint, localns=vars(systematic_errors)).values() if found else get_args(hint)
    return found.union(*map(records, types))


def test_every_field_of_a_record_in_the_summary_stands_in_its_row():
    rows = {}
    for names, text in re.findall(
        r"^\| ((?:`\w+`(?:, )?)+) \|(.*)$", page("docs/output-files.md"), re.MULTILINE
    ):
        rows |= dict.fromkeys(re.findall(r"`(\w+)`", names), text)
    types = get_type_hints(InstrumentErrors, localns=vars(systematic_errors)) | {
        "height_sensor": RangeErrors, "ground": GroundFacts, "obstacles": ObstacleList,
        "control_points": PointResidual, "row_mistakes": RowMistake, "certificate": Certificate,
    }  # fmt: skip
    told = [(key, f.name) for key, hint in types.items() for of in records(hint) for f in fields(of)]
    assert len(told) > 80
    assert [(key, name) for key, name in told if f"`{name}`" not in rows[key]] == []


def test_every_key_of_a_verdict_stands_in_its_table():
    told = set(re.findall(r"`(\w+)`", page("docs/criticism.md")))
    assert {*Criticism("nothing_wrong").to_json(), "map"} <= told


def test_every_stream_and_key_of_a_flight_is_explained():
    text = page("docs/flight-format.md")
    for folder, columns in COLUMNS.items():
        assert f"| `{folder}` | `{header_of(columns)}` |" in text, folder
    for key in KNOWN_KEYS:
        assert f"`{key}`" in text, key
    assert f"`{','.join(HEADER)}`" in text


def test_every_setting_is_explained_with_its_default():
    told = {}
    for line in page("docs/settings.md").splitlines():
        if header := re.match(r"## `\[(\w+)\]`", line):
            section = told.setdefault(header[1], {})
        elif row := re.match(r"\| `(\w+)` \| `(.+?)` \|", line):
            section[row[1]] = tomllib.loads(f"value = {row[2]}")["value"]
    # As JSON, in which a tuple and a TOML array are one.
    assert told == json.loads(json.dumps(asdict(PipelineConfig())))


def test_recipes_are_explained():
    for recipe in shipped_recipes():
        assert f"| `{recipe}` |" in page("docs/recipes.md")


def test_pages_and_tests_speak_of_the_project_alone():
    for name in PAGES:
        assert not re.search(r"(?<![\w.])/(work|home|root|tmp)/|\.\./shared|TODO|localhost", page(name)), name
    for path in (ROOT / "tests").rglob("*.py"):
        # Numbers of a list that is not in the repository tell a reader nothing.
        assert not re.search(r"\bFault \d", path.read_text(encoding="utf-8")), path
