"""`hystfit invert` and `hystfit export`."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from hystfit.cli.options import Reading
from hystfit.cli.output import progress, refuse_unwritable, show
from hystfit.errors import DataError
from hystfit.outcome import Code

if TYPE_CHECKING:
    from hystfit.control.bands import InverseBands
    from hystfit.control.inverse import Inverse
    from hystfit.data.record import Record

Json = Annotated[bool, Parameter(name="--json")]
Between = Annotated[str | None, Parameter(name="--limits")]


def invert(
    fitdir: Path,
    reference: str,
    /,
    *,
    between: Between = None,
    reading: Reading = Reading(),  # noqa: B008  (frozen)
    out: Path | None = None,
    json: Json = False,
) -> int:
    """Find the input that makes a fitted model follow a reference, with a status for every sample.

    Of what `hystfit sample --out` wrote, it also gives 90 % bands: of the input over the draws, and of the error with which
    the input found for the fit would be followed if a draw were the truth.

    Args:
        fitdir: what `hystfit fit --out` or `hystfit sample --out` wrote.
        reference: file with the wanted output (--output names its column) and, where the model needs it, time.
        between: lowest and highest input as low:high; the range of the fit where not given.
        reading: how the file is read.
        out: folder for result.json and inverse.csv.
        json: print result.json alone.
    """
    from hystfit.control.inverse import invert as solve
    from hystfit.data.record import Dataset
    from hystfit.results.result import provenance
    from hystfit.results.saved import load_fit

    sampled = (fitdir / "posterior.nc").is_file()
    result = load_fit(fitdir / "fit" if sampled else fitdir)
    refuse_unwritable(out)
    data = _wanted(reference, reading)
    edges = _edges(between)
    dt = data.dt if data.t is not None else None
    bands = _bands(fitdir, data.y, dt, edges) if sampled else None
    found = solve(result, data.y, dt, limits=edges) if bands is None else bands.given
    content = {
        "schema": "hystfit.invert/1",
        "model": result.name,
        "status": "ok" if found.ok else "missed",
        "notes": list(found.notes()),
        "reading": [note.to_dict() for note in data.notes],
        "counts": found.counts(),
        "input": {"lowest": float(found.u.min()), "highest": float(found.u.max())},
        "units": {"input": result.data.units["u"] or None, "output": result.data.units["y"] or None},
        "bands": None if bands is None else _banded(bands),
        "fit": {"folder": str(fitdir), "status": result.status, "provenance": result.provenance},
        "provenance": provenance(Dataset.of(data), None),
    }
    counts = ", ".join(f"{count} {name}" for name, count in found.counts().items() if count)
    units = result.data.units
    span = f"{found.u.min():.4g} to {found.u.max():.4g} {units['u']}".rstrip()
    words = [f"{result.name} inverted over {data.name}: {counts}; input {span}"]
    words += [f"  - {note}" for note in found.notes()]
    words += [f"  - {note}" for note in data.notes if note.code is Code.LEFT_OUT]
    if bands is not None:
        told = content["bands"]
        u_unit, y_unit = (f" {unit}" if unit else "" for unit in (units["u"], units["y"]))
        words.append(
            f"  - over {told['draws']} draws of the posterior: input within {told['input_width']:.3g}{u_unit} of each other "
            f"(90 %, widest), rms tracking error {told['rms_error']['median']:.3g}{y_unit}, 95 % of them below "
            f"{told['rms_error']['upper']:.3g}{y_unit}"
        )
    if out is not None:
        _write_inverse(out, data, found, content, bands, units)
        words.append(f"Written to {out}: inverse.csv, result.json")
    show("\n".join(words), content, json)
    return 0 if found.ok else 1


def _bands(folder: Path, reference: Any, dt: Any, edges: tuple[float, float] | None) -> InverseBands:
    from hystfit.control.bands import inverse_bands
    from hystfit.sampling.posterior import load_posterior

    with progress("inverting by draws"):
        return inverse_bands(load_posterior(folder), reference, dt, limits=edges)


def _banded(bands: InverseBands) -> dict[str, Any]:
    """Bands in result.json."""
    import numpy as np

    low, _, high = bands.band("u")
    return {
        "draws": len(bands.u),
        "level": 0.9,
        "input_width": float(np.max(high - low)),
        "rms_error": {"median": float(np.median(bands.rms)), "upper": float(np.quantile(bands.rms, 0.95))},
        "draws_that_missed": int(np.count_nonzero(bands.missed)),
    }


def _edges(between: str | None) -> tuple[float, float] | None:
    if between is None:
        return None
    try:
        low, high = (float(part) for part in between.split(":"))
    except ValueError:
        raise DataError(f"--limits needs both ends as low:high, such as 0:120; got {between!r}") from None
    if not low < high:
        raise DataError(f"--limits must rise, low:high; got {between!r}")
    return low, high


def _wanted(reference: str, reading: Reading) -> Record:
    """The one record of a file with a reference: its input column is not there, and counts for nothing."""
    import numpy as np

    from hystfit.data.record import Dataset
    from hystfit.reading.read import assemble, table_of

    if reading.input is not None:
        raise DataError("a reference has no input: name its column with --output")
    if not Path(reference).is_file():
        raise DataError(f"no file {reference!r} with a reference")
    options = dataclasses.asdict(reading)
    table = table_of(reference, **{key: options.pop(key) for key in ("sheet", "delimiter", "decimal", "encoding")})
    blank = "no input"
    columns = (*table.columns, np.arange(float(table.rows)))
    table = dataclasses.replace(table, names=(*table.names, blank), units=(*table.units, ""), columns=columns)
    data = Dataset.of(assemble(table, **{**options, "input": blank}))
    if len(data) != 1:
        raise DataError(f"{reference!r} holds {len(data)} curves: choose one with --only")
    return data[0]


def _write_inverse(
    out: Path,
    data: Record,
    found: Inverse,
    content: dict[str, Any],
    bands: InverseBands | None,
    units: dict[str, str],
) -> None:
    import csv

    from hystfit.results.saved import dump_json, writing

    timed = data.t is not None
    with writing(out) as scratch:
        dump_json(scratch / "result.json", content)
        with (scratch / "inverse.csv").open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file)
            edges = [] if bands is None else [edge for of in ("u", "error") for edge in bands.band(of)[::2]]
            u, y = (f"_{units[role]}" if units[role] else "" for role in ("u", "y"))
            t = [f"t_{data.t_unit}" if data.t_unit else "t"] if timed else []
            more = [] if bands is None else [f"u_lower{u}", f"u_upper{u}", f"error_lower{y}", f"error_upper{y}"]
            writer.writerow([*t, f"reference{y}", f"u{u}", f"y{y}", "status", *more])
            for k, status in enumerate(found.status):
                numbers = [data.y[k], found.u[k], found.y[k]]
                when = [repr(float(data.t[k]))] if data.t is not None else []
                rest = [repr(float(edge[k])) for edge in edges]
                writer.writerow([*when, *(repr(float(x)) for x in numbers), status, *rest])


def export(
    fitdir: Path,
    /,
    *,
    c: Path,
    name: str = "hysteresis",
    between: Between = None,
) -> int:
    """Write a fitted model and its inverse as C99 with fixed memory, and a test harness.

    Args:
        fitdir: what `hystfit fit --out` wrote.
        c: folder for the C files.
        name: prefix of files and functions.
        between: lowest and highest input of the inverse as low:high; the range of the fit where not given.
    """
    from hystfit.control.export import export_c
    from hystfit.results.saved import load_fit

    edges = _edges(between)
    refuse_unwritable(c)
    files = export_c(load_fit(fitdir), c, name=name, limits=edges)
    print(f"Written to {c}: {', '.join(file.name for file in files)}")
    print(f"Try it: cc -std=c99 -O2 {files[1]} {files[2]} -lm -o {name}")
    return 0
