"""The status of a result: one enumeration for all verbs, each member with advice."""

from __future__ import annotations

import enum
from typing import Any


class Status(enum.StrEnum):
    """How a verb ended. Only `OK` is usable without reservation; `advice` is the remedy for the others."""

    OK = "ok"
    NOT_CONVERGED = "not-converged"
    DIVERGING = "diverging"
    ROUGH = "rough"
    POOR = "poor"
    NO_LOOP = "no-loop"
    POOR_FIT = "poor-fit"
    INCOMPLETE = "incomplete"
    BIASED = "biased"
    UNDETERMINED = "undetermined"
    INCONSISTENT = "inconsistent"
    DIVERGED = "diverged"
    FAILED = "failed"
    OPEN = "open"
    MISCALIBRATED = "miscalibrated"
    TOO_FEW = "too-few"
    NO_MODEL = "no-model"
    MISSED = "missed"
    NOT_FINITE = "not-finite"
    FIT_NOT_USABLE = "fit-not-usable"
    SKIPPED = "skipped"
    UNTESTED = "untested"
    PARTIAL = "partial"

    @property
    def usable(self) -> bool:
        """Whether the numbers can be used as they are; the exit status of a verb is 0 exactly then."""
        return self is Status.OK

    def advice(self, verb: str = "fit") -> str:
        """What to do, in one sentence.

        Args:
            verb: the verb whose result this is; a chain and a solver that have not converged need different remedies.
        """
        return _OF_VERB.get((verb, self)) or _ADVICE[self]


_ADVICE = {
    Status.OK: "usable",
    Status.NOT_CONVERGED: "the solver did not converge: use more starts, method='trf', or fix what the data do not determine",
    Status.POOR: "the model does not describe these data, see the verdict: hystfit compare shows other models",
    Status.ROUGH: (
        "the model describes the loop only roughly, see the verdict: try hystfit compare, or use it where such an error is acceptable"
    ),
    Status.NO_LOOP: "these data show no loop, a curve describes them; if a loop is expected, measure more or larger whole cycles",
    Status.POOR_FIT: "the model does not describe the data: improve the fit before using its uncertainty",
    Status.INCOMPLETE: (
        "the residuals show that the model is incomplete, and the bias of its parameters exceeds the intervals: add "
        "the missing part (creep, a lag, more terms); noise='discrepancy' includes only what recurs every loop"
    ),
    Status.BIASED: (
        "noise biases the rate: use output-error least squares (method='lm'), or integrated_regression where the method "
        "must be linear"
    ),
    Status.UNDETERMINED: (
        "the samples or reversals are too few for all parameters: measure more of them at several amplitudes, or take a model of fewer "
        "parameters"
    ),
    Status.INCONSISTENT: (
        "the innovations of the filter do not have their predicted size: change noise or walk as the note says, or use least "
        "squares (method='lm')"
    ),
    Status.DIVERGED: "the estimate diverged: raise the floor or lower mu (gradient correction), or decimate by input increment",
    Status.DIVERGING: (
        "parts of the posterior may be missing: fix the parameters that the data do not determine or give them a prior, or draw "
        "with sampler='emcee' or 'nested', which use no gradients"
    ),
    Status.FAILED: "nothing could be fitted: see the notes, and fix parameters that the data do not determine",
    Status.OPEN: "the data do not bound some parameters: measure at other amplitudes (hystfit design), or fix them",
    Status.MISCALIBRATED: (
        "the error bars of this setup are not calibrated: try another noise model, or another input (hystfit design)"
    ),
    Status.TOO_FEW: "too few replicates for a conclusion: use 200 or more",
    Status.NO_MODEL: "these data determine no model: measure full cycles at several amplitudes",
    Status.MISSED: "some samples of the reference cannot be reached: see the status of each sample",
    Status.NOT_FINITE: "the simulation is not finite: the model is unstable on this input or at this sampling rate",
    Status.FIT_NOT_USABLE: "the fit behind this result is not usable: see its status",
    Status.SKIPPED: "the data were not found, so nothing was run",
    Status.PARTIAL: "some loops could not be fitted, or their fits are not usable: the table gives the reason for each",
    Status.UNTESTED: "these data test none of the assumptions: measure a record with nested loops",
}
_OF_VERB = {
    ("sample", Status.NOT_CONVERGED): "the chains have not converged: draw more, or fix what the data do not determine",
    ("identify", Status.NOT_CONVERGED): (
        "the sequential method has not converged: use more passes, a better start, or least squares (method='lm')"
    ),
    ("identify", Status.FAILED): (
        "the identified rate is not positive: decimate by input increment, or use output-error least squares (method='lm')"
    ),
    ("identify", Status.POOR): (
        "the simulation does not follow the record: use output-error least squares (method='lm') or another model"
    ),
    (
        "population",
        Status.PARTIAL,
    ): "some devices have no usable fit and are left out: the notes give the reason for each",
    (
        "population",
        Status.NOT_CONVERGED,
    ): "the chains have not converged: draw more, or fix parameters in which devices do not differ",
    ("batch", Status.FAILED): "no loop has a usable fit: the table gives the reason for each",
    (
        "calibrate",
        Status.OK,
    ): "the error bars of this setup are calibrated, as far as this number of replicates can show",
}


class WithStatus:
    """What all results share: whether their `status` allows using them, and what to do about it."""

    status: Any  # a `Status`: a field or a property
    verb: Any = "fit"  # whose advice applies

    @property
    def usable(self) -> bool:
        """Whether the numbers can be used as they are: the status is `Status.OK`."""
        return self.status.usable

    @property
    def advice(self) -> str:
        """What to do about the status, in one sentence."""
        return self.status.advice(self.verb)
