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

    `docs/codes.toml` has the meaning of each and what to do, in the words of the command line.
    """

    # fits
    SOLVER = "solver"
    POOR_FIT = "poor-fit"
    ACCURACY = "accuracy"
    ROUGH_FIT = "rough-fit"
    TEST_ERROR = "test-error"
    LEFT_OUT_ERROR = "left-out-error"
    MANY_WEIGHTS = "many-weights"
    OTHER_FAMILY = "other-family"
    INITIAL_STATE = "initial-state"
    LAST_HALF_CYCLE = "last-half-cycle"
    MEASUREMENT_NOISE = "measurement-noise"
    MODEL_MISMATCH = "model-mismatch"
    NO_LOOP = "no-loop"
    NOT_DETERMINED = "not-determined"
    NO_INFLUENCE = "no-influence"
    AT_BOUND = "at-bound"
    ZERO_WEIGHTS = "zero-weights"
    REGULARIZED = "regularized"
    CORRELATED_RESIDUALS = "correlated-residuals"
    ERROR_RATIO = "error-ratio"
    REPEATING_RESIDUALS = "repeating-residuals"
    HEAVY_TAILS = "heavy-tails"
    ROUNDING = "rounding"
    NOISE_MODEL = "noise-model"
    MODEL_ADVICE = "model-advice"
    CHOICE = "choice"
    EXTRAPOLATION = "extrapolation"
    RECORD_PARAMETERS = "record-parameters"
    CHANGED_FILES = "changed-files"
    OFFSET_REFITTED = "offset-refitted"
    SAME_FILE = "same-file"
    # identifiers
    SEQUENTIAL = "sequential"
    NOISE_BIAS = "noise-bias"
    INVALID_MODEL = "invalid-model"
    DIVERGED = "diverged"
    ONE_STEP_ERROR = "one-step-error"
    STEP_SIZE = "step-size"
    INNOVATIONS = "innovations"
    NOT_SETTLED = "not-settled"
    SIMULATION_ERROR = "simulation-error"
    SKIPPED_SAMPLES = "skipped-samples"
    # samplers, profiles, calibration, design
    FIT_STATUS = "fit-status"
    INCOMPLETE = "incomplete"
    CHAINS = "chains"
    DIVERGENCES = "divergences"
    PRIOR = "prior"
    INFLUENCE = "influence"
    OPEN_SIDE = "open-side"
    OTHER_OPTIMUM = "other-optimum"
    BLOCKS = "blocks"
    ERRORS_DIFFER = "errors-differ"
    CLOSES = "closes"
    LOCAL = "local"
    # predictions, inverses and simulated records
    NOT_FINITE = "not-finite"
    MISSED = "missed"
    # records and files
    FILE_FORMAT = "file-format"
    COLUMN_CHOICE = "column-choice"
    LEFT_OUT = "left-out"
    MISSING_VALUES = "missing-values"
    TIME_STEPS = "time-steps"
    CURVES = "curves"
    PREPARED = "prepared"
    UNITS = "units"
    WEIGHTED = "weighted"
    COARSE_CLOCK = "coarse-clock"
    # data quality
    NO_TIME = "no-time"
    RATE = "rate"
    CLIPPED = "clipped"
    SPIKES = "spikes"
    CHATTER = "chatter"
    OUTPUT_NOISE = "output-noise"
    DECADES = "decades"
    RECORDS_DIFFER = "records-differ"
    QUANTITY_DIFFERS = "quantity-differs"
    SINGLE_VALUED = "single-valued"
    NOT_CLOSED = "not-closed"
    DEGRADING = "degrading"
    FAILURE = "failure"
    DRIFT = "drift"
    LAG = "lag"
    DELAY = "delay"
    SPEED_DEPENDENT = "speed-dependent"
    CROSSING = "crossing"
    FALLING = "falling"
    ENERGY_GAIN = "energy-gain"
    DYNAMICS = "dynamics"
    TOO_FEW_SAMPLES = "too-few-samples"
    MINOR_LOOPS = "minor-loops"
    REVERSAL_CURVES = "reversal-curves"
    CONDITIONS = "conditions"


@dataclasses.dataclass(frozen=True)
class Note:
    """One finding.

    Attributes:
        code: what it is about.
        text: one sentence.
        severity: how much it matters.
        option: of `hystfit.read` or of a fit, which the note proposes: its name and value. It is not saved.
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
