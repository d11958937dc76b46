"""Independent tasks of a long run, computed here, in processes or on Dask workers."""

from __future__ import annotations

import concurrent.futures
import multiprocessing
import multiprocessing.connection
import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from hystfit.errors import DataError, HystfitError, optional

if TYPE_CHECKING:
    from distributed import Client, Future

Task = Callable[[Any], Any]
Outcome = tuple[int, Any]
# Seconds to wait for a scheduler and for a running worker; a killed worker is restarted sooner.
_PATIENCE = 30.0
_RESUMES = "the same call resumes where it was given a folder"


def computed(task: Task, items: Sequence[Any], workers: int = 1, scheduler: str | None = None) -> Iterator[Outcome]:
    """Number and outcome of each item as they end: what `task(item)` returned, or the exception that ended it.

    One worker is this process, several are processes on this machine; a scheduler is one of Dask, which raises a `DataError` where it does
    not answer, or is lost. Errors that the user has to correct are raised at once.
    """
    if scheduler is not None:
        yield from _by_dask(task, items, scheduler)
    elif workers > 1 and len(items) > 1:
        yield from _by_processes(task, items, workers)
    else:
        for k, item in enumerate(items):
            yield k, _outcome(partial(task, item))


def _by_processes(task: Task, items: Sequence[Any], workers: int) -> Iterator[Outcome]:
    context = multiprocessing.get_context("spawn")  # a process forked after JAX has started can hang
    pool = concurrent.futures.ProcessPoolExecutor(min(workers, len(items)), context, _follow_parent)
    try:
        tasks = {pool.submit(task, item): k for k, item in enumerate(items)}
        for ended in concurrent.futures.as_completed(tasks):
            yield tasks[ended], _outcome(ended.result)
    except BaseException:  # an interrupt does not wait for the tasks that are left
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


def _follow_parent() -> None:
    """Leave interrupts to the parent of this process, and end when it is killed: tasks would be awaited forever."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.setdefault("JAX_PLATFORMS", "cpu")  # several processes would each reserve most of the memory of a GPU
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        multiprocessing.connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _by_dask(task: Task, items: Sequence[Any], scheduler: str) -> Iterator[Outcome]:
    distributed = optional("distributed", "batch", "scheduler=")
    try:
        _check_scheduler(scheduler)
        client = distributed.Client(scheduler)
    except (OSError, ValueError) as error:
        raise DataError(f"no Dask scheduler answers at {scheduler!r}: {error}") from error
    with client:
        tasks = {client.submit(task, item, pure=False): k for k, item in enumerate(items)}
        for ended in _finished(client, set(tasks), scheduler):
            yield tasks[ended], _outcome(partial(ended.result, _PATIENCE))  # its worker may have left with it


def _finished(client: Client, waiting: set[Future], address: str) -> Iterator[Future]:
    """Yield tasks as they end; a scheduler without running workers for long is an error."""
    alone = time.monotonic()
    while waiting:
        time.sleep(0.2)
        running = client.status == "running" and _running(client)
        if any(task.cancelled() for task in waiting):  # a client's tasks go with its connection
            raise DataError(f"the Dask scheduler at {address!r} was lost; {_RESUMES}")
        ended = {task for task in waiting if task.done()}
        yield from ended
        waiting = waiting - ended
        if running or ended:
            alone = time.monotonic()
        elif time.monotonic() - alone > _PATIENCE:
            raise DataError(
                f"the Dask scheduler at {address!r} has no workers that run: start some (dask worker ADDRESS); {_RESUMES}"
            )


def _running(client: Client) -> bool:
    """Whether any worker takes tasks; false while a scheduler that shuts down does not answer."""
    try:
        workers = client.scheduler_info(n_workers=-1).get("workers", {})
    except OSError:
        return False
    return any(worker["status"] == "running" for worker in workers.values())


def _check_scheduler(scheduler: str) -> None:
    """Check that a scheduler listens: a Dask client without one retries for half a minute, and again when it is closed."""
    from distributed.comm.addressing import get_address_host_port, parse_address
    from distributed.comm.registry import get_backend

    scheme, _ = parse_address(scheduler)
    get_backend(scheme)  # raises ValueError for an unknown scheme
    if scheme in ("tcp", "tls"):
        socket.create_connection(get_address_host_port(scheduler), timeout=_PATIENCE).close()


def _outcome(result: Callable[[], Any]) -> Any:
    """What a task returned, or the exception that ended it; an error that the user has to correct is raised."""
    try:
        return result()
    except HystfitError:
        raise
    except Exception as error:  # a worker that was killed, out of memory: recorded, and the other tasks go on
        return error
