"""Arm-nights on a Dask cluster: the given one or one on this machine, timeouts, lost workers."""

from __future__ import annotations

import contextlib
import logging
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lieid_casadi import __version__
from lieid_casadi.errors import ClusterLost, FleetError, MissingDependency
from lieid_casadi.fleet.arm_night import run_arm_night
from lieid_casadi.fleet.night_result import ArmNight, NightResult
from lieid_casadi.messages import reason_of

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
TOPIC = "lieid-fleet"  # of the events with which workers report that a task has begun
WAITING_PER_THREAD = 3  # tasks that are submitted before earlier ones are finished
CHECK_EVERY = 1.0  # s: of timeouts and of the connection
WORKERS_WAIT = 120.0  # s: for which a cluster may be without workers


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
        if options.scheduler is not None:
            require_same_version(client.run(worker_version))
        yield client


def worker_version() -> str:
    """Return the version of this package in the process of a worker."""
    return __version__


def require_same_version(versions: Mapping[str, str]) -> None:
    """Refuse workers (address → version) whose results may differ from those of this version."""
    others = [f"{worker} has {v}" for worker, v in versions.items() if not _is_same_version(v)]
    if others:
        raise FleetError(
            f"workers of another version of lieid-casadi: {', '.join(others[:3])}"
            f"{' …' if len(others) > 3 else ''}; expected {__version__} as here"
        )


def _is_same_version(version: str) -> bool:
    """Whether a version differs from this one by fixes at most."""
    return version.split(".")[:2] == __version__.split(".")[:2]


def dashboard_of(client: Any) -> str | None:
    """Return the address of the cluster's dashboard; None if it does not answer from here."""
    from urllib.request import urlopen

    try:
        link = str(client.dashboard_link)
        with urlopen(link, timeout=DASHBOARD_WAIT):
            return link
    except (OSError, KeyError, ValueError):
        return None


def run_on_cluster(
    client: Any,
    nights: Sequence[ArmNight],
    fits: Mapping[str, bytes],
    options: RunOptions,
    *,
    finished: Callable[[ArmNight, NightResult], None],
) -> None:
    """Run arm-nights; each result is passed on as soon as it is there.

    A worker that is lost fails its arm-night only after ``options.losses`` further attempts. An
    arm-night that exceeds the timeout has failed, and its worker is started again. ``fits`` maps
    ``fit_sha256`` to the content of the fit's file. ClusterLost: no scheduler or workers any more.
    """
    _Submission(client, fits, options, finished).run(nights)


def reporting_arm_night(night: ArmNight, fit_content: bytes, key: str) -> NightResult:
    """Run an arm-night on a worker, which first reports that the task has begun."""
    from distributed import get_worker

    worker = get_worker()
    worker.log_event(TOPIC, {"key": key, "worker": worker.address})
    return run_arm_night(night, fit_content)


class _Submission:
    """Tasks of one call: waiting, on the cluster, and when they have begun."""

    def __init__(
        self,
        client: Any,
        fits: Mapping[str, bytes],
        options: RunOptions,
        finished: Callable[[ArmNight, NightResult], None],
    ) -> None:
        self.client, self.options, self.finished, self.fits = client, options, finished, fits
        self.tasks: dict[str, tuple[Any, ArmNight]] = {}
        self.begun: dict[str, tuple[float, str]] = {}
        self.count, self.again = 0, Counter[ArmNight]()
        self.last_worker = time.monotonic()

    def run(self, nights: Sequence[ArmNight]) -> None:
        from distributed import CancelledError
        from distributed.comm import CommClosedError

        self.client.subscribe_topic(TOPIC, self._has_begun)
        waiting = iter(nights)
        try:
            while True:
                self._fill(waiting)
                if not self.tasks:
                    return
                for future in self._ready():
                    self._take(future)
                self._give_up()
                if self.client.status != "running":
                    raise CommClosedError
        except (CommClosedError, CancelledError, TimeoutError, OSError):
            raise ClusterLost(
                f"the connection to the Dask scheduler {self.options.scheduler or ''} was lost, "
                f"with {len(self.tasks)} arm-nights in work; what is finished is recorded, "
                "run the command again to continue"
            ) from None
        finally:
            with contextlib.suppress(Exception):
                self.client.unsubscribe_topic(TOPIC)
                self.client.cancel([future for future, _ in self.tasks.values()], force=True)

    def _fill(self, waiting: Iterator[ArmNight]) -> None:
        threads = sum(self.client.nthreads().values())
        if threads:
            self.last_worker = time.monotonic()
        elif time.monotonic() - self.last_worker > WORKERS_WAIT:
            raise ClusterLost(
                f"the Dask cluster {self.options.scheduler or ''} has had no workers for "
                f"{WORKERS_WAIT:g} s, with {len(self.tasks)} arm-nights in work; start workers and "
                "run the command again to continue"
            )
        while len(self.tasks) < WAITING_PER_THREAD * max(threads, 1):
            night = next(waiting, None)
            if night is None:
                return
            self._submit(night)

    def _submit(self, night: ArmNight) -> None:
        self.count += 1
        key = f"arm-night-{id(self):x}-{self.count}-{night.serial}-{night.date}"
        fit = self.fits[night.fit_sha256]
        future = self.client.submit(reporting_arm_night, night, fit, key, key=key, pure=False)
        self.tasks[key] = (future, night)

    def _ready(self) -> list[Any]:
        """Return the futures that are finished, after at least one is or a short time."""
        from distributed import wait

        futures = [future for future, _ in self.tasks.values()]
        with contextlib.suppress(TimeoutError):
            wait(futures, timeout=CHECK_EVERY, return_when="FIRST_COMPLETED")
        return [future for future in futures if future.done()]

    def _take(self, future: Any) -> None:
        """Pass the result of a task on; an exception becomes a failed arm-night."""
        from distributed import CancelledError, KilledWorker

        if future.status == "lost" or future.cancelled():
            raise CancelledError(future.key)
        _, night = self.tasks.pop(future.key)
        has_begun = self.begun.pop(future.key, None) is not None
        error = future.exception()
        if error is None:
            result = future.result()
            if not _is_same_version(result.version):
                reason = f"worker with version {result.version}; expected {__version__} as here"
                result = NightResult("failed", reason, version=result.version)
            self.finished(night, result)
            return
        if isinstance(error, KilledWorker) and not has_begun:
            self.again[night] += 1
            if self.again[night] <= self.options.losses:
                self._submit(night)
                return
        reason = f"{type(error).__name__}: {reason_of(error)}"
        if isinstance(error, KilledWorker):
            reason = (
                "the worker was lost repeatedly (killed, or out of memory): see --memory and the "
                "logs of the cluster"
            )
        self.finished(night, NightResult("failed", reason))

    def _has_begun(self, event: tuple[float, Mapping[str, str]]) -> None:
        message = event[1]
        self.begun[message["key"]] = time.monotonic(), message["worker"]

    def _give_up(self) -> None:
        """Record arm-nights beyond the timeout as failed, and start their workers again."""
        now = time.monotonic()
        for key, (start, worker) in list(self.begun.items()):
            if key in self.tasks and now - start > self.options.timeout:
                future, night = self.tasks.pop(key)
                del self.begun[key]
                future.cancel(force=True)
                reason = f"not finished after {self.options.timeout:g} s (--timeout)"
                self.finished(night, NightResult("failed", reason, seconds=now - start))
                with contextlib.suppress(Exception):
                    self.client.restart_workers([worker], raise_for_error=False)
