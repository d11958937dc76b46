"""`hystfit check`, `hystfit predict` and `hystfit report`."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from hystfit.cli.loading import load
from hystfit.cli.options import SPLIT, Part, Reading, limits
from hystfit.cli.output import progress, refuse_unwritable, show
from hystfit.errors import DataError

if TYPE_CHECKING:
    from hystfit.data.record import Dataset, Record
    from hystfit.results.result import FitResult

Json = Annotated[bool, Parameter(name="--json")]


def check(
    loop: str,
    /,
    *,
    preisach: bool = False,
    reading: Reading = Reading(),  # noqa: B008  (frozen)
    out: Path | None = None,
    json: Json = False,
) -> int:
    """Say what a record holds, what is wrong with it, and which models it can determine.

    Args:
        loop: file or data set.
        preisach: also measure what a Preisach model presumes: wiping-out, congruency, higher-order reversals, and of a family of
            reversal curves that they neither cross nor end apart; the exit status is then 1 where the data can test none of them.
        out: folder for result.json and check.txt.
        json: print result.json alone.
    """
    from hystfit.models.data_check import check as judge
    from hystfit.results.result import provenance

    refuse_unwritable(out)
    data = load(loop, reading)
    with progress("checking"):
        found = judge(data)
    able = [item.model for item in found.determines if item.verdict != "no" and item.model != "creep"]
    content = {"schema": "hystfit.check/1", "status": "ok" if able else "no-model", **found.to_dict()}
    content["reading"] = {record.name: [note.to_dict() for note in record.notes] for record in data}
    content["provenance"] = provenance(data, None)
    notes = [f"  - {note}" for note in dict.fromkeys(note for record in data for note in record.notes)]
    text = "\n".join([found.text().rstrip(), *(["", "How it was read", *notes] if notes else [])])
    if preisach:
        words, content["preisach"] = _properties(data)
        text += f"\n\n{words}"
    if out is not None:
        from hystfit.results.saved import dump_json, writing

        with writing(out) as scratch:
            dump_json(scratch / "result.json", content)
            (scratch / "check.txt").write_text(text + "\n", encoding="utf-8")
    show(text, content, json)
    usable = content["preisach"]["status"] != "untested" if preisach else bool(able)
    return 0 if usable else 1


_SHOWN = 8  # most findings of Preisach properties that are printed


def _properties(data: Dataset) -> tuple[str, dict[str, Any]]:
    """Preisach properties of every record: as text, and for result.json."""
    from hystfit.models.preisach import check_preisach
    from hystfit.quality.reversal_curves import recognize_family

    with progress("measuring Preisach properties"):
        checks = [check_preisach(record, model=True) for record in data]
    tested = [found for found in checks if found.tested]
    failed = any(outcome == "fails" for found in tested for outcome in found.outcomes.values())
    status = "untested" if not tested else "fails" if failed else "holds"
    groups: dict[str, list[str]] = {}  # records of which the same is to be said
    for found in tested or checks:
        groups.setdefault(found.text(), []).append(found.record)
    family = recognize_family(data)
    lines = ["Preisach properties (limit: 2 % of the output's range)"]
    if family is not None:
        status = "holds" if status == "untested" and not family.notes else "fails" if family.notes else status
        lines += [f"  {family.words()}", *(f"    - {note}" for note in family.notes)]
        if not family.notes:
            lines.append("    - they neither cross nor end apart: masses >= 0 can follow them")
    for text, names in list(groups.items())[:_SHOWN]:
        more = f" and {len(names) - 5} more" if len(names) > 5 else ""
        lines += [f"  {', '.join(names[:5])}{more}", text]
    if not tested and family is None:
        lines.append("  Nothing here speaks for or against a Preisach model: measure a record with nested loops.")
    if len(groups) > _SHOWN:
        lines.append(f"  (the other records are in result.json: {len(groups) - _SHOWN})")
    return "\n".join(lines), {"status": status, "records": {found.record: found.to_dict() for found in checks}}


def report(folder: Path, /, *, out: Path | None = None, json: Json = False) -> int:
    """Print the report of a saved fit, and draw its pictures and HTML page anew.

    Args:
        folder: what `hystfit fit --out` wrote.
        out: another folder for the report; the fit's own where not given.
        json: print result.json alone.
    """
    from hystfit.results.report import text_report, write
    from hystfit.results.saved import load_fit

    result = load_fit(folder)
    target = out or folder
    refuse_unwritable(target, fit=True)
    with progress("drawing"):
        write(result, target)
    show(f"{text_report(result)}\nWritten to {target}: report.html, pictures", result.to_dict(), json)
    return 0 if result.usable else 1


def predict(
    fitdir: Path,
    loop: str,
    /,
    *,
    input_only: Annotated[bool, Parameter(group=SPLIT)] = False,
    window: Part = None,
    refit_offset: Annotated[bool, Parameter(group=SPLIT)] = False,
    reading: Reading = Reading(),  # noqa: B008  (frozen)
    out: Path | None = None,
    json: Json = False,
) -> int:
    """Run a fitted model over the input of a record, and compare with its output where there is one.

    Args:
        fitdir: what `hystfit fit --out` wrote.
        loop: file or data set.
        input_only: the file has no output: predict it (give --input, and --time).
        window: compare samples in start:stop only.
        refit_offset: shift the prediction to the mean of the measurement (another zero of the sensor).
        out: folder for result.json, prediction.csv and a picture.
        json: print result.json alone.
    """
    from hystfit.results.saved import load_fit

    result = load_fit(fitdir)
    refuse_unwritable(out)
    data = _inputs(loop, reading) if input_only else load(loop, reading)
    part = limits(window)
    if part is not None:
        data = data.map(lambda record: record.window(*part))
    runs = [result.predict(record, refit_offset=refit_offset) for record in data]
    content = _compared(result, data, runs, fitdir, refit_offset)
    if out is not None:
        _write_prediction(out, result, data, runs, content, refit_offset)
    show(_prediction_words(content, data, out), content, json)
    return 0 if content["status"] == "ok" else 1


def _inputs(loop: str, reading: Reading) -> Dataset:
    """Records of a file without output: none of their samples counts."""
    import numpy as np

    from hystfit.data.record import Dataset
    from hystfit.reading.read import assemble, table_of

    if reading.output is not None:
        raise DataError("--output and --input-only exclude each other")
    if not Path(loop).is_file():
        raise DataError(f"no file {loop!r} with an input to predict from")
    options = dataclasses.asdict(reading)
    table = table_of(loop, **{key: options.pop(key) for key in ("sheet", "delimiter", "decimal", "encoding")})
    blank = "no output"
    table = dataclasses.replace(
        table,
        names=(*table.names, blank),
        units=(*table.units, ""),
        columns=(*table.columns, np.zeros(table.rows)),
    )
    data = Dataset.of(assemble(table, **{**options, "output": blank}))
    return data.map(lambda record: record.replace(weight=np.zeros(len(record))))


def _compared(result: FitResult, data: Dataset, runs: list[Any], fitdir: Path, refit_offset: bool) -> dict[str, Any]:
    """Content of result.json for a prediction."""
    import numpy as np

    from hystfit.results.metrics import Metrics
    from hystfit.results.result import provenance

    finite = all(np.isfinite(run).all() for run in runs)
    measured = [(record, run) for record, run in zip(data, runs, strict=True) if record.used.any()]
    metrics = None
    if measured and finite:
        metrics = Metrics.of([r.y[r.used] for r, _ in measured], [run[r.used] for r, run in measured]).to_dict()
    whole = [r if r.used.any() else r.replace(weight=np.ones(len(r))) for r in data]
    notes = [words for record in whole if (words := result.extrapolates(record))]
    if not finite:
        notes.append("the prediction is not finite: the model leaves the range in which it is stable")
    if not result.usable:
        notes.append(f"the fit itself is not usable: its status is {result.status}")
    if refit_offset:
        notes.append("the offset of each record was refitted to its mean")
    return {
        "schema": "hystfit.predict/1",
        "model": result.name,
        "status": "ok" if finite and result.usable else "not-finite" if not finite else "fit-not-usable",
        "notes": notes,
        "metrics": {"test": metrics},
        "fit": {"folder": str(fitdir), "status": result.status, "provenance": result.provenance},
        "provenance": provenance(data, None),
    }


def _prediction_words(content: dict[str, Any], data: Dataset, out: Path | None) -> str:
    from hystfit.results.metrics import Metrics
    from hystfit.results.report import metrics_words

    metrics = content["metrics"]["test"]
    names = ", ".join(record.name for record in list(data)[:5]) + (
        f" and {len(data) - 5} more" if len(data) > 5 else ""
    )
    words = [f"{content['model']} over {names}: {sum(len(record) for record in data)} samples"]
    words.append(f"  against the measured output: {metrics_words(Metrics(**metrics) if metrics else None)}")
    words += [f"  - {note}" for note in content["notes"]]
    if out is not None:
        words.append(f"Written to {out}: prediction.csv, prediction.png, result.json")
    return "\n".join(words)


def _write_prediction(
    out: Path, result: FitResult, data: Dataset, runs: list[Any], content: dict[str, Any], refit_offset: bool
) -> None:
    from matplotlib.figure import Figure

    from hystfit.results.plots import fit as draw
    from hystfit.results.saved import dump_json, writing

    with writing(out) as scratch:
        dump_json(scratch / "result.json", content)
        with (scratch / "prediction.csv").open("w", encoding="utf-8", newline="") as file:
            _table(file, data, runs, result.data.units["y"])
        figure = Figure(figsize=(9.6, 3.8), layout="constrained")
        axes = figure.subplots(1, 2)
        draw(result, "loop", axes[0], data=data, refit_offset=refit_offset)
        draw(result, "series", axes[1], data=data, refit_offset=refit_offset)
        figure.savefig(scratch / "prediction.png", dpi=150)


def _table(file: Any, data: Dataset, runs: list[Any], y_unit: str) -> None:
    """Rows of time (where there is one), input, output measured (empty where it counts for nothing) and predicted."""
    import csv

    writer = csv.writer(file)
    first: Record = next(iter(data))
    timed = all(record.t is not None for record in data)
    several = len(data) > 1
    unit = lambda name, label: f"{name}_{label}" if label else name
    writer.writerow(
        (["record"] if several else [])
        + ([unit("t", first.t_unit)] if timed else [])
        + [unit("u", first.u_unit), unit("measured", first.y_unit or y_unit), unit("predicted", y_unit)]
    )
    for record, run in zip(data, runs, strict=True):
        for k in range(len(record)):
            measured = repr(float(record.y[k])) if record.used[k] else ""
            writer.writerow(
                ([record.name] if several else [])
                + ([repr(float(record.t[k]))] if timed and record.t is not None else [])
                + [repr(float(record.u[k])), measured, repr(float(run[k]))]
            )
