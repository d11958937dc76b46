"""What verbs print: text or JSON on stdout, progress on stderr where somebody watches."""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any


def show(text: str, content: dict[str, Any], as_json: bool) -> None:
    """Print the text, or the content of result.json alone; a reader that stops early (head, less) changes no status."""
    try:
        print(json.dumps(content, indent=1, allow_nan=False) if as_json else text, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextlib.contextmanager
def progress(what: str) -> Iterator[Callable[..., None]]:
    """A line on stderr that says what is being done, where stderr is a terminal; yields how to change it.

    It is called with words, and with the part that is done (0 to 1) where that is known: then a bar shows it.
    """
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda *_: None
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    bar = (SpinnerColumn(), BarColumn(30), TaskProgressColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True) as shown:
        task = shown.add_task(escape(what), total=None)

        def say(words: str, part: float | None = None) -> None:
            if part is not None:
                shown.columns = bar
            shown.update(
                task, description=escape(f"{what}: {words}"), total=None if part is None else 1.0, completed=part or 0.0
            )

        yield say


def refuse_unwritable(out: Path | None, *, fit: bool = False) -> None:
    """Fail before long work where the result could not be written after it, or would take the place of a fit.

    Args:
        out: folder for results.
        fit: what is written is a fit, or stands beside it.

    Raises:
        HystfitError: `out` cannot be written, or holds a fit.
    """
    if out is None:
        return
    from hystfit.errors import HystfitError
    from hystfit.results.saved import check_writable, holds_fit

    check_writable(out)
    if not fit and holds_fit(out):
        raise HystfitError(f"{str(out)!r} holds a fit, whose result.json would be lost: choose another folder")
