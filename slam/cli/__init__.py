"""The command ``slam``: one module per command; each imports what it needs only when it runs."""

from __future__ import annotations

import faulthandler
import gc
import logging
import os
import sys
import warnings
from typing import Annotated

import typer

from slam.cli.criticise import criticise
from slam.cli.demo import demo
from slam.cli.estimate import estimate
from slam.cli.evaluate import evaluate
from slam.cli.export import export
from slam.cli.flights import import_flight, info
from slam.cli.guard import guarded, print_error, show_traceback
from slam.cli.live import live
from slam.cli.locate import locate
from slam.cli.loops import loops
from slam.cli.optimize import optimize
from slam.cli.replay import replay
from slam.cli.reproduce import reproduce
from slam.cli.signals import end_by_signals, exit_code
from slam.cli.simulate import simulate
from slam.cli.standard_streams import separate_streams, show_libraries
from slam.cli.supervisor import continue_in_child
from slam.core.version import VERSION

app = typer.Typer(
    name="slam",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Drift-free maps from a down-looking camera: a flight in, trajectory, graph and mosaic out.",
    epilog="Exit codes: 0 done, 1 the input was refused (one line says why), 2 wrong usage, 130 interrupted.",
)
for name, command in (
    ("demo", demo),
    ("optimize", optimize),
    ("live", live),
    ("estimate", estimate),
    ("evaluate", evaluate),
    ("locate", locate),
    ("loops", loops),
    ("simulate", simulate),
    ("replay", replay),
    ("reproduce", reproduce),
    ("criticise", criticise),
    ("import", import_flight),
    ("export", export),
    ("info", info),
):
    app.command(name)(guarded(command))

GARBAGE_AFTER = 10_000
"""New containers after which unreachable cycles are looked for. Hardly any object is in a cycle here, and so
many take a megabyte or two. With Python's 700, a short map spends a twentieth of its time on looking."""


def _version(asked: bool) -> None:
    if asked:
        print(f"slam {VERSION}")
        raise typer.Exit


def _show_log(verbose: bool) -> None:
    """Print the log of the three packages on standard error, or stop doing so."""
    for package in ("slam", "frontend", "backend"):
        logger = logging.getLogger(package)
        logger.handlers = [handler for handler in logger.handlers if handler.name != "slam --verbose"]
        logger.setLevel(logging.INFO if verbose else logging.NOTSET)
        if verbose:
            handler = logging.StreamHandler()
            handler.name = "slam --verbose"
            handler.setFormatter(logging.Formatter("%(name)s: %(message)s"))
            logger.addHandler(handler)


@app.callback()
def shared_options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    debug: Annotated[
        bool,
        typer.Option("--debug", envvar="SLAM_DEBUG", help="On an error, print the traceback."),
    ] = False,
    verbose: Annotated[
        bool, typer.Option("--verbose", help="Print the log of all stages on standard error.")
    ] = False,
) -> None:
    """Set the options that all commands share."""
    show_traceback.set(debug)
    if debug and sys.__stderr__ is not None:
        show_libraries()
        faulthandler.enable(sys.__stderr__)  # a crash in a library shows where it was
    _show_log(verbose)


def main() -> None:
    """Run the command line; called by ``slam.__main__``."""
    continue_in_child()
    gc.set_threshold(GARBAGE_AFTER)
    # Damaged pictures are counted and reported by us.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    separate_streams()
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # a missing cache of fonts is no error
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    end_by_signals()
    try:
        try:
            app()
        finally:
            sys.stdout.flush()
    except SystemExit as ended:
        code = exit_code()
        if code is not None and ended.code == code:
            sys.stderr.flush()
            os._exit(code)  # without waiting for threads, which the signal may have stopped for good
        raise
    except OSError as error:  # --version and --help print outside of a command
        if not isinstance(error, BrokenPipeError):  # a reader that has seen enough, such as `head`
            print_error(error)
        sys.exit(1)
