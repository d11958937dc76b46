"""Options that several verbs share."""

from __future__ import annotations

import dataclasses
import shlex
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from cyclopts import Group, Parameter

from hystfit.errors import DataError, ParameterError
from hystfit.inference.noise.registry import NOISES

F = TypeVar("F", bound=Callable[..., int])
FILE = Group("Reading the file", sort_key=1)
SPLIT = Group("Training and test samples", sort_key=2)
SEQUENTIAL = Group("Settings of rls and gradient-correction", sort_key=3)
Text = Annotated[str | None, Parameter(group=FILE)]
Part = Annotated[str | None, Parameter(group=SPLIT)]
Flag = Annotated[bool, Parameter(group=SPLIT)]
FitFolder = Annotated[Path, Parameter(help="folder written by `hystfit fit --out`")]
FitOrDraws = Annotated[
    Path,
    Parameter(help="folder written by `hystfit fit --out`, or by `hystfit sample --out` for bands over the posterior"),
]
Trust = Annotated[
    bool,
    Parameter(help="open a fit that runs a Python file of yours, or whose files were edited after they were saved"),
]
Loop = Annotated[
    str,
    Parameter(
        help="file, pattern ('loops/*.csv'), input+output files (u.csv+y.csv) or name of a data set; several arguments are several records"
    ),
]
Number = Annotated[float | None, Parameter(group=FILE)]
Setting = Annotated[float | None, Parameter(group=SEQUENTIAL)]
Device = Annotated[
    Literal["auto", "cpu", "gpu"],
    Parameter(
        help="where to compute: auto uses a GPU for 1024 or more loops that are solved together, otherwise the CPU"
    ),
]
Limits = Annotated[
    str | None, Parameter(help="lowest and highest input as low:high; default: the range of the fitted input")
]

Covariates = Annotated[
    list[str] | None, Parameter(name="--covariate", help="value of a covariate of the fit, as T_degC=30; repeatable")
]

Purpose = Annotated[
    Literal["prediction", "inverse", "export"],
    Parameter(
        name="--for",
        help="what the model is for: inverse and export rank models without an inverse, or without C code, below the others",
    ),
]


def lists(**registries: Iterable[str]) -> Callable[[F], F]:
    """Fill the names in registries into the help of a verb: {noises} in its docstring becomes "iid, ou, ..."."""

    def fill(verb: F) -> F:
        verb.__doc__ = (verb.__doc__ or "").format(**{key: ", ".join(names) for key, names in registries.items()})
        return verb

    return fill


@Parameter(name="*")
@dataclass(frozen=True)
class Reading:
    """Options for reading a file. A reference has no input and an excitation no output: these options are refused there.

    Args:
        time: column of the time, by name or number from 0; "none" reads without time. Recognized by name or unit by default.
        input: column of the input.
        output: column of the output, or of a reference; default for a reference: the column that matches the fitted output.
        sigma: column with the standard deviation of each output sample, by which the samples are weighted.
        rate: sampling rate in Hz, for a file without a usable clock.
        dt: sampling interval in seconds, instead of --rate.
        units: units of input and output, such as V,um (for a reference ,um); other units of the same quantity in the file are converted.
        by: column whose values separate several curves in one file.
        only: which curves: values (3,4) or positions from 0 (1::4).
        where: rows to read, as column=value.
        sheet: sheet of a workbook.
        delimiter: column delimiter; recognized by default.
        decimal: decimal mark, "." or ",".
        encoding: text encoding.
        adjusted: use the columns that the instrument adjusted for a slope or an offset, instead of the raw ones.
        integrate: replace the output by its integral over time (the charge of a current).
        smooth: smooth the input by a zero-phase filter of this many samples (odd).
        gaps: where the input is missing, "split" makes a record of each piece, "drop" joins the pieces, "error" refuses the file.
    """

    time: Text = None
    input: Text = None
    output: Text = None
    sigma: Text = None
    rate: Number = None
    dt: Number = None
    units: Text = None
    by: Text = None
    only: Text = None
    where: Text = None
    sheet: Text = None
    delimiter: Text = None
    decimal: Text = None
    encoding: Text = None
    adjusted: Annotated[bool, Parameter(group=FILE, negative=())] = False
    integrate: Annotated[bool, Parameter(group=FILE)] = False
    smooth: Annotated[int | None, Parameter(group=FILE)] = None
    gaps: Annotated[str, Parameter(group=FILE)] = "error"


