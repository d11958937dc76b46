"""Chunks of replicates: computed here, in processes or on Dask workers, kept in a folder as they come, and gone on from."""

from __future__ import annotations

import concurrent.futures
import multiprocessing
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hystfit.errors import DataError, HystfitError, MissingExtraError
from hystfit.sampling.chunks import claim, keep, load
from hystfit.uncertainty.replicates import CHUNK, Study, broken_chunk, run_chunk

if TYPE_CHECKING:
    from distributed import Client, Future

Chunk = dict[str, np.ndarray]
Outcome = tuple[int, Chunk | Exception]
# Seconds to wait for a scheduler and for a running worker; a killed worker is restarted sooner.
_PATIENCE = 30.0
_PAUSE = 0.2  # seconds between two looks at tasks on their way
_GO_ON = "the same call goes on from the chunks that its folder holds, where it was given one"


def collect(
    study: Study,
    count: int,
    folder: str | Path | None,
    workers: int,
    scheduler: str | None,
    progress: Callable[[str], None] | None,
) -> tuple[list[Chunk], list[str]]:
    """`count` chunks in order, and a sentence on each that broke; a chunk that broke is not kept, so that the same call tries it again.

    Raises:
        DataError: the folder holds another study.
        HystfitError: settings that cannot be used, or a missing extra.
    """
    place = None if folder is None else _claim(Path(folder), study)
    done = {} if place is None else {k: chunk for k in range(count) if (chunk := _load(_file(place, k))) is not None}
    missing = [k for k in range(count) if k not in done]
    broken = []
    for k, outcome in _computed(study, missing, workers, scheduler):
        if isinstance(outcome, Exception):
            broken.append(f"chunk {k} broke: {type(outcome).__name__}: {outcome}")
            done[k] = broken_chunk(study)
        else:
            done[k] = outcome
            if place is not None:
                keep(_file(place, k), outcome)
        if progress:
            progress(f"{len(done)} of {count} chunks of {CHUNK} replicates")
    return [done[k] for k in sorted(done)], broken


def _file(place: Path, k: int) -> Path:
    return place / f"chunk-{k:05d}.npz"


def _load(file: Path) -> Chunk | None:
    """A stored chunk; None where there is none, or a damaged one."""
    outcome = load(file)
    return outcome if outcome is not None and set(outcome) == {"ranks", "errors", "reason"} else None


def _computed(study: Study, numbers: Sequence[int], workers: int, scheduler: str | None) -> Iterator[Outcome]:
    if scheduler is not None:
        yield from _by_dask(study, numbers, scheduler)
    elif workers > 1 and len(numbers) > 1:
        context = multiprocessing.get_context("spawn")  # a process forked after JAX has started can hang
        with concurrent.futures.ProcessPoolExecutor(workers, mp_context=context) as pool:
            tasks = {pool.submit(run_chunk, study, k): k for k in numbers}
            for task in concurrent.futures.as_completed(tasks):
                yield tasks[task], _outcome(task.result)
    else:
        for k in numbers:
            yield k, _outcome(lambda k=k: run_chunk(study, k))


def _by_dask(study: Study, numbers: Sequence[int], scheduler: str) -> Iterator[Outcome]:
    try:
        from distributed import Client
    except ImportError as error:
        raise MissingExtraError("distributed", "batch", "scheduler=") from error
    try:
        _knock(scheduler)
        client = Client(scheduler)
    except (OSError, ValueError) as error:
        raise DataError(f"no Dask scheduler answers at {scheduler!r}: {error}") from error
    with client:
        tasks = {client.submit(run_chunk, study, k, pure=False): k for k in numbers}
        for task in _finished(client, set(tasks), scheduler):
            yield tasks[task], _outcome(partial(task.result, _PATIENCE))  # its worker may have left with it


def _finished(client: Client, waiting: set[Future], address: str) -> Iterator[Future]:
    """Tasks as they end. A scheduler keeps what no worker takes for ever: where none runs for long, that is an error."""
    alone = time.monotonic()
    while waiting:
        time.sleep(_PAUSE)
        running = client.status == "running" and _running(client)
        if any(task.cancelled() for task in waiting):  # a client's tasks go with its connection
            raise DataError(f"the Dask scheduler at {address!r} was lost; {_GO_ON}")
        ended = {task for task in waiting if task.done()}
        yield from ended
        waiting = waiting - ended
        if running or ended:
            alone = time.monotonic()
        elif time.monotonic() - alone > _PATIENCE:
            raise DataError(
                f"the Dask scheduler at {address!r} has no workers that run: start some (dask worker ADDRESS); {_GO_ON}"
            )


def _running(client: Client) -> bool:
    """Whether any worker takes tasks; false while a scheduler that shuts down does not answer."""
    try:
        workers = client.scheduler_info(n_workers=-1).get("workers", {})
    except OSError:
        return False
    return any(worker["status"] == "running" for worker in workers.values())


def _knock(scheduler: str) -> None:
    """A client that finds nobody tries for half a minute, and again when it is thrown away: see whether anybody listens first."""
    from distributed.comm.addressing import get_address_host_port, parse_address
    from distributed.comm.registry import get_backend

    scheme, _ = parse_address(scheduler)
    get_backend(scheme)  # raises ValueError for an unknown scheme
    if scheme in ("tcp", "tls"):
        socket.create_connection(get_address_host_port(scheduler), timeout=_PATIENCE).close()


def _outcome(result: Callable[[], Chunk]) -> Chunk | Exception:
    """A chunk, or why there is none; what the user has to mend is raised."""
    try:
        return result()
    except HystfitError:
        raise
    except Exception as error:  # a worker that was killed, out of memory: recorded, and the other chunks go on
        return error


def _claim(folder: Path, study: Study) -> Path:
    """The folder of a study, new or of the same one."""
    from hystfit.models.storage import to_json

    values = {k: np.asarray(v).tolist() for k, v in vars(study.truth).items() if hasattr(v, "shape")}
    described = {k: getattr(study, k) for k in ("assumed", "method", "spread", "fix", "free", "seed")}
    priors = {k: v.exact() for k, v in study.priors.items()}
    described = {"model": to_json(study.model), "truth": [study.truth.name, values], "priors": priors, **described}
    return claim(folder, "study.json", described | {"inputs": [record.digest() for record in study.data]})
