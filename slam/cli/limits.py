"""Limits of the process, checked before libraries are loaded that would end it or hang without memory or
threads."""

from __future__ import annotations

import os
import resource
import threading

LEAST_MEMORY_BYTES = 1 << 30
"""With a lower limit of the address space OpenBLAS ends the process or hangs when it is loaded."""
BLAS_COPIES = 2
"""numpy and scipy each bring an OpenBLAS, which starts one thread per core when it is loaded."""


def check_limits() -> None:
    """Raise ``MemoryError`` or ``RuntimeError`` where not even the libraries could be loaded.

    Where the threads of OpenBLAS cannot all be started, it gets a single one: it ends the process otherwise.
    """
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < LEAST_MEMORY_BYTES:
        raise MemoryError
    wanted = BLAS_COPIES * (os.cpu_count() or 1)
    if _startable_threads(wanted) < wanted:
        os.environ["OPENBLAS_NUM_THREADS"] = "1"


def _startable_threads(wanted: int) -> int:
    """Return how many threads of ``wanted`` run at once. Raises ``RuntimeError`` for none."""
    end = threading.Event()
    threads = [threading.Thread(target=end.wait, daemon=True) for _ in range(wanted)]
    started: list[threading.Thread] = []
    try:
        for thread in threads:
            thread.start()
            started.append(thread)
    except RuntimeError:
        if not started:
            raise
    finally:
        end.set()
        for thread in started:
            thread.join()
    return len(started)
