"""Ctrl-C that always ends a verb: JAX's callbacks swallow an interrupt or turn it into an error of another kind."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

INTERRUPTED = 130  # exit status, by the custom of shells
_AGAIN = 0.25  # seconds after which an interrupt that went unheard is raised again

_heard = False


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise KeyboardInterrupt from what runs within, soon after an interrupt, whatever became of its first exception.

    Outside the main thread, where no signal can be caught, nothing is changed; without an interrupt, the caller's alarm is its own.
    """
    global _heard
    _heard = False
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
        if _heard and alarm is not None:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, alarm)
        signal.signal(signal.SIGINT, before)


@contextmanager
def interrupts_alone() -> Iterator[None]:
    """After an interrupt, whatever error comes of it is raised as KeyboardInterrupt."""
    try:
        yield
    except Exception as error:
        if _heard:
            raise KeyboardInterrupt from error
        raise


def _stop(number: int, frame: FrameType | None) -> None:
    global _heard
    _heard = True
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, _stop_again)
        signal.setitimer(signal.ITIMER_REAL, _AGAIN, _AGAIN)
    raise KeyboardInterrupt


def _stop_again(number: int, frame: FrameType | None) -> None:
    """Raise once more, unless the first exception is on its way: what it cleans up must not be cut short."""
    error = sys.exc_info()[1]
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return
        error = error.__context__
    raise KeyboardInterrupt


def _silent(swallowed: sys.UnraisableHookArgs) -> None:
    """An interrupt that a callback swallowed is raised again, so nobody need read of it."""
    if not isinstance(swallowed.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(swallowed)