def changed(options: Reading | Split) -> dict[str, Any]:
    """Options that differ from their defaults."""
    default = type(options)()
    return {k: v for k, v in dataclasses.asdict(options).items() if v != getattr(default, k)}


def command_words(loops: Iterable[str], reading: Reading) -> str:
    """LOOP arguments with the options for reading them, quoted for a shell."""
    options = [f"--{k}" if v is True else f"--{k}={v}" for k, v in changed(reading).items()]
    return shlex.join([*loops, *options])


@Parameter(name="*")
@dataclass(frozen=True)
class Split:
    """Options that select the samples to fit and the samples to test on.

    Args:
        window: fit only the samples in start:stop (seconds, or sample numbers without time); 5:25, :27, 25:.
        test_window: report the error on these samples, which are not fitted.
        test: another file or data set to report the error on.
        test_only: curves to report the error on (with --by), which are not fitted.
        rest: input at which the device was in equilibrium before each record, such as 0; or "cycle", where each record is one
            period of a steady cycle. Default: the first input of the record, or "cycle" where a single period closes on a branch.
        refit_offset: shift the prediction of each test record to the mean of its output (the zero of the sensor may differ).
    """

    window: Part = None
    test_window: Part = None
    test: Part = None
    test_only: Part = None
    rest: Annotated[float | Literal["cycle"] | None, Parameter(group=SPLIT)] = None
    refit_offset: Flag = False


@Parameter(name="*")
@dataclass(frozen=True)
class SequentialSettings:
    """Settings of the methods rls and gradient-correction.

    Args:
        basis: legendre (regressors scaled to the record), or powers (of the input, as published).
        passes: number of runs over the samples.
        forgetting: forgetting factor lambda, 0 to 1 (rls).
        prior: variance of the parameters before the first sample (rls).
        weights: positive weights of the parameters alpha f, alpha and g, separated by commas (gradient-correction).
        mu: relative step size, 0 to 2 (gradient-correction).
        step: constant step size, instead of one normalized by --mu and --floor (gradient-correction).
        floor: constant added to the power that normalizes the step size (gradient-correction).
    """

    basis: Annotated[Literal["legendre", "powers"] | None, Parameter(group=SEQUENTIAL)] = None
    passes: Annotated[int | None, Parameter(group=SEQUENTIAL)] = None
    forgetting: Setting = None
    prior: Setting = None
    weights: Annotated[str | None, Parameter(group=SEQUENTIAL)] = None
    mu: Setting = None
    step: Setting = None
    floor: Setting = None

    def given(self) -> dict[str, Any]:
        """Settings that differ from the defaults, as keywords."""
        chosen = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        if self.weights is not None:
            try:
                chosen["weights"] = [float(text) for text in self.weights.split(",")]
            except ValueError:
                raise ParameterError(f"--weights needs numbers separated by commas, got {self.weights!r}") from None
        return {name: value for name, value in chosen.items() if value is not None}


@Parameter(name="*")
@dataclass(frozen=True)
class Output:
    """Options for the output of a verb.

    Args:
        out: folder for result.json and the other files of this verb; made if it does not exist.
        json: print result.json instead of the text.
    """

    out: Path | None = None
    json: Annotated[bool, Parameter(name="--json")] = False

    @property
    def run(self) -> Path | None:
        """Folder of the finished parts of long work, from which the same command resumes; None without `out`."""
        return None if self.out is None else self.out / "run"

    def check(self, own: str = "") -> None:
        """Refuse, before long work, a folder that cannot be written or holds another result than one of the schema `own`."""
        if self.out is None:
            return
        from hystfit.results.saved import check_target
        from hystfit.results.saving.folders import check_writable

        check_target(self.out, own)
        check_writable(self.out)


