"""`hystfit predict` and `hystfit report`: a saved fit on another record, and its report."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from hystfit.cli.options import (
    DEFAULT_READING,
    SPLIT,
    STDOUT,
    Covariates,
    FitFolder,
    FitOrDraws,
    Loop,
    Output,
    Part,
    Reading,
    Trust,
    bounds_of,
)
from hystfit.cli.records import load_like, load_one_sided, open_fit, open_posterior
from hystfit.cli.verbs import as_options
from hystfit.cli.write import finish, items, named, progress, prose_width, record_columns, show, write_csv, written
from hystfit.outcome import Code, Note, Severity, Status
from hystfit.outcome.note import warn
from hystfit.outcome.wrapping import listed

if TYPE_CHECKING:
    import numpy as np

    from hystfit.data.dataset import Dataset
    from hystfit.results.result import FitResult
    from hystfit.sampling.posterior import Posterior

_LEVEL = 0.9  # of measurements that lie in a band


def report(folder: FitFolder, /, *, trust: Trust = False, output: Output = STDOUT) -> int:
    """Print the report of a saved fit and draw its pictures and HTML page again.

    They are written into --out, or into the folder of the fit.
    """
    from hystfit.results.report import Wording, text_report, write
    from hystfit.results.saved import load_fit
    from hystfit.results.saving.folders import check_writable

    result = load_fit(folder, trust=trust)
    target = output.out or folder
    check_writable(target)
    wording = Wording(translate=as_options).at(folder)
    with progress("drawing"):
        write(result, target, wording=wording)
    show(
        text_report(result, wording, prose_width()) + written(target, ["report.html", "report.txt", "pictures"]),
        result.to_dict(),
        output.json,
    )
    return 0 if result.usable else 1


def predict(
    fitdir: FitOrDraws,
    /,
    *loops: Loop,
    input_only: Annotated[bool, Parameter(group=SPLIT)] = False,
    window: Part = None,
    refit_offset: Annotated[bool, Parameter(group=SPLIT)] = False,
    covariates: Covariates = None,
    trust: Trust = False,
    reading: Reading = DEFAULT_READING,
    output: Output = STDOUT,
) -> int:
    """Simulate a fitted model on the input of a record, and compare it with the measured output where there is one.

    With --out, the folder holds prediction.csv and a picture. With a folder of `hystfit sample`, it adds bands that contain 90 % of
    measurements.

    Args:
        input_only: the file has no output: predict it (give --input, and --time).
        window: compare only the samples in start:stop.
        refit_offset: shift the prediction to the mean of the measurement (the zero of the sensor may differ).
    """
    import numpy as np

    result = open_fit(fitdir, output, trust, covariates=covariates)
    posterior = open_posterior(fitdir, trust, covariates)
    if input_only:
        unit = result.data.units["y"]
        data = load_one_sided(loops, reading, "output", result.data[0])
        data = data.map(lambda record: record.replace(y_unit=unit))
    else:
        data = load_like(loops, reading, result.data[0])
    data = data.map(result.in_fitted_units)
    part = bounds_of(window)
    if part is not None:
        data = data.map(lambda record: record.window(*part))
    runs = [result.predict(record, refit_offset=refit_offset) for record in data]
    content, text = _compared(result, data, runs, fitdir, refit_offset)
    columns, unit = {"predicted": runs}, result.data.units["y"]
    if posterior is not None:
        edges = _edges(result, posterior, data, runs)
        content["bands"], words = _of_bands(data, edges)
        text = "\n".join([text, *items([words])])
        columns |= {"lower": [low for low, _ in edges], "upper": [high for _, high in edges]}

    def save(folder: Path) -> None:
        predicted = {named(name, unit): np.concatenate(rows).tolist() for name, rows in columns.items()}
        write_csv(folder / "prediction.csv", record_columns(data, "measured", unit) | predicted)
        _draw(folder / "prediction.png", result, data, refit_offset)

    return finish(text, content, output, save)


def _edges(
    result: FitResult, posterior: Posterior, data: Dataset, runs: list[Any]
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Lower and upper edge of the predictive band of each record, shifted as the predictions in `runs` are, shapes (T,)."""
    with progress("predicting by draws"):
        bands = [posterior.bands(record, _LEVEL) for record in data]
    shifts = [run[0] - result.predict(record)[0] for record, run in zip(data, runs, strict=True)]
    return [(low + shift, high + shift) for (low, _, high), shift in zip(bands, shifts, strict=True)]


