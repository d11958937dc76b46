"""An interrupt ends a verb wherever it falls."""

import os
import signal
import sys
import time
from contextlib import contextmanager

import pytest

from hystfit.cli.interrupts import interruptible, interrupts_alone

pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="Windows raises no signal again"),
    pytest.mark.timeout(method="thread"),  # the alarm is what is tested
]


def interrupt():
    os.kill(os.getpid(), signal.SIGINT)


def busy(seconds):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        pass


@contextmanager
def interrupted():
    """What runs within must end by an interrupt."""
    with pytest.raises(KeyboardInterrupt), interruptible():
        yield


class Swallows:
    """Python ignores what is raised while an object is taken down, as it ignores what JAX's callback of the collector raises."""

    def __del__(self):
        interrupt()


def test_an_interrupt_that_a_callback_swallows_is_raised_again(capsys):
    begun = time.monotonic()
    with interrupted():
        Swallows()
        busy(20.0)
    assert time.monotonic() - begun < 10.0
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("guard", [interruptible, interrupts_alone])
def test_an_interrupt_that_turned_into_another_error_is_one_still(guard):
    with interrupted(), guard():
        try:
            interrupt()
            busy(5.0)
        except KeyboardInterrupt:
            raise RuntimeError("as XLA makes of it") from None


def test_errors_without_an_interrupt_are_left_as_they_are():
    with pytest.raises(RuntimeError, match="own"), interruptible(), interrupts_alone():
        raise RuntimeError("its own")


def test_what_cleans_up_after_an_interrupt_is_not_cut_short():
    cleaned = False
    with interrupted():
        try:
            interrupt()
            busy(5.0)
        finally:
            busy(1.0)
            cleaned = True
    assert cleaned


def test_handlers_are_those_of_before():
    names = (signal.SIGINT, signal.SIGALRM)
    before = [signal.getsignal(name) for name in names], sys.unraisablehook
    with interrupted():
        interrupt()
        busy(5.0)
    assert ([signal.getsignal(name) for name in names], sys.unraisablehook) == before
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)


def test_an_alarm_of_the_caller_is_left_alone():
    rung = []
    before = signal.signal(signal.SIGALRM, lambda *_: rung.append(True))
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.2)
        with interruptible():
            busy(0.5)
    finally:
        signal.signal(signal.SIGALRM, before)
    assert rung == [True]
