"""The Dask cluster that runs arm-nights: a given one, or one on this machine."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from lieid_casadi.errors import FleetError, MissingDependency
from lieid_casadi.recording.readers.registry import reason_of

DASHBOARD_WAIT = 5.0  # s: for the answer of the dashboard
#: Of a cluster on this machine. Dask lets malloc return memory after every array of 64 kB, which
#: costs an arm-night a quarter of its time in page faults; the limit of a worker's memory stays.
#: The profiler is not used, and clocks that run 50 times per second cost 1 to 2 % of a core each.
LOCAL_SETTINGS = {
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": 128 * 2**20,
    "distributed.nanny.pre-spawn-environ.MALLOC_MMAP_THRESHOLD_": 32 * 2**20,
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "500ms",
    "distributed.admin.system-monitor.interval": "5s",
}


@dataclass(frozen=True)
class RunOptions:
    """How arm-nights are run.

    Attributes
    ----------
    scheduler : str or None
        Address of a Dask scheduler; None starts a cluster on this machine.
    workers : int or None
        Processes of that cluster; None: one per core.
    memory : str
        Limit of each of these processes, such as ``2GB``.
    timeout : float
        Seconds after which an arm-night is given up.
    losses : int
        Lost workers after which an arm-night is given up.
    """

    scheduler: str | None = None
    workers: int | None = None
    memory: str = "2GB"
    timeout: float = 600.0
    losses: int = 2


@contextlib.contextmanager
def dask_client(options: RunOptions) -> Iterator[Any]:
    """Client of a Dask cluster: the given one, or one on this machine that ends with the context.

    Raises
    ------
    FleetError
        No scheduler answers at the address.
    MissingDependency
        Dask is not installed.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError:
        raise MissingDependency(
            "fleets need dask; install it with: pip install 'lieid-casadi[fleet]'"
        ) from None
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    settings = LOCAL_SETTINGS | {"distributed.scheduler.allowed-failures": options.losses}
    with dask.config.set(settings), contextlib.ExitStack() as stack:
        address: Any = options.scheduler
        if address is None:
            address = stack.enter_context(
                LocalCluster(
                    n_workers=options.workers,
                    threads_per_worker=1,
                    memory_limit=options.memory,
                    dashboard_address="127.0.0.1:0",
                    silence_logs=logging.CRITICAL,
                )
            )
        try:
            client = stack.enter_context(Client(address, timeout="15s"))
        except (OSError, ValueError) as error:
            raise FleetError(
                f"{options.scheduler}: no Dask scheduler: {reason_of(error)}"
            ) from None
        yield client


def dashboard_of(client: Any) -> str | None:
    """Return the address of the cluster's dashboard; None if it does not answer from here."""
    from urllib.request import urlopen

    try:
        link = str(client.dashboard_link)
        with urlopen(link, timeout=DASHBOARD_WAIT):
            return link
    except (OSError, KeyError, ValueError):
        return None
