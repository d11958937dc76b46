"""What a verb writes: its folder, its text or JSON on stdout, progress on a terminal, and its exit status."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hystfit.cli.options import Output
from hystfit.cli.verbs import as_options
from hystfit.outcome import Status
from hystfit.outcome.progress import progress as progress
from hystfit.outcome.table import write_csv as write_csv
from hystfit.outcome.table import write_rows as write_rows
from hystfit.outcome.wrapping import PROSE, within

if TYPE_CHECKING:
    from hystfit.data.dataset import Dataset
    from hystfit.data.record import Record
    from hystfit.results.webpage import Page

_NARROW = 40  # columns below which wrapped text is not readable either


def finish(
    text: str,
    content: dict[str, Any],
    output: Output,
    save: Callable[[Path], object] | None = None,
    *,
    status: str = "",
    page: Callable[[Path], Page] | None = None,
) -> int:
    """Write the folder of a verb, all files or none, print its text or JSON, and return its exit status.

    Args:
        page: makes report.html and its pictures, from the folder as the user named it; None where there is none, or `save` writes it.
        status: decides the exit status, 0 where the result is usable, else 1; default: that of `content`.
    """
    if output.out is not None:
        from hystfit.results.saving.folders import dump_json, writing

        with progress("writing"), writing(output.out) as scratch:
            dump_json(scratch / "result.json", content)
            if save is not None:
                save(scratch)
            if page is not None:
                page(output.out).write(scratch)
            names = sorted(path.name for path in scratch.iterdir() if not path.name.startswith("."))
        if pyplot := sys.modules.get("matplotlib.pyplot"):
            pyplot.close("all")
        text += written(output.out, names)
    show(text, content, output.json)
    return 0 if Status(status or content.get("status", "ok")).usable else 1


def finish_table(
    text: str,
    content: dict[str, Any],
    output: Output,
    name: str,
    columns: Mapping[str, Any],
    truth: Mapping[str, Any] | None = None,
) -> int:
    """Write columns as CSV with ten significant digits (or as netCDF), print the text or JSON, and return exit status 0.

    Args:
        content: of result.json, which is written where `out` is a folder.
        output: `out` is the file itself where it ends in a suffix, .nc for netCDF, else a folder.
    """
    out = output.out
    if out is None or out.is_dir() or not out.suffix:

        def save(folder: Path) -> None:
            write_csv(folder / f"{name}.csv", columns, ".10g")
            if truth is not None:
                write_csv(folder / "truth.csv", truth, ".10g")

        return finish(text, content, output, save)
    from hystfit.results.exchange import write_table
    from hystfit.results.saving.folders import writing_file

    with writing_file(out) as file:
        if out.suffix == ".nc":
            write_table(file, tuple, lambda: _dataset(columns))
        else:
            write_csv(file, columns, ".10g")
        if truth is not None:
            write_csv(file.with_suffix(".truth.csv"), truth, ".10g")
            text += f"\nTrue parameters in {out.with_suffix('.truth.csv')}"
    return finish(f"{text}\nWritten to {out}", content, Output(json=output.json))


def written(folder: Path, names: Sequence[str]) -> str:
    """A line that names the files written; more than six pictures are counted."""
    pictures = [name for name in names if name.endswith((".png", ".svg"))]
    if len(pictures) > 6:
        names = [*(name for name in names if name not in pictures), f"{len(pictures)} pictures"]
    return f"\nWritten to {folder}: {', '.join(names)}"


def show(text: str, content: dict[str, Any], as_json: bool) -> None:
    """Print the text, or the content of result.json alone; a closed pipe (head, less) does not change the exit status.

    On a terminal the prose wraps within its width. Elsewhere each note stays one line, for programs that read lines.
    """
    text = as_options(text) if terminal_width() is None else within(as_options(text), prose_width())
    try:
        print(json.dumps(content, indent=1, allow_nan=False) if as_json else text, flush=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def terminal_width() -> int | None:
    """Columns of the terminal that shows stdout; None where stdout is a file or a pipe."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def prose_width() -> int:
    """Columns in which prose is shown: those of the terminal, within limits; without a terminal the limit."""
    return max(_NARROW, min(PROSE, terminal_width() or PROSE))


def items(notes: Iterable[object]) -> list[str]:
    """Notes as lines of a text."""
    return [f"  - {note}" for note in notes]


def named(name: str, unit: str) -> str:
    """Heading of a column of a CSV file: u_V; a unit that the name already has is not repeated."""
    from hystfit.params.units import without_unit

    return f"{without_unit(name, unit)}_{unit}" if unit else name


def write_input(path: Path, like: Record, u: Sequence[float], step: float | None) -> None:
    """An input that is proposed, in the columns of a record: at a time step, or without time."""
    time = {} if step is None else {named("t", like.t_unit): [k * step for k in range(len(u))]}
    write_csv(path, time | {named(like.u_name, like.u_unit): u}, ".9g")


def _dataset(columns: Mapping[str, Iterable[Any]]) -> Any:
    """Columns by heading as an xarray data set over the dimension "sample"."""
    import xarray

    return xarray.Dataset({name: ("sample", list(values)) for name, values in columns.items()})


def record_columns(data: Dataset, output: str = "y", y_unit: str = "") -> dict[str, Any]:
    """Columns of records for a CSV file, one record after another: record (where there are several), time, input, output.

    Args:
        output: heading of the output; samples without weight are missing under any other heading than "y".
    """
    import numpy as np

    units = data.units
    columns: dict[str, Any] = {}
    if len(data) > 1:
        columns["record"] = [record.name for record in data for _ in range(len(record))]
    if all(record.t is not None for record in data):
        columns[named("t", units["t"])] = np.concatenate([record.t for record in data])
    columns[named("u", units["u"])] = np.concatenate([record.u for record in data])
    y = [record.y if output == "y" else np.where(record.used, record.y, np.nan) for record in data]
    return columns | {named(output, units["y"] or y_unit): np.concatenate(y)}
