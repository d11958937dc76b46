"""`hystfit explore`: the page with sliders for a measured loop."""

from __future__ import annotations

import threading
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING

from hystfit.cli.interrupts import INTERRUPTED
from hystfit.cli.options import DEFAULT_READING, Loop, Reading, changed, command_words, named_values
from hystfit.cli.records import load
from hystfit.cli.verbs import as_options
from hystfit.cli.write import progress
from hystfit.reading import datasets

if TYPE_CHECKING:
    from hystfit.data.record import Record
    from hystfit.explorer.session import Source


def explore(
    loop: Loop,
    /,
    *,
    model: str = "auto",
    at: list[str] | None = None,
    port: int = 0,
    no_browser: bool = False,
    reading: Reading = DEFAULT_READING,
) -> int:
    """Open a page with a slider for each parameter of a model, beside a measured loop; Ctrl-C ends it.

    Only this machine can open the page, and its address holds a random token.

    Args:
        loop: file or name of a data set with one record.
        model: the first model; auto takes one with few parameters that suits the loop. The page offers others.
        at: initial value of a parameter, as NAME=VALUE; repeatable.
        port: port of the local server; 0 takes a free one.
        no_browser: print the address only.
    """
    from hystfit.explorer.session import Session
    from hystfit.explorer.widget import Explorer, single

    values = named_values(at or [], "--at")
    with progress("reading"):
        record = single(load([loop], reading))
        page = Explorer(
            Session(record, model, start=values, source=_source(loop, record, reading), translate=as_options), port
        )
    try:
        with page:
            print(f"{record.name}: {page.url}\nCtrl-C ends the explorer", flush=True)
            if not no_browser:
                webbrowser.open(page.url)
            threading.Event().wait()
    except KeyboardInterrupt:
        pass
    return INTERRUPTED


def _source(loop: str, record: Record, reading: Reading) -> Source:
    """How the record is read again at the shell and in Python."""
    from hystfit.explorer.session import Source

    options, shell = changed(reading), command_words([loop], reading)
    call = lambda names: ", ".join(f"{name}={options[name]!r}" for name in options if name in names)
    if Path(loop).exists() or loop not in datasets.names():
        arguments = ", ".join(filter(None, [repr(loop), call(options)]))
        return Source(shell, f"record = hf.read({arguments})")
    whole = f"hf.datasets.load({loop!r})" + (f"[{record.name!r}]" if "only" in options else "")
    if treated := call(set(options) - {"only"}):
        imported = "from hystfit.reading.treatment import Treatment\n"
        return Source(shell, f"{imported}record = Treatment({treated}).of({whole})")
    return Source(shell, f"record = {whole}")
