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
def progress(what: str) -> Iterator[Callable[[str], None]]:
    """A line on stderr that says what is being done, where stderr is a terminal; yields how to change it."""
    from rich.console import Console
    from rich.markup import escape

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda _: None
        return
    with console.status(escape(what)) as status:
        yield lambda words: status.update(escape(f"{what}: {words}"))


def refuse_unwritable(out: Path | None) -> None:
    """Fail before long work where the result could not be written after it.

    Raises:
        HystfitError: `out` cannot be written.
    """
    if out is not None:
        from hystfit.saved import check_writable

        check_writable(out)
