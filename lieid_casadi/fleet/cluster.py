"""Arm-nights on a Dask cluster: the given one or one on this machine, timeouts, lost workers."""

from __future__ import annotations

import contextlib
import logging
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lieid_casadi import __version__
from lieid_casadi.errors import ClusterLost, FleetError, of_extra
from lieid_casadi.fleet.arm_night import run_arm_night
from lieid_casadi.fleet.night_result import ArmNight, Batch, NightResult
from lieid_casadi.messages import reason_of

#: Of a cluster on this machine. Dask lets malloc return memory after every array of 64 kB, which
#: costs an arm-night a quarter of its time in page faults; the limit of a worker's memory stays.
#: The profiler is not used, and clocks that run 50 times per second cost 1 to 2 % of a core each.
#: On a machine that does other work, a process that computes may be silent for minutes, and its
#: successor may need as long to start; Dask would end the first, and give the second 15 s.
LOCAL_SETTINGS: dict[str, Any] = {
    "distributed.deploy.lost-worker-timeout": "1 day",
    "distributed.scheduler.worker-ttl": None,
    "distributed.comm.timeouts.connect": "10 minutes",
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": 128 * 2**20,
    "distributed.nanny.pre-spawn-environ.MALLOC_MMAP_THRESHOLD_": 32 * 2**20,
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "500ms",
    "distributed.admin.system-monitor.interval": "5s",
}
LARGEST_BATCH = 16  # arm-nights of one task, whose rows are recorded together
BATCHES_PER_THREAD = 8  # at least, so that all threads end together
CHECK_EVERY = 1.0  # s: of timeouts and of the connection
WORKERS_WAIT = 120.0  # s: for which a given cluster may be without workers


@dataclass(frozen=True)
class RunOptions:
    """How arm-nights are run."""

    scheduler: str | None = None  # address of a Dask scheduler; None: a cluster on this machine
    workers: int | None = None  # processes of that cluster; None: one per core
    memory: str = "2GB"  # limit of each of these processes
    timeout: float = 600.0  # s, after which an arm-night is given up
    losses: int = 2  # lost workers after which an arm-night is given up


@contextlib.contextmanager
def dask_client(options: RunOptions) -> Iterator[Any]:
    """Client of the given Dask cluster, or of one on this machine that ends with the context."""
    with of_extra("fleet", "fleets need dask; install it with"):
        import dask
        from distributed import Client, LocalCluster
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    settings = LOCAL_SETTINGS | {"distributed.scheduler.allowed-failures": options.losses}
    with dask.config.set(settings), contextlib.ExitStack() as stack:
        address: Any = options.scheduler
        patience = "15s"
        if address is None:
            patience = LOCAL_SETTINGS["distributed.comm.timeouts.connect"]
            address = stack.enter_context(
                LocalCluster(
                    n_workers=options.workers,
                    threads_per_worker=1,
                    memory_limit=options.memory,
                    dashboard_address="127.0.0.1:0",  # not 8787 of every network
                    silence_logs=logging.CRITICAL,
                )
            )
        try:
            client = stack.enter_context(Client(address, timeout=patience))
        except (OSError, ValueError) as error:
            raise FleetError(
                f"{options.scheduler}: no Dask scheduler: {reason_of(error)}"
            ) from None
        if options.scheduler is not None:
            require_same_version(client.run(worker_version))
        yield client


def worker_version() -> str:
    """Return the version of this package in the process of a worker."""
    return __version__


def require_same_version(versions: Mapping[str, str]) -> None:
    """Refuse workers (address → version) whose results may differ from those of this version."""
    others = [f"{w} has {v}" for w, v in versions.items() if not _is_same(v, __version__)]
    if others:
        raise FleetError(
            f"workers of another version of lieid-casadi: {', '.join(others[:3])}"
            f"{' …' if len(others) > 3 else ''}; expected {__version__} as here"
        )


def _is_same(version: str, other: str) -> bool:
    """Whether two versions differ by fixes at most."""
    return version.split(".")[:2] == other.split(".")[:2]


def run_arm_nights(nights: Sequence[ArmNight], fits: Mapping[str, bytes], expected: str) -> Batch:
    """Run arm-nights on a worker; an exception fails its own one only.

    ``expected`` is the client's version: a worker of another one may have joined during the run.
    """
    results = []
    for night in nights:
        try:
            result = run_arm_night(night, fits[night.fit_sha256])
        except Exception as error:  # noqa: BLE001
            result = NightResult("failed", f"{type(error).__name__}: {reason_of(error)}")
        if not _is_same(result.version, expected):
            reason = f"worker with version {result.version}; expected {expected} as on the client"
            result = NightResult("failed", reason, version=result.version)
        results.append(result)
    return Batch.of(list(zip(nights, results, strict=True)))


