"""Analysis of residuals: autocorrelation, error that recurs every loop, heavy tails, and the noise model that fits them."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from hystfit.inference.autocorrelation import autocorrelation_time, is_correlated
from hystfit.inference.blocks import chosen, gram, parts, qr
from hystfit.inference.noise.base import AbstractNoise
from hystfit.inference.noise.discrepancy import inducing_shapes
from hystfit.inference.noise.setting import Setting
from hystfit.inference.noise.slow_likelihood import POINTS, Contrasts, Samples, SlowNoiseFit, by_record, fit_slow_noise
from hystfit.inference.problem import Problem
from hystfit.outcome import Code, Note, Severity
from hystfit.outcome.table import number
from hystfit.params.relative_size import relative_size

CHANCE = 0.02  # p-value, under slow noise alone, below which the model error counts as repeating,
REPEATS = 0.02  # if it is at least this fraction of the residual variance
_LENGTH = 0.3  # length scale (relative to the input range) of the curves tested for
_LENGTHS = (0.1, 0.15, 0.22, 0.3, 0.45, 0.7)  # length scales, of which the most probable describes the curve
_SMALLEST = 1e-6  # of noise, over that of the residuals, that is plausible
_LARGEST = 3.0  # largest plausible standard deviation of noise, in that of the residuals
_TURNS = 8  # reversals of the input needed to detect a repeating error
_ENOUGH = 240  # samples needed for the same
TAILS = 3.0  # excess kurtosis of the differences of residuals above which tails are heavy
_DRAWS = 20_000  # of what chance alone gives: a p-value of `CHANCE` then has a standard error of 0.001
FEW = 60  # parameters up to which errors use the covariance of the noise; for more they grow by its correlation time

Derivatives = Callable[[], np.ndarray]


@dataclasses.dataclass(frozen=True)
class ResidualAnalysis:
    """Analysis of the residuals of a fit and of the noise in them."""

    on: np.ndarray  # the samples that count, shape (R, T), bool
    residual: Float[np.ndarray, " n"]  # output units times the square root of the weight, shape (n,)
    made: Callable[[], Samples]  # makes the samples in the form of noise models, which white residuals do not need
    # makes the weighted derivatives with respect to the parameters, shape (n, p), which these do not need either
    derivatives: Derivatives | None = None
    # fitted, shapes: `slow`, and the curves tested for, of an analysis beside others that share the samples
    fitted: SlowNoiseFit | None = None
    shapes: Float[np.ndarray, "n k"] | None = None

    @classmethod
    def of(
        cls, setting: Setting, residual: Float[np.ndarray, " m"], derivatives: Derivatives | None = None
    ) -> ResidualAnalysis:
        """From weighted residuals [y] and derivatives of all samples of a batch, record after record."""
        on = np.asarray(setting.weight) > 0
        return cls(on, residual[on.reshape(-1)], lambda: Samples.of(setting), derivatives)

    @classmethod
    def of_misfit(
        cls, problem: Problem, misfit: Float[np.ndarray, " m"], derivatives: Derivatives | None = None
    ) -> ResidualAnalysis:
        """From the misfit of all samples of a problem, shape (R T,), and derivatives as in `of`."""
        on = problem.used
        residual = chosen(misfit, on.reshape(-1)) * problem.scales.y
        return cls(on, residual, lambda: Samples.of(problem.host_setting), derivatives)

    @functools.cached_property
    def samples(self) -> Samples:
        """The samples that count."""
        return self.made()

    @functools.cached_property
    def basis(self) -> Float[np.ndarray, "n p"]:
        """Orthonormal basis of the derivatives."""
        if self.derivatives is None:
            return np.zeros((self.residual.size, 0))
        return qr(self.derivatives(), overwrite=True)[0]

    @functools.cached_property
    def rows(self) -> list[np.ndarray]:
        """Residuals record by record."""
        return by_record(self.residual, self.on)

    @functools.cached_property
    def correlation_time(self) -> float:
        """Integrated autocorrelation time, samples; 1 where no correlation is significant."""
        return max(autocorrelation_time(row) for row in self.rows if row.size)

    @functools.cached_property
    def correlated(self) -> bool:
        """Whether a record's residuals are correlated in time."""
        return any(is_correlated(row) for row in self.rows)

    @property
    def memory(self) -> str:
        """How the residuals are correlated in time, in words."""
        if not self.correlated:
            return "are not autocorrelated"
        if self.correlation_time > 1:
            return f"are autocorrelated over {number(self.correlation_time, '.3g')} samples"
        return "are autocorrelated, but the correlations cancel in their sum, as those of an oscillation do"

    @functools.cached_property
    def slow(self) -> SlowNoiseFit:
        """Slow and independent noise with the statistics of the residuals."""
        if self.fitted is not None:
            return self.fitted
        return fit_slow_noise(self.contrasts)

    @property
    def contrasts(self) -> Contrasts:
        """Those that know the noise, without a curve."""
        return Contrasts(self.samples, self.residual, self.basis, np.zeros((self.residual.size, 0)))

    @functools.cached_property
    def repeating(self) -> Repeating | None:
        """Error that recurs with input and direction; None where the input has too few reversals, or residuals are white."""
        return _repeating(self) if self.correlated else None

    @functools.cached_property
    def noise(self) -> SlowNoiseFit | None:
        """`slow`, with a curve over input and direction on top where `repeating` is significant; None where neither is plausible.

        The restricted likelihood does not bound noise that the fit can absorb (slower than the record, or shaped like the model's
        derivatives): it can become many times larger than the residuals, and every standard error with it.
        """
        if self.repeating is not None and self.repeating.shown and self._plausible(self._curved):
            return self._curved
        return self.slow if self._plausible(self.slow) else None

    @property
    def of_errors(self) -> SlowNoiseFit | None:
        """`noise` for the errors of a least-squares fit; None for uncorrelated residuals, or without the parameters' derivatives."""
        return self.noise if self.correlated and self.basis.shape[1] else None

    @functools.cached_property
    def _curved(self) -> SlowNoiseFit:
        slow = self.slow.noise
        point = np.array([(slow.white / slow.slow) ** 2]), np.array([slow.time])
        length = min(_LENGTHS, key=lambda length: self._with_curve(length).at(*point)[0][0])
        return fit_slow_noise(self._with_curve(length))

    @functools.cached_property
    def curve_size(self) -> float | None:
        """Standard deviation of curves over input and direction that leave the repeating part of the residuals; None without one.

        The model absorbs most of such a curve, so the curve is larger than its remainder. The estimate is shrunk, and slow noise takes
        some of it: on average it is two thirds of the truth.
        """
        if self.repeating is None:
            return None
        size = float(self._with_curve(_LENGTH).expected) ** 0.5
        return size if np.isfinite(size) and size > 0 else None

    def _plausible(self, fit: SlowNoiseFit) -> bool:
        noise = fit.noise
        curve = noise.loop * float(np.sqrt(np.mean(np.sum(noise.shapes**2, axis=1)))) if noise.shapes.shape[1] else 0.0
        rms = float(np.sqrt(np.mean(self.residual**2)))
        # Residuals that the derivatives explain, where a solver stopped early, leave no noise at all.
        return max(noise.slow, curve) <= _LARGEST * rms and bool(np.hypot(noise.white, noise.slow) >= _SMALLEST * rms)

    def _with_curve(self, length: float) -> Contrasts:
        power = (self.repeating.share if self.repeating else 0.0) * float(np.mean(self.residual**2))
        return Contrasts(self.samples, self.residual, self.basis, curves(self.samples, length), power, length)


