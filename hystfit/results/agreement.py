"""Standard errors of other verbs beside those of the fit: where they differ, a note says by how much and why."""

from __future__ import annotations

from collections.abc import Mapping

from hystfit.outcome import Code, Note
from hystfit.results.result import FitResult

SIMILAR = 1.25  # ratio up to which two standard errors count as equal


def differences(result: FitResult, errors: Mapping[str, float | None], source: str, reason: str) -> list[Note]:
    """A note where standard errors by parameter (None: unknown) differ from those of a fit; none where they agree within `SIMILAR`."""
    ratios = {}
    for name, error in errors.items():
        reported = result[name].stderr if name in result.free_names else None
        if error and reported and not 1 / SIMILAR < error / reported < SIMILAR:
            ratios[name] = error / reported
    if not ratios:
        return []
    name = max(ratios, key=lambda one: max(ratios[one], 1 / ratios[one]))
    others = f" ({len(ratios)} parameters differ)" if len(ratios) > 1 else ""
    text = f"standard error of {name} by {source} {errors[name]:.3g}, by the fit {result[name].stderr:.3g}{others}: {reason}"
    return [Note(Code.ERRORS_DIFFER, text)]