def run_on_cluster(
    client: Any,
    nights: Sequence[ArmNight],
    fits: Mapping[str, bytes],
    options: RunOptions,
    *,
    finished: Callable[[Batch], None],
) -> None:
    """Run arm-nights in batches; each batch is passed on as soon as it is there.

    A batch whose worker is lost, or that exceeds the timeout, is run again night by night: only the
    arm-night that is the reason fails, after ``options.losses`` further attempts.
    """
    from distributed import CancelledError, wait
    from distributed.comm import CommClosedError

    threads = max(sum(client.nthreads().values()), 1)
    size = min(max(len(nights) // (BATCHES_PER_THREAD * threads), 1), LARGEST_BATCH)
    waiting = deque(nights[k : k + size] for k in range(0, len(nights), size))
    running: dict[Any, tuple[Sequence[ArmNight], float]] = {}  # future → batch and its start
    last_worker = time.monotonic()

    def give_up(batch: Sequence[ArmNight], reason: str) -> None:
        if len(batch) > 1:
            waiting.extendleft([night] for night in batch)
        else:
            finished(Batch.of([(batch[0], NightResult("failed", reason))]))

    try:
        while waiting or running:
            threads, now = sum(client.nthreads().values()), time.monotonic()
            last_worker = now if threads or _is_starting(client) else last_worker
            if now - last_worker > WORKERS_WAIT:
                raise ClusterLost(
                    f"the Dask cluster {options.scheduler or ''} has had no workers for "
                    f"{WORKERS_WAIT:g} s, with {_count(running)} arm-nights in work; start workers "
                    "and run the command again to continue"
                )
            while waiting and len(running) < threads:  # so that each begins at once
                batch = waiting.popleft()
                own = {night.fit_sha256: fits[night.fit_sha256] for night in batch}
                future = client.submit(run_arm_nights, batch, own, __version__, pure=False)
                running[future] = batch, now
            if not running:
                time.sleep(CHECK_EVERY)
                continue
            with contextlib.suppress(TimeoutError):
                wait(list(running), timeout=CHECK_EVERY, return_when="FIRST_COMPLETED")
            for future in [f for f in running if f.done()]:
                result = _result(future)
                batch, _ = running.pop(future)
                if isinstance(result, Batch):
                    finished(result)
                else:
                    give_up(batch, result)
            late = time.monotonic() - options.timeout
            for future in [f for f, (_, start) in running.items() if start < late]:
                _stop(client, future)
                give_up(
                    running.pop(future)[0], f"not finished after {options.timeout:g} s (--timeout)"
                )
            if client.status != "running":
                raise CommClosedError
    except (CommClosedError, CancelledError, TimeoutError, OSError):
        raise ClusterLost(
            f"the connection to the Dask scheduler {options.scheduler or ''} was lost, with "
            f"{_count(running)} arm-nights in work; what is finished is recorded, run the command "
            "again to continue"
        ) from None
    finally:
        with contextlib.suppress(Exception):
            client.cancel(list(running), force=True)


def _result(future: Any) -> Batch | str:
    """Return the results of a batch, or why there are none."""
    from distributed import CancelledError, KilledWorker

    if future.status == "lost" or future.cancelled():
        raise CancelledError(future.key)
    error = future.exception()
    if error is None:
        return future.result()  # type: ignore[no-any-return]
    if isinstance(error, KilledWorker):
        return (
            "the worker was lost repeatedly (killed, or out of memory): see --memory and the logs "
            "of the cluster"
        )
    return f"{type(error).__name__}: {reason_of(error)}"


def _is_starting(client: Any) -> bool:
    """Whether a cluster on this machine has a nanny, which starts a worker that was lost again."""
    nannies = getattr(client.cluster, "workers", {}).values()
    return any(nanny.status.name in ("init", "starting", "running") for nanny in nannies)


def _count(running: Mapping[Any, tuple[Sequence[ArmNight], float]]) -> int:
    return sum(len(batch) for batch, _ in running.values())


def _stop(client: Any, future: Any) -> None:
    """Cancel a task, and start its worker again, which would go on with it."""
    with contextlib.suppress(Exception):
        workers = [w for w, keys in client.processing().items() if future.key in keys]
        future.cancel(force=True)
        client.restart_workers(workers, raise_for_error=False)