def analyze(problem: Problem, x: np.ndarray) -> ResidualAnalysis:
    """Analysis of the residuals at physical x, shape (p,)."""
    linear = problem.with_loss("linear").linearization(x)
    live = ~problem.on_bound(x)
    few = live.any() and int(live.sum()) <= FEW
    columns = lambda: linear.columns(live) * relative_size(problem.space, x)[live]
    return ResidualAnalysis.of_misfit(problem, linear.misfit, columns if few else None)


@dataclasses.dataclass(frozen=True)
class Repeating:
    """A smooth curve over (input, direction) in residuals: its share of their variance, and its p-value under slow noise alone."""

    share: float
    chance: float

    @property
    def shown(self) -> bool:
        """Whether it is significant."""
        return self.share > REPEATS and self.chance < CHANCE


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """Which noise model the residuals recommend, and their deviations from white Gaussian noise as notes; none for white ones."""

    recommended: str
    findings: tuple[Note, ...]

    def objections(self, noise: type[AbstractNoise]) -> list[Note]:
        """Findings that a noise model does not allow for."""
        return [note for note in self.findings if note.code not in noise.covers]


def diagnose(analysis: ResidualAnalysis, noise: str = "") -> Diagnosis:
    """Look for autocorrelation, heavy tails and repeating error; the noise model in use, by name, is not recommended again."""
    correlated, repeating, kurtosis = analysis.correlated, analysis.repeating, excess_kurtosis(analysis.rows)
    findings: list[Note] = []
    recommended = "ou" if correlated else "iid"
    if correlated:
        small = ": standard errors for independent noise would be too small" if analysis.correlation_time > 1 else ""
        findings.append(Note(Code.CORRELATED_RESIDUALS, f"residuals {analysis.memory}{small}"))
    if kurtosis > TAILS:
        text = (
            f"residuals have heavy tails (excess kurtosis {number(kurtosis, '.2g')}): there are outliers, or the error of the model is "
            "large in a few places"
        )
        findings.append(Note(Code.HEAVY_TAILS, text, Severity.WARNING))
        recommended = "ou" if correlated else "student-t"
    if repeating is not None and repeating.shown:
        recommended = "discrepancy"
        including = "The noise model" if noise == "discrepancy" else "noise='discrepancy'"
        text = (
            f"{100 * repeating.share:.0f} % of the residual variance recurs every loop: the model is systematically wrong, and more cycles "
            f"will not help. {including} includes this in the errors"
        )
        findings.append(Note(Code.REPEATING_RESIDUALS, text, Severity.WARNING))
    return Diagnosis(recommended, tuple(findings))


