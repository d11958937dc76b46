"""What residuals say of the noise: correlated in time, repeating every loop, heavy-tailed; and which noise model that calls for."""

from __future__ import annotations

import dataclasses

import numpy as np

from hystfit.data.batch import Batch
from hystfit.metrics import autocorrelation_time
from hystfit.noise import Setting

REPEATS = 0.1  # part of the residuals' power, predicted on blocks left out, above which model error is said to repeat
_POINTS = 12
_BLOCKS = 4
_TAILS = 3.0  # excess kurtosis of the differences of residuals above which tails are called heavy


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """What residuals look like.

    Attributes:
        correlation_time: integrated autocorrelation time, samples; 1 for white residuals.
        repeating: part of their power that a curve over (input, direction) of other blocks of the records predicts; None where the
            input turns too rarely to tell. Negative: nothing.
        kurtosis: excess kurtosis of their differences in time (slow parts cancel); 0 for Gaussian noise.
        recommended: a noise model by name.
        reasons: one sentence each.
    """

    correlation_time: float
    repeating: float | None
    kurtosis: float
    recommended: str
    reasons: tuple[str, ...]

    def objections(self, noise: str) -> list[str]:
        """Reasons against a noise model by name; "auto" is least squares whose errors are widened by the correlation time."""
        if noise == "iid":
            return [reason for reason in self.reasons if self.recommended != "iid"]
        if noise == "student-t":
            return [reason for reason in self.reasons if self.correlation_time > 1.0]
        told = {"auto": ("repeats", "tails"), "ou": ("repeats",), "ar1": ("repeats",)}.get(noise, ())
        return [reason for reason in self.reasons if any(word in reason for word in told)]


def diagnose(batch: Batch, residuals: np.ndarray) -> Diagnosis:
    """Diagnose residuals of shape (R, T); samples of weight zero do not count."""
    used = np.asarray(batch.weight) > 0
    rows = [row[on] for row, on in zip(residuals, used, strict=True)]
    time = max(autocorrelation_time(row) for row in rows if row.size)
    share = repeating_share(Setting.of(batch), residuals)
    rough = np.concatenate([np.diff(row) for row in rows])
    kurtosis = (
        float(np.mean((rough - rough.mean()) ** 4) / max(float(np.var(rough)) ** 2, 1e-300) - 3)
        if rough.size > 30
        else 0.0
    )
    reasons: list[str] = []
    recommended = "iid" if time <= 1.0 else "ou"
    if time > 1.0:
        reasons.append(
            f"residuals are correlated over {time:.3g} samples: errors for independent noise would be too small"
        )
    if kurtosis > _TAILS:
        reasons.append(f"residuals have heavy tails (excess kurtosis {kurtosis:.2g}): outliers")
        recommended = "student-t" if time <= 1.0 else recommended
    if share is not None and share > REPEATS and time > 1.0:
        recommended = "discrepancy"
        reasons.append(
            f"{share:.0%} of the residuals' power repeats with input and direction: the model itself is in error, more cycles do not "
            "average that out, and only noise='discrepancy' allows for it"
        )
    if not reasons:
        reasons.append("residuals are white")
    return Diagnosis(time, share, kurtosis, recommended, tuple(reasons))


def repeating_share(setting: Setting, residuals: np.ndarray) -> float | None:
    """Part of the residuals' power that a piecewise linear curve over (input, direction), fitted to the other blocks, predicts."""
    place, rising, weight = (np.asarray(v) for v in (setting.place, setting.rising, setting.weight))
    used = weight > 0
    turns = sum(int(np.count_nonzero(np.diff(row[on].astype(int)))) for row, on in zip(rising, used, strict=True))
    if turns < 2 * _BLOCKS or used.sum() < 20 * _POINTS:
        return None
    hat = np.maximum(0.0, 1 - np.abs(place[used][:, None] * (_POINTS - 1) - np.arange(_POINTS)))
    up = rising[used][:, None]
    columns = np.hstack([hat * up, hat * ~up])
    r = residuals[used]
    block = np.concatenate([np.arange(n) * _BLOCKS // n for n in (int(on.sum()) for on in used) if n])
    left, total = 0.0, float(np.sum(r**2))
    if total == 0:
        return None
    for k in range(_BLOCKS):
        inside = block == k
        A, b = columns[~inside], r[~inside]
        weights = np.linalg.solve(A.T @ A + 1e-3 * len(b) / _POINTS * np.eye(A.shape[1]), A.T @ b)
        left += float(np.sum((r[inside] - columns[inside] @ weights) ** 2))
    return 1 - left / total
