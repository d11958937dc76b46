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
    """What a note is about. Decisions and tests use these codes, never the text of a note."""

    # fits
    SOLVER = "solver"  # message of a solver that did not converge
    POOR_FIT = "poor-fit"  # the error is large beside the loop
    ACCURACY = "accuracy"  # the error beside its limits, the noise and plain descriptions
    ROUGH_FIT = "rough-fit"  # the error is above a limit of usable descriptions
    TEST_ERROR = "test-error"  # the same on records that were not fitted
    LEFT_OUT_ERROR = "left-out-error"  # the cross-validation error is above its limit
    OTHER_FAMILY = "other-family"  # plain plays fit the data far better than the model
    INITIAL_STATE = "initial-state"  # the largest error lies in the first half cycle
    MEASUREMENT_NOISE = "measurement-noise"  # the error is large, and the residuals are white
    MODEL_MISMATCH = "model-mismatch"  # the data have a property that the model cannot reproduce
    NO_LOOP = "no-loop"  # the input never turns back
    NOT_DETERMINED = "not-determined"  # the data cannot separate these parameters
    NO_INFLUENCE = "no-influence"  # a parameter does not affect the output on these data
    AT_BOUND = "at-bound"  # a parameter lies on its bound
    ZERO_WEIGHTS = "zero-weights"  # linear weights lie on their bound
    REGULARIZED = "regularized"  # standard errors include the regularization
    CORRELATED_RESIDUALS = "correlated-residuals"  # the residuals are autocorrelated
    ERROR_RATIO = "error-ratio"  # how far autocorrelation changes the standard errors
    REPEATING_RESIDUALS = "repeating-residuals"  # part of the residuals recurs every loop
    HEAVY_TAILS = "heavy-tails"  # outliers in the residuals
    ROUNDING = "rounding"  # residuals are of the size of rounding errors
    NOISE_MODEL = "noise-model"  # the noise model and its parameters
    MODEL_ADVICE = "model-advice"  # the model's own remark on this input
    CHOICE = "choice"  # what was chosen automatically
    EXTRAPOLATION = "extrapolation"  # a record leaves the fitted range of inputs
    RECORD_PARAMETERS = "record-parameters"  # what the prediction of a record assumes for parameters of each record
    CHANGED_FILES = "changed-files"  # files of a saved fit, or of its model, differ from those that were saved
    OFFSET_REFITTED = "offset-refitted"  # the offset of a test record was refitted
    # identifiers
    SEQUENTIAL = "sequential"  # the result comes from a sequential identifier
    NOISE_BIAS = "noise-bias"  # output noise biases the estimate
    INVALID_MODEL = "invalid-model"  # the identified parameters are no valid model
    DIVERGED = "diverged"  # the estimate or its simulation is not finite
    ONE_STEP_ERROR = "one-step-error"  # the one-step error is far above the least that is possible
    STEP_SIZE = "step-size"  # the step size of a gradient method is not bounded
    INNOVATIONS = "innovations"  # size of the innovations relative to their prediction
    NOT_SETTLED = "not-settled"  # parameters change until the end of the record
    SIMULATION_ERROR = "simulation-error"  # error of the model driven by the input only
    SKIPPED_SAMPLES = "skipped-samples"  # samples that were missing, or that the filter could not use
    # samplers, profiles, calibration, design
    FIT_STATUS = "fit-status"  # the fit behind the result is not usable
    INCOMPLETE = "incomplete"  # the residuals show an error of the model that the noise model does not include
    CHAINS = "chains"  # convergence of the chains
    DIVERGENCES = "divergences"  # divergent transitions of NUTS
    PRIOR = "prior"  # the posterior is as wide as its prior, or inconsistent with it
    OPEN_SIDE = "open-side"  # no confidence limit on one side
    OTHER_OPTIMUM = "other-optimum"  # the likelihood is larger elsewhere than at the fit
    BLOCKS = "blocks"  # block length of a robust covariance
    ERRORS_DIFFER = "errors-differ"  # standard errors differ from those of the fit, and why
    CLOSES = "closes"  # the proposed input determines what the present data do not
    LOCAL = "local"  # the design holds near the fitted values
    # predictions, inverses and simulated records
    NOT_FINITE = "not-finite"  # the simulation is not finite
    MISSED = "missed"  # samples of a reference that cannot be followed
    # records and files
    FILE_FORMAT = "file-format"  # encoding, delimiter, decimal mark, units and other assumptions about a file
    COLUMN_CHOICE = "column-choice"  # a column was chosen by its name, unit or position
    LEFT_OUT = "left-out"  # rows, lines or columns of a file that are not used
    MISSING_VALUES = "missing-values"  # samples without output
    TIME_STEPS = "time-steps"  # uneven or repeated time stamps
    CURVES = "curves"  # how the rows of a file were divided into records
    PREPARED = "prepared"  # how a record was made or changed after it was measured
    UNITS = "units"  # a column was converted, or its unit assumed
    WEIGHTED = "weighted"  # samples are weighted by their standard deviations
    COARSE_CLOCK = "coarse-clock"  # time stamps repeat, so that the time of each sample is unknown
    # data quality
    NO_TIME = "no-time"  # no usable time stamps
    RATE = "rate"  # an output that is the rate of another quantity (a current)
    CLIPPED = "clipped"  # the output saturates
    SPIKES = "spikes"  # isolated outliers in the output
    CHATTER = "chatter"  # noise reverses the input
    OUTPUT_NOISE = "output-noise"  # the noise is large beside the range of the output
    SINGLE_VALUED = "single-valued"  # no hysteresis above the noise
    NOT_CLOSED = "not-closed"  # the largest loop does not close
    DEGRADING = "degrading"  # stiffness is lost from cycle to cycle
    DRIFT = "drift"  # the mean of like cycles drifts
    LAG = "lag"  # the output keeps moving after the input has turned
    SPEED_DEPENDENT = "speed-dependent"  # the output depends on the speed of the input
    DYNAMICS = "dynamics"  # the response changes with frequency as that of a resonance
    TOO_FEW_SAMPLES = "too-few-samples"  # fewer samples than branches or parameters need
    MINOR_LOOPS = "minor-loops"  # one amplitude alone: minor loops are not determined
    REVERSAL_CURVES = "reversal-curves"  # the records are first-order reversal curves


@dataclasses.dataclass(frozen=True)
class Note:
    """One finding.

    Attributes:
        code: what it is about.
        text: one sentence for people.
        severity: how much it matters.
    """

    code: Code
    text: str
    severity: Severity = Severity.INFO

    def __str__(self) -> str:
        return self.text

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {"code": str(self.code), "severity": str(self.severity), "text": self.text}

    @classmethod
    def of(cls, stored: Any) -> Note:
        """The note that `to_dict` described.

        Raises:
            KeyError, ValueError, TypeError: it is no such description.
        """
        return cls(Code(stored["code"]), str(stored["text"]), Severity(stored["severity"]))


def warn(code: Code, text: str) -> Note:
    """A note of severity `WARNING`."""
    return Note(code, text, Severity.WARNING)


def has(notes: Iterable[Note], *codes: Code) -> bool:
    """Whether any note has one of these codes."""
    return any(note.code in codes for note in notes)