def excess_kurtosis(rows: list[np.ndarray]) -> float:
    """Excess kurtosis of the differences of residuals, in which slow noise cancels; 0 for Gaussian noise and below 30 samples."""
    differences = np.concatenate([np.diff(row) for row in rows])
    if differences.size <= 30:
        return 0.0
    differences -= differences.mean()
    squares = np.square(differences, out=differences)  # a power of 4 takes several times as long
    squares /= max(float(squares.mean()), 1e-300)
    return float(np.mean(np.square(squares))) - 3


def _repeating(analysis: ResidualAnalysis) -> Repeating | None:
    """The score test of a variance component (Lin 1997) for a Gaussian process on either branch, in the inducing points of
    `LoopDiscrepancy`, against the slow and independent noise fitted without it.

    Slow noise can resemble one pass of the curve; the curve, however, is the same in every loop. Directions of the parameters are
    projected out.
    """
    samples, residual, basis = analysis.samples, analysis.residual, analysis.basis
    turns = sum(int(np.count_nonzero(np.diff(row))) for row in samples.by_record(samples.rising.astype(int)))
    if turns < _TURNS or samples.gap.size < _ENOUGH or not np.any(residual):
        return None
    columns = curves(samples) if analysis.shapes is None else analysis.shapes
    joint, p = gram([basis, residual, columns], analysis.slow.noise.solve), basis.shape[1]
    joint = joint[p:, p:] - joint[p:, :p] @ np.linalg.solve(joint[:p, :p], joint[:p, p:])
    size, axes = np.linalg.eigh(joint[1:, 1:])
    kept = size > 1e-8 * size[-1]
    size, axes = size[kept], axes[:, kept]
    unit = np.sqrt(size[-1])  # without it the squares of residuals that are rounding errors overflow
    score, size = axes.T @ joint[1:, 0] / unit, size / size[-1]  # under slow noise alone normal with variances `size`
    ideal = _chi_squares(size.size) @ size
    chance = (1 + np.count_nonzero(ideal >= score @ score)) / (_DRAWS + 1)
    strengths = np.geomspace(1e-3, 1e3, 61)
    variances = size + strengths[:, None] * size**2  # with a curve of that variance
    strength = strengths[np.argmin(np.sum(np.log(variances) + score**2 / variances, axis=1))]
    curve = columns @ (axes @ (strength * score / (1 + strength * size))) / unit
    curve = curve - basis @ (basis.T @ curve)
    return Repeating(float(np.sum(curve**2) / np.sum(residual**2)), float(chance))


@functools.lru_cache(maxsize=4)  # many fits one after another draw the same numbers
def _chi_squares(count: int) -> np.ndarray:
    return np.random.default_rng(0).chisquare(1, (_DRAWS, count))


def curves(samples: Samples, length: float = _LENGTH) -> Float[np.ndarray, "n k"]:
    """Columns that span smooth curves over the input, on either branch, times the root of the weights."""
    out, root = np.empty((samples.place.size, 2 * POINTS), order="F"), np.sqrt(samples.weight)
    for part in parts(len(out), 2 * POINTS):
        shapes = inducing_shapes(samples.place[part], length, POINTS, on=np)
        for half, branch in zip(np.split(out[part], 2, axis=1), (samples.rising, ~samples.rising), strict=True):
            np.multiply(shapes, (root * branch)[part, None], out=half)
    return out
