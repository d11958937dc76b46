"""Independent tasks on several cores, in threads: compilations and linear algebra, most of the time of a fit, run side by side."""

from __future__ import annotations

import concurrent.futures
import contextvars
import os
import threading
from collections.abc import Callable, Sequence
from typing import TypeVar

from hystfit.config import on_device

T = TypeVar("T")
_MOST = 4  # threads: Python itself, which traces models for compilation, runs in one at a time


def usable_cores() -> int:
    """Processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Stopped(BaseException):
    """Ends a task after an interrupt; not an `Exception`, so that no task takes it for a failed fit."""


class Workers:
    """Runs tasks in `count` threads (None: one a core, at most four; 1: that of the caller); the results are in their order."""

    def __init__(self, count: int | None = None):
        self.count = min(usable_cores(), _MOST) if count is None else count
        self._interrupted = threading.Event()

    def check(self) -> None:
        """Called by tasks now and then: ends them after an interrupt."""
        if self._interrupted.is_set():
            raise Stopped

    def run(self, tasks: Sequence[Callable[[], T]]) -> list[T]:
        """What the tasks return; the first error, and an interrupt of the calling thread, end the others at their next `check`."""
        if self.count <= 1 or len(tasks) <= 1:
            return [task() for task in tasks]
        pool = concurrent.futures.ThreadPoolExecutor(min(self.count, len(tasks)), "hystfit")
        try:
            futures = [pool.submit(contextvars.copy_context().run, _on_device, task) for task in tasks]
            done, _ = concurrent.futures.wait(futures, return_when=concurrent.futures.FIRST_EXCEPTION)
            return [future.result() for future in sorted(done, key=futures.index)]
        except BaseException:
            self._interrupted.set()
            raise
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _on_device(task: Callable[[], T]) -> T:
    """A task in a thread, whose default device is not that of the thread that started it."""
    with on_device():
        return task()
