"""Make Ctrl-C always end a verb: callbacks of JAX swallow an interrupt or turn it into an error of another kind."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

INTERRUPTED = 130  # exit status by the convention of shells
_REPEAT_S = 0.25  # seconds after which an interrupt that was swallowed is raised again

_interrupted = False


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise KeyboardInterrupt in the body soon after an interrupt, even if the first exception was swallowed.

    Outside the main thread, where signals cannot be caught, this has no effect. The alarm signal is used only after an interrupt.
    """
    global _interrupted
    _interrupted = False
    try:
        before = signal.signal(signal.SIGINT, _stop)
    except ValueError:  # not the main thread
        yield
        return
    alarm = signal.getsignal(signal.SIGALRM) if hasattr(signal, "SIGALRM") else None
    swallowed, sys.unraisablehook = sys.unraisablehook, _silent
    try:
        with interrupts_alone():
            yield
    finally:
        sys.unraisablehook = swallowed
        if _interrupted and alarm is not None:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, alarm)
        signal.signal(signal.SIGINT, before)


@contextmanager
def interrupts_alone() -> Iterator[None]:
    """Raise any error that follows an interrupt as KeyboardInterrupt."""
    try:
        yield
    except Exception as error:
        if _interrupted:
            raise KeyboardInterrupt from error
        raise


@contextmanager
def resumable(folder: Path | None) -> Iterator[None]:
    """As `interrupts_alone`; the interrupt says from which folder, if any, the same command resumes."""
    try:
        with interrupts_alone():
            yield
    except KeyboardInterrupt as error:
        if folder is None:
            raise
        raise KeyboardInterrupt(f"the same command resumes from {folder}") from error


def _stop(number: int, frame: FrameType | None) -> None:
    global _interrupted
    _interrupted = True
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, _repeat)
        signal.setitimer(signal.ITIMER_REAL, _REPEAT_S, _REPEAT_S)
    raise KeyboardInterrupt


def _repeat(number: int, frame: FrameType | None) -> None:
    """Raise again, unless the first exception is still being handled: its cleanup must not be interrupted."""
    error = sys.exc_info()[1]
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return
        error = error.__context__
    raise KeyboardInterrupt


def _silent(swallowed: sys.UnraisableHookArgs) -> None:
    """Do not print an interrupt that a callback swallowed: it is raised again."""
    if not isinstance(swallowed.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(swallowed)
