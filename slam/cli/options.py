"""Options that several commands share, and the settings that they give."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from frontend.feature_kinds import FeatureKind
    from frontend.workers import Workers
    from slam.io.recordings.choice import Request
    from slam.mapping.config import PipelineConfig
    from slam.simulation.model import Model

OUT = typer.Option("--out", metavar="DIR", help="Where to write; an earlier output of slam is replaced.")
FLIGHT_OUT = typer.Option("--out", metavar="FLIGHT", help="The flight folder to write; must not exist yet.")
CONFIG = typer.Option(metavar="FILE.toml", help="Settings of the stages; an unknown key is refused.")
FEATURES = typer.Option(
    help="Feature detector and descriptor; default: that of --config, else sift.", show_default=False
)
MODEL = typer.Option(
    metavar="MODEL",
    help="Model of the instruments' errors, such as extended.toml of slam criticise; the readings are "
    "corrected by it first.",
)
QUIET = typer.Option(
    "--quiet", "-q", help="Print neither progress nor tables; errors are printed all the same."
)
JSON = typer.Option("--json", help="Print the summary as JSON instead of tables.")
TOPICS = typer.Option(
    "--topic",
    metavar="STREAM=CHANNEL",
    help="The channel of a recording to take as a stream, such as cam0=/camera/image_raw; STREAM= leaves "
    "the stream out. Can be repeated.",
)
PICTURE_RATE = typer.Option(
    "--picture-rate",
    metavar="HZ",
    min=1e-3,
    help="Most pictures per second to take from a recording; default: all.",
)
RESUME = typer.Option(
    "--resume/--no-resume",
    help="Go on where a run into the same folder was killed, with what still fits; or compute all anew.",
)
CLUSTER = typer.Option(
    "--cluster", help="Share the work among processes of Dask, one on each core; needs the extra cluster."
)
SCHEDULER = typer.Option(
    metavar="ADDRESS",
    help="Share the work among the workers of a scheduler of Dask, such as tcp://10.0.0.5:8786; photographs "
    "must be in a folder that all machines see at the same path.",
)
GRAPH_PARAMETERS = ("source", "sources", "out", "mosaic", "quiet", "as_json")
"""Parameters of commands that a pose graph has a use for; a graph has no mosaic in any case."""
SEED = typer.Option(min=0, help="Seed of all random numbers.")


def on_cluster(local: bool, scheduler: str | None) -> AbstractContextManager[Workers | None]:
    """Return what shares the work as ``--cluster`` and ``--scheduler`` ask for it, None without them.

    Raises ``InputError`` as `slam.parallel.cluster.cluster` does.
    """
    if not local and scheduler is None:
        return nullcontext()
    from slam.core.errors import InputError
    from slam.parallel.cluster import cluster

    if local and scheduler is not None:
        raise InputError("--cluster starts workers on this machine, and --scheduler uses others; give one")
    return cluster(scheduler)


def pipeline_config(path: Path | None, features: FeatureKind | None) -> PipelineConfig:
    """Return the settings of a file, overridden by those of the command line.

    Raises ``InputError`` where the file holds an unknown key.
    """
    from slam.core.toml_config import load_config, read_toml
    from slam.mapping.config import PipelineConfig

    config = PipelineConfig() if path is None else load_config(PipelineConfig, read_toml(path), str(path))
    return config if features is None else replace(config, features=replace(config.features, kind=features))


def request_of(given: list[str] | None, picture_rate_hz: float | None = None) -> Request:
    """Return what ``--topic`` and ``--picture-rate`` ask for. Raises ``InputError``."""
    from slam.core.errors import InputError
    from slam.io.recordings.choice import Request

    topics: dict[str, str] = {}
    for text in given or []:
        stream, equals, channel = text.partition("=")
        if not equals or not stream or stream in topics:
            what = "is given twice" if stream in topics else "is not of the form STREAM=CHANNEL"
            raise InputError(f"--topic {text}: {what}; write, for example, cam0=/camera/image_raw")
        topics[stream] = channel
    return Request(topics, picture_rate_hz)


def refuse_flight_options(graph: Path, context: typer.Context) -> None:
    """Raise ``InputError`` for options of flights that the command line gives with a pose graph.

    These are all but ``GRAPH_PARAMETERS``: a new option cannot be ignored without a word.
    """
    from slam.core.errors import InputError

    given = [
        parameter.opts[0]
        for parameter in context.command.params
        if parameter.name not in GRAPH_PARAMETERS and _is_given(context, parameter.name)
    ]
    if given:
        it = "it" if len(given) == 1 else "them"
        raise InputError(
            f"{', '.join(given)}: {graph} is a graph, without pictures and instruments; leave {it} out"
        )


def _is_given(context: typer.Context, name: str | None) -> bool:
    source = context.get_parameter_source(name) if name else None
    return source is not None and source.name == "COMMANDLINE"


def read_model(model: Path | str | None) -> Model | None:
    """Return the model of the instruments' errors that an option names; None without it."""
    if model is None:
        return None
    from slam.simulation.model import load_model  # a long import, for this alone

    return load_model(model)