@Parameter(name="*")
@dataclass(frozen=True)
class TableOutput(Output):
    """Options for the output of a verb that writes one table.

    Args:
        out: CSV file to write (netCDF with the suffix .nc), or a folder for it.
        json: print result.json instead of the text.
    """


@lists(noises=NOISES)
@Parameter(name="*")
@dataclass(frozen=True)
class Fitting:
    """Options of every fit.

    Args:
        fix: parameter that is not fitted, as NAME or NAME=VALUE; repeatable.
        free: parameter to fit that the model fixes by default; repeatable.
        tie: parameter that follows from another one, as NAME=NUMBER*NAME+NUMBER ("k2=2*k1", "gamma[1]=gamma[0]"); repeatable.
        noise: auto, {noises}, or my_file.py:MyNoise. auto widens the standard errors if the residuals are autocorrelated, iid does not; the
            others refit the parameters by maximum likelihood.
        starts: number of starting points.
        seed: random seed for the starting points.
    """

    fix: list[str] | None = None
    free: list[str] | None = None
    tie: list[str] | None = None
    noise: str = "auto"
    starts: int = 8
    seed: int = 0

    def keywords(self) -> dict[str, Any]:
        """Arguments of `hystfit.fit`."""
        chosen = {"fix": named_values(self.fix or []), "free": self.free or [], "tie": tied_values(self.tie or [])}
        return vars(self) | chosen


@Parameter(name="*")
@dataclass(frozen=True)
class LoopFitting(Fitting):
    """Options of a fit to loops that share no parameter.

    Args:
        loss: linear, or a robust loss that reduces the influence of outliers: huber, soft-l1, cauchy.
        start: starting values estimated from the data, or those of the model.
    """

    loss: str = "linear"
    start: Literal["data", "model"] = "data"


DEFAULT_READING, NO_SPLIT, STDOUT, NO_SETTINGS = Reading(), Split(), Output(), SequentialSettings()
NO_TABLE, FITTING, LOOP_FITTING = TableOutput(), Fitting(), LoopFitting()


def bounds_of(text: str | None) -> tuple[float | None, float | None] | None:
    """Start and stop of a window written as start:stop."""
    if text is None:
        return None
    try:
        start, stop = (float(part) if part.strip() else None for part in text.split(":"))
    except ValueError:
        raise DataError(f"a window is start:stop, such as 5:25, 25: or :27; got {text!r}") from None
    if start is not None and stop is not None and not start < stop:
        raise DataError(f"window {text!r} is empty: its start must lie before its stop")
    return start, stop


def input_limits(text: str | None) -> tuple[float, float] | None:
    """Lowest and highest input from low:high."""
    if text is None:
        return None
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        raise DataError(f"--limits needs both ends as low:high, such as 0:120; got {text!r}") from None
    if not low < high:
        raise DataError(f"--limits must rise, low:high; got {text!r}")
    return low, high


def named_values(pairs: list[str], needed_by: str = "") -> dict[str, float | None]:
    """Parameters and their values from NAME=VALUE; a NAME alone has the value None, unless the option `needed_by` needs one."""
    values: dict[str, float | None] = {}
    for pair in pairs:
        name, mark, value = (part.strip() for part in pair.partition("="))
        if not name or name in values:
            raise ParameterError(f"expected NAME or NAME=VALUE, each name once; got {pair!r}")
        if needed_by and not mark:
            raise ParameterError(f"{needed_by} {name} needs a value: {needed_by} {name}=1")
        try:
            values[name] = float(value) if mark else None
        except ValueError:
            remedy = "" if needed_by else f"; to tie {name} to another parameter use --tie {pair!r}"
            raise ParameterError(f"{pair!r}: {value!r} is not a number{remedy}") from None
    return values


def tied_values(pairs: list[str]) -> dict[str, str]:
    """Expressions by parameter from NAME=EXPRESSION."""
    values: dict[str, str] = {}
    for pair in pairs:
        name, mark, expression = (part.strip() for part in pair.partition("="))
        if not (name and mark and expression) or name in values:
            raise ParameterError(f"--tie takes NAME=EXPRESSION, each name once, such as --tie 'k2=2*k1'; got {pair!r}")
        values[name] = expression
    return values
