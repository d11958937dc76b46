"""What residuals say of the noise: correlated in time, repeating every loop, heavy-tailed; and which noise model that calls for."""

from __future__ import annotations

import dataclasses
import functools

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hystfit.data.batch import Batch
from hystfit.inference.noise import Setting, inducing_shapes
from hystfit.inference.noise.serial import Contrasts, Samples, SlowNoiseFit, fit_slow_noise
from hystfit.results.metrics import autocorrelation_time, is_correlated

CHANCE = 0.02  # probability under slow noise alone below which model error is said to repeat,
REPEATS = 0.02  # if it is at least this part of the residuals' power
_POINTS, _LENGTH = (
    12,
    0.3,
)  # of the curves over the input that it is looked for in: inducing points, and smoothness in parts of the range
_LENGTHS = (0.1, 0.15, 0.22, 0.3, 0.45, 0.7)  # among which its description takes the most probable
_LARGEST = 3.0  # standard deviation of noise, in those of the residuals, up to which it is believed
_TURNS = 8  # of the input, at least, to tell what repeats
_ENOUGH = 240  # samples, for the same
_TAILS = 3.0  # excess kurtosis of the differences of residuals above which tails are called heavy
_DRAWS = 20_000


@dataclasses.dataclass(frozen=True)
class Leftover:
    """What a fit leaves, with the directions in which it could have left something else.

    Attributes:
        samples: those that count.
        residual: output units times the square root of the weight, shape (n,).
        basis: orthonormal columns that span the derivatives by the parameters, likewise weighted, shape (n, p).
    """

    samples: Samples
    residual: Float[np.ndarray, " n"]
    basis: Float[np.ndarray, "n p"]

    @classmethod
    def of(
        cls, batch: Batch, residual: Float[np.ndarray, " m"], jacobian: Float[np.ndarray, "m p"] | None = None
    ) -> Leftover:
        """From residuals and derivatives of all samples of a batch, record after record."""
        samples = Samples.of(Setting.of(batch))
        on = samples.on.reshape(-1)
        basis = np.zeros((int(on.sum()), 0)) if jacobian is None else np.linalg.qr(jacobian[on])[0]
        return cls(samples, residual[on], basis)

    @functools.cached_property
    def rows(self) -> list[np.ndarray]:
        """Residuals record by record."""
        return np.split(self.residual, np.cumsum(self.samples.on.sum(axis=1))[:-1])

    @functools.cached_property
    def correlation_time(self) -> float:
        """Integrated autocorrelation time, samples; 1 where no correlation is significant."""
        return max(autocorrelation_time(row) for row in self.rows if row.size)

    @functools.cached_property
    def correlated(self) -> bool:
        """Whether a record's residuals are correlated in time."""
        return any(is_correlated(row) for row in self.rows)

    @functools.cached_property
    def slow(self) -> SlowNoiseFit:
        """Slow and independent noise with the statistics of the residuals."""
        none = np.zeros((self.residual.size, 0))
        return fit_slow_noise(Contrasts(self.samples, self.residual, self.basis, none))

    @functools.cached_property
    def repeating(self) -> Repeating | None:
        """Error that repeats with input and direction; None where the input turns too rarely to tell, or residuals are white."""
        return _repeating(self) if self.correlated else None

    @functools.cached_property
    def noise(self) -> SlowNoiseFit | None:
        """`slow`, with a curve over input and direction on top where `repeating` shows one; None where neither is believable.

        Noise that a fit could have swallowed whole (slower than the record, or shaped like the model's derivatives) may be of any size: the
        restricted likelihood then makes it many times larger than all that is seen of it, and every error bar with it.
        """
        if self.repeating is not None and self.repeating.shown and self._believable(self._curved):
            return self._curved
        return self.slow if self._believable(self.slow) else None

    @functools.cached_property
    def _curved(self) -> SlowNoiseFit:
        own = self.slow.noise
        ratio = (own.white / own.slow) ** 2
        fitted = [self._with(length) for length in _LENGTHS]
        return fit_slow_noise(min(fitted, key=lambda contrasts: contrasts.at(ratio, own.time)[0]))

    @functools.cached_property
    def curve_size(self) -> float | None:
        """Standard deviation of curves over input and direction that would leave as much as is seen of one; None where nothing is seen.

        A model swallows most of such a curve, so that it is larger than what it leaves. What is seen is shrunk, and slow noise has its
        part of it: on average two thirds of the truth.
        """
        if self.repeating is None:
            return None
        size = self._with(_LENGTH).expected ** 0.5
        return size if np.isfinite(size) and size > 0 else None

    def _believable(self, found: SlowNoiseFit) -> bool:
        noise = found.noise
        curve = noise.loop * float(np.sqrt(np.mean(np.sum(noise.shapes**2, axis=1)))) if noise.shapes.shape[1] else 0.0
        return max(noise.slow, curve) <= _LARGEST * float(np.sqrt(np.mean(self.residual**2)))

    def _with(self, length: float) -> Contrasts:
        power = (self.repeating.share if self.repeating else 0.0) * float(np.mean(self.residual**2))
        return Contrasts(self.samples, self.residual, self.basis, curves(self.samples, length), power)


