"""Notes: findings about data and results, each with a code on which decisions are made."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Iterable
from typing import Any


class Severity(enum.StrEnum):
    """How much a note matters to the user's numbers."""

    INFO = "info"  # what was chosen, or worth knowing
    WARNING = "warning"  # some of the numbers need a second look
    ERROR = "error"  # the result should not be used


class Code(enum.StrEnum):
    """What a note is about. Decisions and tests use these codes, never the text of a note.

    Each member states what the code means and what to do, in the words of the command line; the documentation lists all of them.
    """

    meaning: str
    remedy: str

    def __new__(cls, code: str, meaning: str, remedy: str) -> Code:
        """A member with its meaning and its remedy."""
        member = str.__new__(cls, code)
        member._value_, member.meaning, member.remedy = code, meaning, remedy
        return member

    # fits
    SOLVER = (
        "solver",
        "message of a solver that did not converge",
        "raise `--starts`, try `--method trf`, or fix parameters that the data do not determine",
    )
    POOR_FIT = (
        "poor-fit",
        "the error is large beside the loop",
        "run `hystfit compare`, or choose a model with more freedom",
    )
    ACCURACY = (
        "accuracy",
        "the error beside its limits, the noise and plain descriptions",
        "compare the error with the noise and with the plain descriptions in the same sentence",
    )
    ROUGH_FIT = (
        "rough-fit",
        "the error is above a limit of usable descriptions",
        "run `hystfit compare`, or use the model where an error of this size is allowed",
    )
    TEST_ERROR = (
        "test-error",
        "the same on records that were not fitted",
        "check that the test record lies in the fitted range; fit more amplitudes, or another model",
    )
    LEFT_OUT_ERROR = (
        "left-out-error",
        "the cross-validation error is above its limit",
        "choose a model with fewer parameters, or measure more loops",
    )
    MANY_WEIGHTS = (
        "many-weights",
        "at least as many parameters as samples",
        "judge the fit by its cross-validation error; measure more samples, or use fewer elements (`:n=10`)",
    )
    OTHER_FAMILY = (
        "other-family",
        "plain plays fit the data far better than the model",
        "fit `prandtl-ishlinskii` or its generalized form",
    )
    INITIAL_STATE = (
        "initial-state",
        "the largest error lies in the first half cycle",
        "free the initial state (`--free h0`), or leave out the first half cycle with `--window`",
    )
    LAST_HALF_CYCLE = (
        "last-half-cycle",
        "the largest error lies in the last half cycle",
        "look whether the device failed there; if so, leave it out with `--window`",
    )
    MEASUREMENT_NOISE = (
        "measurement-noise",
        "the error is large, and the residuals are white",
        "average more cycles or increase the amplitude; another model will not help",
    )
    MODEL_MISMATCH = (
        "model-mismatch",
        "the data have a property that the model cannot reproduce",
        "choose a model that has this property; no fit of this one will",
    )
    NO_LOOP = (
        "no-loop",
        "the input never turns back",
        "measure full cycles, with the input turning back by more than 1 % of its range",
    )
    NOT_DETERMINED = (
        "not-determined",
        "the data cannot separate these parameters",
        "measure at other amplitudes (`hystfit design`), or fix one of the parameters (`--fix`)",
    )
    NO_INFLUENCE = (
        "no-influence",
        "a parameter does not affect the output on these data",
        "fix the parameter, or measure where it acts",
    )
    AT_BOUND = (
        "at-bound",
        "a parameter lies on its bound",
        "check whether the bound is physical; if so, fix the parameter there or choose another model",
    )
    ZERO_WEIGHTS = (
        "zero-weights",
        "linear weights lie on their bound",
        "nothing: zero weights are usual in a non-negative fit",
    )
    REGULARIZED = (
        "regularized",
        "standard errors include the regularization",
        "treat the errors of single weights as conditional on the smoothing; predictions are not affected",
    )
    CORRELATED_RESIDUALS = (
        "correlated-residuals",
        "the residuals are autocorrelated",
        "keep `--noise auto`, or name the noise model (`--noise ou`); do not use `--noise iid`",
    )
    ERROR_RATIO = (
        "error-ratio",
        "how far autocorrelation changes the standard errors",
        "nothing: the reported standard errors include the factor",
    )
    REPEATING_RESIDUALS = (
        "repeating-residuals",
        "part of the residuals recurs every loop",
        "improve the model; `--noise discrepancy` includes this error in the intervals, more cycles do not reduce it",
    )
    HEAVY_TAILS = (
        "heavy-tails",
        "outliers in the residuals",
        "use `--noise student-t` or `--loss huber`, and look at the outliers",
    )
    ROUNDING = (
        "rounding",
        "residuals are of the size of rounding errors",
        "do not use the standard errors; the data are those of a simulation without noise",
    )
    NOISE_MODEL = (
        "noise-model",
        "the noise model and its parameters",
        "nothing, unless the noise parameters are implausible",
    )
    MODEL_ADVICE = (
        "model-advice",
        "the model's own remark on this input",
        "do what the note says: usually sample faster, or use the exact step (`:scheme=exact`)",
    )
    CHOICE = (
        "choice",
        "what was chosen automatically",
        "nothing, or set the choice by hand to override it",
    )
    EXTRAPOLATION = (
        "extrapolation",
        "a record leaves the fitted range of inputs",
        "measure the range that you want to predict",
    )
    RECORD_PARAMETERS = (
        "record-parameters",
        "what the prediction of a record assumes for parameters of each record",
        "use `--refit-offset` if the sensor has another zero in that record",
    )
    CHANGED_FILES = (
        "changed-files",
        "files of a saved fit, or of its model, differ from those that were saved",
        "fit again; or, where the change was intended, open the fit with `--trust`",
    )
    OFFSET_REFITTED = (
        "offset-refitted",
        "the offset of a test record was refitted",
        "nothing: the error excludes a constant offset",
    )

    # identifiers
    SEQUENTIAL = (
        "sequential",
        "the result comes from a sequential identifier",
        "fit by least squares (`--method lm`) where standard errors are needed",
    )
    NOISE_BIAS = (
        "noise-bias",
        "output noise biases the estimate",
        "use `--method lm`; in Python `integrated_regression` or `bias_compensated` keep the regression linear",
    )
    INVALID_MODEL = (
        "invalid-model",
        "the identified parameters are not a valid model",
        "decimate the record by input increment, or use `--method lm`",
    )
    DIVERGED = (
        "diverged",
        "the estimate or its simulation is not finite",
        "raise the floor or lower mu (gradient correction), or use `--method lm`",
    )
    ONE_STEP_ERROR = (
        "one-step-error",
        "the one-step error is far above the least that is possible",
        "use more passes, a better start, or RLS",
    )
    STEP_SIZE = (
        "step-size",
        "the step size of a gradient method is not bounded",
        "set a floor above zero",
    )
    INNOVATIONS = (
        "innovations",
        "size of the innovations relative to their prediction",
        "change `noise` or `walk` of the filter as the note says",
    )
    NOT_SETTLED = (
        "not-settled",
        "parameters change until the end of the record",
        "use a longer record or more passes",
    )
    SIMULATION_ERROR = (
        "simulation-error",
        "error of the model driven by the input only",
        "judge the result by this error, not by the one-step error",
    )
    SKIPPED_SAMPLES = (
        "skipped-samples",
        "samples that were missing, or that the filter could not use",
        "check the record where samples are missing or not finite",
    )

    # samplers, profiles, calibration, design
    FIT_STATUS = (
        "fit-status",
        "the fit behind the result is not usable",
        "improve the fit first: see its status",
    )
    INCOMPLETE = (
        "incomplete",
        "the residuals show an error of the model that the noise model does not include",
        "add what is missing (creep, a lag, more terms); `--noise discrepancy` includes only what recurs every loop",
    )
    CHAINS = (
        "chains",
        "convergence of the chains",
        "draw more (`--draws`), or fix what the data do not determine",
    )
    DIVERGENCES = (
        "divergences",
        "divergent transitions of NUTS",
        "draw again with a longer warm-up; a few divergences at a bound are harmless, many are not",
    )
    PRIOR = (
        "prior",
        "the posterior is as wide as its prior, or inconsistent with it",
        "state a prior of your own (`--prior`), or measure more",
    )
    OPEN_SIDE = (
        "open-side",
        "no confidence limit on one side",
        "report a one-sided limit; measure at other amplitudes (`hystfit design`)",
    )
    OTHER_OPTIMUM = (
        "other-optimum",
        "the likelihood is larger elsewhere than at the fit",
        "fit again with more `--starts`",
    )
    BLOCKS = (
        "blocks",
        "block length of a robust covariance",
        "use a record with more cycles",
    )
    ERRORS_DIFFER = (
        "errors-differ",
        "standard errors differ from those of the fit, and why",
        "report the larger error, or find out which noise model is right",
    )
    CLOSES = (
        "closes",
        "the proposed input determines what the present data do not",
        "apply the proposed input and fit both records together",
    )
    LOCAL = (
        "local",
        "the design holds near the fitted values",
        "repeat the design after the next fit",
    )

    # predictions, inverses and simulated records
    NOT_FINITE = (
        "not-finite",
        "the simulation is not finite",
        "sample faster, or use a model or scheme that is stable at this sampling rate",
    )
    MISSED = (
        "missed",
        "samples of a reference that cannot be followed",
        "see the status of each sample; lower the reference, or widen `--limits`",
    )

    # records and files
    FILE_FORMAT = (
        "file-format",
        "encoding, delimiter, decimal mark, units and other assumptions about a file",
        "check the assumptions; `--delimiter`, `--decimal`, `--encoding` and `--units` override them",
    )
    COLUMN_CHOICE = (
        "column-choice",
        "a column was chosen by its name, unit or position",
        "if wrong, set `--time`, `--input` and `--output`",
    )
    LEFT_OUT = (
        "left-out",
        "rows, lines or columns of a file that are not used",
        "check that nothing of value is among them",
    )
    MISSING_VALUES = (
        "missing-values",
        "samples without output",
        "nothing: missing outputs have weight 0",
    )
    TIME_STEPS = (
        "time-steps",
        "uneven or repeated time stamps",
        "check the clock, or give the rate (`--rate`)",
    )
    CURVES = (
        "curves",
        "how the rows of a file were divided into records",
        "if wrong, set `--by` and `--only`",
    )
    PREPARED = (
        "prepared",
        "how a record was made or changed after it was measured",
        "nothing: it is part of the provenance of the result",
    )
    UNITS = (
        "units",
        "a column was converted, or its unit assumed",
        "if an assumed unit is wrong, set `--units`",
    )
    WEIGHTED = (
        "weighted",
        "samples are weighted by their standard deviations",
        "nothing; without `--sigma` all samples count alike",
    )
    COARSE_CLOCK = (
        "coarse-clock",
        "time stamps repeat, so that the time of each sample is unknown",
        "give the sampling rate with `--rate`, in Python `Record.sampled`",
    )

    # data quality
    NO_TIME = (
        "no-time",
        "no usable time stamps",
        "give `--rate` or `--dt` where the model has creep or a lag",
    )
    RATE = (
        "rate",
        "an output that is the rate of another quantity (a current)",
        "use `--integrate` for a loop of charge or polarization",
    )
    CLIPPED = (
        "clipped",
        "the output saturates",
        "check for a saturated sensor; a fit leaves these samples out where the output reaches the limit at a slope",
    )
    SPIKES = (
        "spikes",
        "isolated outliers in the output",
        "fit with a robust loss (`--loss huber`)",
    )
    CHATTER = (
        "chatter",
        "noise reverses the input",
        "smooth the input (`--smooth 9`) or use the commanded input",
    )
    OUTPUT_NOISE = (
        "output-noise",
        "the noise is large beside the range of the output",
        "average more cycles or increase the amplitude",
    )
    SINGLE_VALUED = (
        "single-valued",
        "no hysteresis above the noise",
        "increase the amplitude, or fit a curve instead of a hysteresis",
    )
    NOT_CLOSED = (
        "not-closed",
        "the largest loop does not close",
        "add creep (`+log-creep`), or fit cycles that have settled",
    )
    DEGRADING = (
        "degrading",
        "stiffness or strength is lost from cycle to cycle",
        "fit the cycles before the damage; no model here describes it",
    )
    DRIFT = (
        "drift",
        "the mean of like cycles drifts",
        "add creep (`+log-creep`) with `--rest 0`",
    )
    LAG = (
        "lag",
        "the output keeps moving after the input has turned",
        "add `lag+` before the model",
    )
    DELAY = (
        "delay",
        "the output comes a fixed time after the input",
        "nothing: fits without `--model` put `delay+` in front; do the same in a model you name",
    )
    SPEED_DEPENDENT = (
        "speed-dependent",
        "the output depends on the speed of the input",
        "add `viscous` or `saturating-rate`",
    )
    CROSSING = (
        "crossing",
        "the branches of the loop cross (a butterfly)",
        "fit the signed quantity behind the output, or one half of the input range",
    )
    FALLING = (
        "falling",
        "the output falls as the input rises",
        "nothing: fits without `--model` put `negate+` in front, the input with the opposite sign; do the same in a model you name",
    )
    DYNAMICS = (
        "dynamics",
        "the response changes with frequency as that of a resonance",
        "use `oscillator`, or add `second-order`",
    )
    TOO_FEW_SAMPLES = (
        "too-few-samples",
        "fewer samples than branches or parameters need",
        "sample faster, or choose a model with fewer parameters",
    )
    MINOR_LOOPS = (
        "minor-loops",
        "one amplitude alone: minor loops are not determined",
        "measure nested loops or a decaying input before predicting minor loops",
    )
    REVERSAL_CURVES = (
        "reversal-curves",
        "the records are first-order reversal curves",
        "fit `preisach-forc`; where a family has gaps, read what the note says about its curves",
    )


@dataclasses.dataclass(frozen=True)
class Note:
    """One finding.

    Attributes:
        code: what it is about.
        text: one sentence for people.
        severity: how much it matters.
        option: of `hystfit.read`, which the note proposes: its name and value. It is not saved.
    """

    code: Code
    text: str
    severity: Severity = Severity.INFO
    option: tuple[str, str] | None = dataclasses.field(default=None, compare=False)

    def __str__(self) -> str:
        return self.text

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"code": str(self.code), "severity": str(self.severity), "text": self.text}

    @classmethod
    def of(cls, stored: Any) -> Note:
        """The note that `to_dict` described.

        Raises:
            KeyError, ValueError, TypeError: it is not such a description.
        """
        return cls(Code(stored["code"]), str(stored["text"]), Severity(stored["severity"]))


def warn(code: Code, text: str) -> Note:
    """A note of severity `WARNING`."""
    return Note(code, text, Severity.WARNING)


def has(notes: Iterable[Note], *codes: Code) -> bool:
    """Whether any note has one of these codes."""
    return any(note.code in codes for note in notes)
