"""Standard pose graphs with everything that a user gets: poses, covariances, certificate and report.

The CPU time of ``slam optimize GRAPH`` is that of the whole command, imports included. On small graphs, the
time from the file to poses and covariances is compared with that of raw gtsam in the same run.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
from pathlib import Path

import gtsam
import numpy as np
from threadpoolctl import threadpool_limits

from backend.g2o import read_g2o
from backend.pose_graph.solve import solve_pose_graph
from tests.benchmarks.graphs import raw_read, raw_solve, timed
from tests.benchmarks.measured import folder
from tests.benchmarks.metric import Metric, at_most

COMMAND_CPU_S = {"sphere2500": 3.0, "city10000": 3.0, "torus3D": 6.0}
SMALL = ("CSAIL", "intel", "parking-garage")
"""Graphs whose marginal covariances raw gtsam gives within seconds."""
MAX_RATIO = 1.1
RUNS = 3


def measure() -> list[Metric]:
    """Measure the command on the large graphs, and the ratio to raw gtsam on the small ones."""
    data = folder("graphs")
    figures = [_command(data / f"{name}.g2o") for name in COMMAND_CPU_S]
    return figures + [_with_covariances(data / f"{name}.g2o") for name in SMALL]


def _command(path: Path) -> Metric:
    """Measure the CPU time of the whole command in a process of its own, the best of three runs."""
    seconds = []
    for _ in range(RUNS):
        with tempfile.TemporaryDirectory() as out:
            command = [sys.executable, "-m", "slam", "optimize", str(path), "--out", f"{out}/map", "--quiet"]
            before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
            seconds.append(resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before)
    limit = COMMAND_CPU_S[path.stem]
    return at_most(f"{path.stem}: user CPU of `slam optimize`", min(seconds), "s", limit)


def _with_covariances(path: Path) -> Metric:
    """Compare the times from the file to poses and covariances, in alternation; the best of several runs."""
    ours, theirs = [], []
    with threadpool_limits(1, "blas"):  # as the command does
        for _ in range(RUNS):
            ours.append(timed(lambda: solve_pose_graph(read_g2o(path)))[0])
            theirs.append(timed(lambda: raw_with_covariances(path))[0])
    key = f"{path.stem}: from the file to poses and covariances, over raw gtsam's"
    source = f"{1e3 * min(ours):.0f} ms over {1e3 * min(theirs):.0f} ms"
    return at_most(key, min(ours) / min(theirs), "x", MAX_RATIO, source)


def raw_with_covariances(path: Path) -> list[np.ndarray]:
    """Read, solve and return the marginal covariance of each pose with plain gtsam."""
    graph, values = raw_read(path)
    values, _ = raw_solve(graph, values, from_chordal=False)
    marginals = gtsam.Marginals(graph, values)
    return [marginals.marginalCovariance(key) for key in list(values.keys())]
