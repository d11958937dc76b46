"""`hystfit fit` and `hystfit compare`."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from hystfit.cli.loading import train_and_test
from hystfit.cli.options import Reading, Split, held
from hystfit.cli.output import progress, refuse_unwritable, show
from hystfit.errors import ParameterError

if TYPE_CHECKING:
    from hystfit.data.record import Dataset
    from hystfit.results.result import FitResult

Sequential = ("rls", "gradient-correction", "ukf")
Method = Literal[
    "auto",
    "lm",
    "dogleg",
    "trf",
    "lbfgsb",
    "projected-gradient",
    "convex",
    "preisach",
    "rls",
    "gradient-correction",
    "ukf",
]
Noise = Literal["auto", "iid", "ou", "ar1", "student-t", "discrepancy"]
Loss = Literal["linear", "huber", "soft-l1", "cauchy"]


def fit(
    loop: str,
    /,
    *,
    model: str = "auto",
    method: Method = "auto",
    fix: list[str] | None = None,
    free: list[str] | None = None,
    noise: Noise = "auto",
    loss: Loss = "linear",
    start: Literal["data", "model"] = "data",
    starts: int = 8,
    seed: int = 0,
    reading: Reading = Reading(),  # noqa: B008  (frozen)
    split: Split = Split(),  # noqa: B008  (frozen)
    out: Path | None = None,
    json: Annotated[bool, Parameter(name="--json")] = False,
) -> int:
    """Fit a model to a measured loop and say what the data determine.

    Args:
        loop: file or data set.
        model: name (see hystfit models; join several by +), my_model.py:MyModel, or auto: the winner of compare.
        method: least squares by lm, dogleg, trf (bounded), lbfgsb, projected-gradient; convex and preisach for weights;
            rls, gradient-correction and ukf go sample by sample. auto suits the model.
        fix: hold a parameter: NAME, or NAME=VALUE; repeatable.
        free: fit a parameter that the model holds; repeatable.
        noise: auto takes standard errors under slow and independent noise where residuals are correlated, iid does not; ou, ar1,
            student-t and discrepancy refine the fit by that noise's likelihood.
        loss: robust losses let outliers count less.
        start: starting values read off the data, or the model's own.
        starts: number of starting points.
        seed: of the starting points.
        out: folder for result.json, the saved fit, the report and its pictures.
        json: print result.json alone.
    """
    refuse_unwritable(out, fit=True)
    given = {"fix": held(fix or []), "free": free or [], "loss": loss, "start": start, "starts": starts, "noise": noise}
    train, test = train_and_test(loop, reading, split)
    if model == "auto" and method not in Sequential:
        result = _best(train, method, given, seed)
    elif method in Sequential:
        result = _sequential(train, model, method, given, seed)
    else:
        from hystfit.fitting.fit import fit as fit_model

        with progress(f"fitting {model}"):
            result = fit_model(model, train, method=method, seed=seed, **given)  # type: ignore[arg-type]
    if test is not None:
        from hystfit.fitting.fit import with_test

        result = with_test(result, test, refit_offset=split.refit_offset)
    return conclude(result, test, split.refit_offset, out, json)


def conclude(result: FitResult, test: Dataset | None, refit_offset: bool, out: Path | None, as_json: bool) -> int:
    """Write a fit and its report, print it, and give the exit status."""
    from hystfit.results.report import text_report, write_into

    if out is not None:
        from hystfit.results.saved import write_fit, writing

        with progress("drawing"), writing(out) as scratch:
            write_fit(result, scratch)
            write_into(result, scratch, test=test, refit_offset=refit_offset)
    text = text_report(result)
    if out is not None:
        text += f"\nWritten to {out}: report.html (open it in a browser), pictures, result.json, the fit itself"
    show(text, result.to_dict(), as_json)
    return 0 if result.usable else 1


def _best(train: Dataset, method: str, given: dict[str, Any], seed: int) -> FitResult:
    """The winner of `compare`, with a note that says so."""
    from hystfit.fitting.compare import compare as compare_models

    if changed := _changed({**given, "method": method}):
        raise ParameterError(
            f"--{changed[0]} needs a model of your choice: add --model NAME (hystfit models lists them, hystfit compare "
            "ranks them)"
        )
    with progress("comparing models") as tell:
        comparison = compare_models(train, seed=seed, progress=tell)
    best = comparison.rows[0]
    score = "" if best.score_percent is None else f", {best.score_percent:.3g} % of the range"
    note = (
        f"{best.name} was chosen among {len(comparison.rows)} models by its error on data left out of its fit{score}; "
        "hystfit compare shows them all, --model NAME takes another"
    )
    return dataclasses.replace(comparison.winner, notes=(note, *comparison.winner.notes))


_DEFAULTS = {"fix": {}, "free": [], "loss": "linear", "start": "data", "starts": 8, "noise": "auto", "method": "auto"}


def _changed(given: dict[str, Any]) -> list[str]:
    """Options that were given another value than their default."""
    return [name for name, value in given.items() if value != _DEFAULTS[name]]


def _sequential(train: Dataset, model: str, method: str, given: dict[str, Any], seed: int) -> FitResult:
    """A sample-by-sample identification as a fit."""
    from hystfit.fitting.timing import Stopwatch
    from hystfit.identify import as_fit, identify
    from hystfit.models.registry import make_model

    if unused := _changed(given):
        raise ParameterError(f"--{unused[0]} has no meaning for --method {method}: leave it out")
    watch = Stopwatch()
    with progress(f"identifying by {method}"):
        found = identify(train, method=method, model=None if model == "auto" else make_model(model))
    return as_fit(found, seed, watch)


def compare(
    loop: str,
    /,
    *,
    models: list[str] | None = None,
    left_out: Literal["blocks", "future"] = "blocks",
    seed: int = 0,
    reading: Reading = Reading(),  # noqa: B008  (frozen)
    split: Split = Split(),  # noqa: B008  (frozen)
    out: Path | None = None,
    json: Annotated[bool, Parameter(name="--json")] = False,
) -> int:
    """Fit several models and rank them by their error on data left out of the fit.

    Args:
        loop: file or data set.
        models: names, repeated or with commas between them; a choice that suits the data where not given.
        left_out: blocks in turn (whole records where there are three or more), or the future: later parts of each record are
            predicted from a fit to what came before.
        seed: of the starting points.
        out: folder for result.json, comparison.txt and the winner's fit (in winner/).
        json: print result.json alone.
    """
    from hystfit.fitting.compare import compare as compare_models

    refuse_unwritable(out)
    names = [name.strip() for part in models or [] for name in part.split(",") if name.strip()]
    train, test = train_and_test(loop, reading, split)
    with progress("comparing models") as tell:
        comparison = compare_models(train, names or None, left_out=left_out, seed=seed, progress=tell)
    text, content = comparison.text(), comparison.to_dict()
    winner = comparison.winner
    if test is not None:
        from hystfit.fitting.fit import with_test
        from hystfit.results.report import metrics_words

        winner = with_test(winner, test, refit_offset=split.refit_offset)
        content["test"] = winner.test.to_dict() if winner.test else None
        text += f"\nthe winner on the test data, which chose nothing: {metrics_words(winner.test)}"
    if out is not None:
        from hystfit.results.report import write_into
        from hystfit.results.saved import dump_json, write_fit, writing

        with progress("drawing"), writing(out) as scratch:
            dump_json(scratch / "result.json", content)
            (scratch / "comparison.txt").write_text(text + "\n", encoding="utf-8")
            (scratch / "winner").mkdir()
            write_fit(winner, scratch / "winner")
            write_into(winner, scratch / "winner", test=test, refit_offset=split.refit_offset)
        text += f"\nWritten to {out}: result.json, comparison.txt; the winner's fit and report in winner/"
    show(text, content, json)
    return 0 if winner.usable else 1