@dataclasses.dataclass(frozen=True)
class Repeating:
    """A smooth curve over (input, direction) in residuals.

    Attributes:
        share: its part of their power.
        chance: probability of as much under slow noise alone.
    """

    share: float
    chance: float

    @property
    def shown(self) -> bool:
        """Too much for chance."""
        return self.share > REPEATS and self.chance < CHANCE


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """What residuals look like.

    Attributes:
        correlated: in time.
        correlation_time: integrated autocorrelation time, samples; 1 for white residuals.
        repeating: part of their power that a smooth curve over (input, direction) makes; None where residuals are white or the input
            turns too rarely to tell.
        chance: probability of so much under slow noise alone; None likewise.
        kurtosis: excess kurtosis of their differences in time (slow parts cancel); 0 for Gaussian noise.
        recommended: a noise model by name.
        reasons: one sentence each.
    """

    correlated: bool
    correlation_time: float
    repeating: float | None
    chance: float | None
    kurtosis: float
    recommended: str
    reasons: tuple[str, ...]

    def objections(self, noise: str) -> list[str]:
        """Reasons against a noise model by name; "auto" is least squares with errors for slow and independent noise."""
        if noise == "iid":
            return [reason for reason in self.reasons if self.recommended != "iid"]
        if noise == "student-t":
            return [reason for reason in self.reasons if self.correlated]
        told = {"auto": ("repeats", "tails"), "ou": ("repeats",), "ar1": ("repeats",)}.get(noise, ())
        return [reason for reason in self.reasons if any(word in reason for word in told)]


def diagnose(left: Leftover) -> Diagnosis:
    """Diagnose what a fit leaves."""
    time = left.correlation_time
    found = left.repeating
    rough = np.concatenate([np.diff(row) for row in left.rows])
    kurtosis = (
        float(np.mean((rough - rough.mean()) ** 4) / max(float(np.var(rough)) ** 2, 1e-300) - 3)
        if rough.size > 30
        else 0.0
    )
    reasons: list[str] = []
    recommended = "ou" if left.correlated else "iid"
    if left.correlated:
        reasons.append(
            f"residuals are correlated over {time:.3g} samples: errors for independent noise would be too small"
        )
    if kurtosis > _TAILS:
        reasons.append(f"residuals have heavy tails (excess kurtosis {kurtosis:.2g}): outliers")
        recommended = recommended if left.correlated else "student-t"
    if found is not None and found.shown:
        recommended = "discrepancy"
        reasons.append(
            f"{found.share:.0%} of the residuals' power repeats with input and direction: the model itself is in error, more cycles do not "
            "average that out, and only noise='discrepancy' allows for it"
        )
    if not reasons:
        reasons.append("residuals are white")
    numbers = (None, None) if found is None else (found.share, found.chance)
    return Diagnosis(left.correlated, time, *numbers, kurtosis, recommended, tuple(reasons))


def _repeating(left: Leftover) -> Repeating | None:
    """The score test of a variance component (Lin 1997) for a Gaussian process on either branch, in the inducing points of
    `LoopDiscrepancy`, against the slow and independent noise fitted without it.

    That noise may look much like one pass of the curve; what tells them apart is that the curve is the same in every loop. What the
    fit's parameters can imitate is left out.
    """
    samples = left.samples
    turns = sum(int(np.count_nonzero(np.diff(row))) for row in _by_record(samples, samples.rising.astype(int)))
    if turns < _TURNS or samples.gap.size < _ENOUGH or not np.any(left.residual):
        return None
    columns = curves(samples, _LENGTH)
    rows = np.asfortranarray(np.column_stack([left.basis, left.residual, columns]))
    gram, p = rows.T @ left.slow.noise.solve(rows), left.basis.shape[1]
    gram = gram[p:, p:] - gram[p:, :p] @ np.linalg.solve(gram[:p, :p], gram[:p, p:])
    size, axes = np.linalg.eigh(gram[1:, 1:])
    kept = size > 1e-8 * size[-1]
    size, axes = size[kept], axes[:, kept]
    score = axes.T @ gram[1:, 0]  # under slow noise alone normal with variances `size`
    ideal = np.random.default_rng(0).chisquare(1, (_DRAWS, size.size)) @ size
    chance = (1 + np.count_nonzero(ideal >= score @ score)) / (_DRAWS + 1)
    strengths = np.geomspace(1e-3, 1e3, 61) / size[-1]
    variances = size + strengths[:, None] * size**2  # with a curve of that variance
    strength = strengths[np.argmin(np.sum(np.log(variances) + score**2 / variances, axis=1))]
    curve = columns @ (axes @ (strength * score / (1 + strength * size)))
    curve = curve - left.basis @ (left.basis.T @ curve)
    return Repeating(float(np.sum(curve**2) / np.sum(left.residual**2)), float(chance))


def curves(samples: Samples, length: float) -> Float[np.ndarray, "n k"]:
    """Columns of which smooth curves over the input are made, on either branch, times the root of the weights."""
    shapes = np.asarray(inducing_shapes(jnp.asarray(samples.place), jnp.asarray(length), _POINTS))
    shapes = shapes * np.sqrt(samples.weight)[:, None]
    return np.hstack([shapes * samples.rising[:, None], shapes * ~samples.rising[:, None]])


def _by_record(samples: Samples, values: np.ndarray) -> list[np.ndarray]:
    return np.split(values, np.cumsum(samples.on.sum(axis=1))[:-1])
