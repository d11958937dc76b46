"""`hystfit fit` and `hystfit compare`."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from hystfit.cli.options import (
    DEFAULT_READING,
    LOOP_FITTING,
    NO_SETTINGS,
    NO_SPLIT,
    STDOUT,
    Loop,
    LoopFitting,
    Output,
    Purpose,
    Reading,
    SequentialSettings,
    Split,
    changed,
    command_words,
    lists,
    named_values,
)
from hystfit.cli.records import train_and_test
from hystfit.cli.verbs import as_options
from hystfit.cli.write import finish, progress, prose_width, terminal_width
from hystfit.errors import ParameterError
from hystfit.fitting.solvers.registry import ESTIMATORS, is_sequential
from hystfit.identify.registry import IDENTIFIERS

if TYPE_CHECKING:
    from hystfit.data.dataset import Dataset
    from hystfit.results.report import Wording
    from hystfit.results.result import FitResult
    from hystfit.results.webpage import Page


@lists(methods=ESTIMATORS, sequential=IDENTIFIERS)
def fit(
    *loops: Loop,
    model: str = "auto",
    purpose: Purpose = "prediction",
    method: str = "auto",
    at: list[str] | None = None,
    covariate: list[str] | None = None,
    fitting: LoopFitting = LOOP_FITTING,
    sequential: SequentialSettings = NO_SETTINGS,
    reading: Reading = DEFAULT_READING,
    split: Split = NO_SPLIT,
    output: Output = STDOUT,
) -> int:
    """Fit a model to a measured loop and report what the data determine.

    With --out, the folder holds the fit, its report (report.html) and the pictures.

    Args:
        model: name (see hystfit models; join several by +), my_model.py:MyModel, prandtl-ishlinskii-search (chooses the terms of that
            family by cross-validation), or auto (the winner of hystfit compare; --starts applies to every fit, --noise to the winner).
        method: auto (suits the model), {methods}; or sequential, in one pass over the samples: {sequential}.
        at: starting value of a parameter, as NAME=VALUE, in place of the one estimated from the data; repeatable.
        covariate: parameters that depend linearly on a constant of each record (temperature, current, preload), as T_degC:c,tau;
            repeatable. The value is read from a constant column, the header of the file, or the name of the record.
    """
    output.check("hystfit.fit")
    if at and fitting.start == "model":
        raise ParameterError("--at replaces starting values estimated from the data: leave out --start model")
    if (settings := sequential.given()) and not is_sequential(method):
        raise ParameterError(
            f"--{next(iter(settings))} is a setting of the sequential methods: add, for example, --method rls"
        )
    options = fitting.keywords() | {"covariates": covariate or (), **settings}
    if at:
        options["start"] = named_values(at, "--at")
    train, test = train_and_test(loops, reading, split)
    if model == "auto" and not is_sequential(method):
        result = _winner(train, method, options, purpose)
    elif purpose != "prediction":
        raise ParameterError("--for chooses among models: it has no effect with --model or a sequential method")
    else:
        from hystfit.fitting.fit import fit as fit_loops

        with progress(f"fitting {model}"):
            result = fit_loops(model, train, method=method, **options)  # type: ignore[arg-type]
    if test is not None:
        from hystfit.fitting.trial import with_test

        result = with_test(result, test, refit_offset=split.refit_offset)

    from hystfit.results.report import text_report

    wording = _wording(loops, reading, split, output.out)

    def save(folder: Path) -> None:
        _save_fit(result, folder, test, split, wording)

    return finish(text_report(result, wording, prose_width()), result.to_dict(), output, save)


def _wording(loops: Sequence[str], reading: Reading, split: Split, folder: Path | None) -> Wording:
    """Files and options as the user wrote them; without a folder the fit is not saved."""
    from hystfit.results.report import Wording
    from hystfit.results.report.answer import option_words

    samples = shlex.join(option_words(changed(split)))
    wording = Wording("fit", command_words(loops, reading), samples, saved=False, translate=as_options)
    return wording if folder is None else wording.at(folder)


def _after_comparison(winner: FitResult, wording: Wording) -> list[str]:
    """Next commands after a comparison: those for its winner, or the one that fits and saves it."""
    from hystfit.results.report.answer import next_commands

    if wording.saved and winner.usable:
        return next_commands(winner, wording)
    options = " ".join(filter(None, [wording.loop, wording.split]))
    return [f"hystfit fit {options} --model {shlex.quote(winner.name)} --out fit"]


def _save_fit(result: FitResult, folder: Path, test: Dataset | None, split: Split, wording: Wording) -> None:
    from hystfit.results.report import write_into
    from hystfit.results.saved import write_fit

    write_fit(result, folder)
    write_into(result, folder, test=test, refit_offset=split.refit_offset, wording=wording)


def _winner(train: Dataset, method: str, options: dict[str, Any], purpose: Any) -> FitResult:
    from hystfit.fitting.fit import best_model
    from hystfit.fitting.fit_options import FitOptions

    settings = FitOptions(method=method, **options)
    settings.check_search()
    return best_model(train, settings, purpose)


def compare(
    *loops: Loop,
    models: list[str] | None = None,
    left_out: Literal["auto", "future"] = "auto",
    purpose: Purpose = "prediction",
    seed: int = 0,
    reading: Reading = DEFAULT_READING,
    split: Split = NO_SPLIT,
    output: Output = STDOUT,
) -> int:
    """Fit several models and rank them by their cross-validation error.

    With --out, the folder holds the ranking (comparison.txt, report.html) and the fit of the winner (winner/).

    Args:
        models: names, repeated or separated by commas; default: every family that suits the records; models that cannot win are stopped
            early.
        left_out: what is held out of each fit: by default what the records allow (whole records, amplitudes, cycles or scattered
            samples; the report names it), or the future: later parts of each record are predicted from a fit to the earlier part.
        seed: random seed for the starting points.
    """
    from hystfit.fitting.comparison.compare import compare as compare_models

    output.check()
    names = [name.strip() for part in models or [] for name in part.split(",") if name.strip()]
    train, test = train_and_test(loops, reading, split)
    comparison = compare_models(train, names or None, left_out=left_out, purpose=purpose, seed=seed)
    content, winner, rest = comparison.to_dict(), comparison.winner, ""
    if test is not None:
        from hystfit.fitting.trial import with_test
        from hystfit.results.report import metrics_words

        winner = with_test(winner, test, refit_offset=split.refit_offset)
        content["test"] = winner.test.to_dict() if winner.test else None
        rest += f"\nwinner on the test data, which were not used for the ranking: {metrics_words(winner.test)}"

    wording = _wording(loops, reading, split, output.out and output.out / "winner")
    rest += "\n\n" + "\n".join(_after_comparison(winner, wording))

    def save(folder: Path) -> None:
        (folder / "comparison.txt").write_text(f"{comparison.text()}{rest}\n", encoding="utf-8")
        (folder / "winner").mkdir()
        _save_fit(winner, folder / "winner", test, split, wording)

    def page(folder: Path) -> Page:
        from hystfit.cli.pages import compare_page

        return compare_page(dataclasses.replace(comparison, winner=winner), folder)

    text = comparison.text(terminal_width()) + rest
    return finish(text, content, output, save, status=winner.status, page=page)