def _of_bands(data: Dataset, edges: list[tuple[np.ndarray, np.ndarray]]) -> tuple[dict[str, Any], str]:
    """Content of result.json for bands, and their words."""
    import numpy as np

    widest = max(float(np.max(high - low)) for low, high in edges)
    inside = np.concatenate([
        ((low <= record.y) & (record.y <= high))[record.used] for record, (low, high) in zip(data, edges, strict=True)
    ])  # fmt: skip
    share = float(np.mean(inside)) if inside.size else None
    words = f"band of {100 * _LEVEL:.0f} % of measurements, at most {widest:.3g} {data.units['y']}".rstrip() + " wide"
    if share is not None:
        words += f"; {100 * share:.0f} % of the measured samples lie in it"
    return {"level": _LEVEL, "width": widest, "inside": share}, words


def _compared(
    result: FitResult, data: Dataset, runs: list[Any], fitdir: Path, refit_offset: bool
) -> tuple[dict[str, Any], str]:
    """Content of result.json for a prediction, and its text."""
    import numpy as np

    from hystfit.fitting.trial import evaluate_on
    from hystfit.results.accuracy import verdict_dict
    from hystfit.results.provenance import provenance
    from hystfit.results.report import metrics_words

    finite = all(np.isfinite(run).all() for run in runs)
    measured = [record for record in data if record.used.any()]
    trial = evaluate_on(result, measured, refit_offset=refit_offset) if measured and finite else None
    notes = list(dict.fromkeys(note for record in data for note in record.notes if note.code is Code.UNITS))
    notes += [] if trial is None else [note for note in trial.notes if note not in notes]
    advice = dict.fromkeys(line for record in data for line in result.model.advice(record.u, record.dt))
    notes += [warn(Code.MODEL_ADVICE, line) for line in advice]
    for record in data:
        if trial is None or not record.used.any():
            whole = record.replace(weight=np.ones(len(record)))
            notes += [note for note in (result.extrapolation(whole), result.assumption(record)) if note is not None]
    if not finite:
        text = "the prediction is not finite: the model is unstable on this input"
        notes.append(Note(Code.NOT_FINITE, text, Severity.ERROR))
    if not result.usable:
        notes.append(warn(Code.FIT_STATUS, f"the fit itself is not usable: its status is {result.status}"))
    fitted_files = {record.sha256 for record in result.data} - {None}
    if trial is not None and any(record.sha256 in fitted_files for record in data):
        notes.append(
            Note(Code.SAME_FILE, "the fit used this file: on the samples that it fitted, the error is no test")
        )
    if refit_offset:
        notes.append(Note(Code.OFFSET_REFITTED, "the offset of each record was refitted to its mean"))
    status = Status.OK if trial is None else trial.status
    status = Status.NOT_FINITE if not finite else status if result.usable else Status.FIT_NOT_USABLE
    metrics = None if trial is None else trial.metrics
    lines = [
        f"{result.name} on {listed([record.name for record in data])}: {sum(len(record) for record in data)} samples"
    ]
    lines += [f"  error against the measured output: {metrics_words(metrics)}", *items(notes)]
    content = {
        "schema": "hystfit.predict/1",
        "model": result.name,
        "status": str(status),
        "notes": [note.to_dict() for note in notes],
        "metrics": {"test": metrics.to_dict() if metrics else None},
        "verdict": {"test": None if trial is None else verdict_dict(trial.metrics, trial.baselines)},
        "fit": {"folder": str(fitdir), "status": result.status, "provenance": result.provenance},
        "provenance": provenance(data, None),
    }
    return content, "\n".join(lines)


def _draw(path: Path, result: FitResult, data: Dataset, refit_offset: bool) -> None:
    from hystfit.cli.figures import draw, sheet

    figure = sheet(9.6, 3.8)
    for kind, axes in zip(("loop", "series"), figure.subplots(1, 2), strict=True):
        draw(result, kind, axes, data=data, refit_offset=refit_offset)
    figure.savefig(path, dpi=150)
