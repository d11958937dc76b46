"""Progress of long computations on stderr: a line rewritten in place on a terminal or in a notebook, else a line now and then."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

Update = Callable[..., None]
_LINE = 110  # characters of a line in a notebook
_SHARE, _SOON, _LATE = 0.1, 5.0, 30.0  # a line in a log at each tenth, not before 5 s, and after 30 s at the latest


@contextlib.contextmanager
def progress(task: str) -> Iterator[Update]:
    """A line on stderr that shows the task; yields a function that updates it.

    The function takes a text, and the fraction that is done (0 to 1) where it is known, which is shown as a bar. Where stderr is
    a file or a pipe, long tasks write a line at each tenth that is done, or every 30 s.
    """
    from rich.console import Console

    console = Console(stderr=True)
    if console.is_jupyter:
        with _in_notebook(task) as update:
            yield update
    elif console.is_terminal:
        with _on_terminal(task, console) as update:
            yield update
    else:
        yield _in_a_log(task)


def _in_a_log(task: str, clock: Callable[[], float] = time.monotonic) -> Update:
    """A function that writes some of its calls as lines."""
    started = before = clock()
    written = 0.0  # fraction of the last line

    def update(text: str, fraction: float | None = None) -> None:
        nonlocal before, written
        now, done = clock(), written if fraction is None else fraction
        if now - before >= _LATE or (done - written >= _SHARE - 1e-9 and now - before >= _SOON):
            share = "" if fraction is None else f" {100 * fraction:.0f} %,"
            print(f"{task}:{share} {text} ({now - started:.0f} s)", file=sys.stderr, flush=True)
            before, written = now, done

    return update


@contextlib.contextmanager
def _in_notebook(task: str) -> Iterator[Update]:
    """One line of the cell's output, rewritten in place and cleared at the end; rich would need a widget for this."""
    started = time.perf_counter()

    def write(line: str) -> None:
        sys.stderr.write("\r" + line[:_LINE].ljust(_LINE))
        sys.stderr.flush()

    def update(text: str, fraction: float | None = None) -> None:
        share = "" if fraction is None else f"{100 * fraction:3.0f} % "
        write(f"{share}{task}: {text} ({time.perf_counter() - started:.0f} s)")

    write(task)
    try:
        yield update
    finally:
        write("")
        sys.stderr.write("\r")


@contextlib.contextmanager
def _on_terminal(task: str, console: Any) -> Iterator[Update]:
    from rich.markup import escape
    from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    bar = (SpinnerColumn(), BarColumn(30), TaskProgressColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as display:
        line = display.add_task(escape(task), total=None)

        def update(text: str, fraction: float | None = None) -> None:
            if fraction is not None:
                display.columns = bar
            total = None if fraction is None else 1.0
            display.update(line, description=escape(f"{task}: {text}"), total=total, completed=fraction or 0.0)

        yield update


class ShownProgress:
    """Progress of models that are fitted side by side: each line names a model, its step, and how many are done."""

    def __init__(self, update: Callable[..., object], names: Sequence[str]):
        self._update, self._names, self._done, self._lock = update, set(names), set[str](), threading.Lock()
        update(f"{len(names)} to try: {', '.join(names)}", 0.0)

    def step(self, name: str, text: str) -> None:
        """Report the step that a model has reached."""
        with self._lock:
            self._show(name, text)

    def done(self, name: str) -> None:
        """Report that a model is finished; one that is fitted again counts once."""
        with self._lock:
            self._done.add(name)
            self._show(name, f"done ({len(self._done)} of {len(self._names | self._done)})")

    def _show(self, name: str, text: str) -> None:
        self._names.add(name)  # models join on the way
        self._update(f"{name}: {text}", len(self._done) / len(self._names))
