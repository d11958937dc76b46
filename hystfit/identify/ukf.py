"""Joint unscented Kalman filter of states and parameters in square-root form (Minase et al. 2010)."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import ParameterError
from hystfit.identify import filter_verdict, tuning
from hystfit.identify.base import AbstractIdentifier, Info, Judgment, Run, Sample, run_stream
from hystfit.identify.sigma_points import Unscented, triangular
from hystfit.inference.fittable import check_fittable
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.shapes import Scalar
from hystfit.outcome import Code, Note, Severity, Status
from hystfit.params.coordinates import Coordinates

_STATE_PRIOR, _STATE_WALK = 0.1, 2e-5  # parts of a state's range over the records


class UkfState(NamedTuple):
    """State of the filter between two samples."""

    mean: Float[Array, " n"]  # states of the model, then parameters z: shape (n,)
    # lower triangular; root root^T is the covariance before the next step (process noise included)
    root: Float[Array, "n n"]
    u: Scalar  # last input
    # number of the record (-1 before the first); numbers of samples used, missing and rejected; sum of the normalized innovations squared
    # (NIS), and their moving average
    tally: Float[Array, "6"]


class Ukf(AbstractIdentifier):
    """States and parameters of any model, estimated sample by sample.

    The sigma points of [state, z] go through one `step` of the model, so state and output come from one set and no separate
    output function is needed; process noise enters between the samples. The new root follows from one QR factorization
    of weighted deviations from which the gain is subtracted (Joseph's form), so any gain is allowed: it is zero for parameters
    of rate-independent parts while the input rests, when the output has no information about them.

    The covariance is that of the filter's assumptions. It is optimistic and must not be used as an error bar.

    Attributes:
        coordinates: maps between z and the model.
        z0: start, shape (p,).
        prior: root of the covariance before the first sample, shape (n, n), block diagonal in states and z.
        walk: standard deviations of the process noise per sample, shape (n,).
        noise: standard deviation of the measurement [y].
        resting: which of [state, z] are fixed while the input rests, shape (n,).
        still: largest change of the input that counts as resting [u].
        memory: samples over which the NIS is averaged.
        caution, settling: extra noise at the start in units of `noise`, and the samples over which it decays.
        free: names of the parameters.
        scheme: sigma points.
    """

    method: ClassVar[str] = "ukf"
    solved: ClassVar[tuple[str, ...]] = ()

    coordinates: Coordinates
    z0: Float[Array, " p"]
    prior: Float[Array, "n n"]
    walk: Float[Array, " n"]
    noise: Scalar
    resting: Bool[Array, " n"]
    still: Scalar
    memory: Scalar
    caution: Scalar
    settling: Scalar
    free: tuple[str, ...] = eqx.field(static=True)
    scheme: Unscented = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        model: AbstractHysteresis,
        data: Record | Dataset | Sequence[Record],
        *,
        fix: Sequence[str] | Mapping[str, float] = (),
        free: Sequence[str] = (),
        only: Sequence[str] | None = None,
        start: Literal["data", "model"] = "data",
        noise: float | None = None,
        prior: float | Mapping[str, float] | np.ndarray | None = None,
        walk: float = 3e-5,
        state_prior: float | np.ndarray | None = None,
        state_walk: float | np.ndarray | None = None,
        still: float = 0.0,
        caution: float | None = None,
        settling: float | None = None,
        hold: Literal["auto", "all", "none"] = "auto",
        alpha: float = 1.0,
        beta: float = 2.0,
        kappa: float = 0.0,
    ) -> Ukf:
        """A filter scaled to records.

        Args:
            model: any model; its values are the start with start="model", else those of `model.start(records)`.
            data: the records it will run on; ranges and noise are estimated from them.
            fix, free: parameters by name, as in `ParameterSpace`.
            only: the free parameters; all others are fixed. It excludes `fix` and `free`.
            start: where the parameters start.
            noise: measurement standard deviation [y]; None estimates it.
            prior: standard deviation of z at the start: one number, numbers by name, or a covariance of shape (p, p). None is 0.5
                (65 %) for parameters with a bound and 0.1 of their natural size for the others with start="model", 0.2 and 0.02
                with start="data".
            walk: random walk of z, standard deviation per sample.
            state_prior, state_walk: the same for the states, one number or shape (states,); None is 0.1 and 2e-5 of their ranges
                over the records.
            caution: extra measurement noise at the start [y], without which a filter far from the truth trusts its first,
                linearized steps too much and stops adapting; None is three times the RMS simulation error of the start, 0 is the
                plain filter.
            settling: samples over which `caution` decays by the factor e; None is a twentieth of all.
            still: largest change of the input that counts as resting [u].
            hold: parameters that are fixed while the input rests: those of rate-independent parts ("auto"), "all" or "none".
            alpha, beta, kappa: of the sigma points, see `Unscented`; a negative central weight gives a warning.

        Raises:
            ParameterError: a setting out of range, a covariance that is not symmetric and positive definite, an unknown name.
            ModelError, DataError: the model cannot be fitted to these data.
        """
        data = Dataset.of(data)
        check_fittable(model, data)
        if start not in ("data", "model") or hold not in ("auto", "all", "none"):
            raise ParameterError(f"start must be data or model, hold auto, all or none; got {start!r} and {hold!r}")
        tuning.not_negative(walk, "walk")
        tuning.not_negative(still, "still")
        if start == "data":
            model = model.start(list(data))
        space = tuning.identified_space(model, data, fix=fix, free=free, only=only)
        ranges = tuning.state_ranges(space.template, data)
        s, p = ranges.size, len(space)
        state_deviation = tuning.deviations(state_prior, _STATE_PRIOR * ranges, "state_prior")
        drift = tuning.deviations(state_walk, _STATE_WALK * ranges, "state_walk")
        root = np.zeros((s + p, s + p))
        root[:s, :s] = np.diag(state_deviation)
        root[s:, s:] = tuning.parameter_root(space, prior, near=start == "data")
        noise = tuning.measurement_noise(data, space.scales.y, noise)
        length = sum(int(record.used.sum()) for record in data)
        caution = tuning.initial_error(space, data) if caution is None else tuning.not_negative(caution, "caution")
        settling = length / 20 if settling is None else tuning.not_negative(settling, "settling")
        return cls(
            coordinates=space.coordinates,
            z0=jnp.asarray(space.unconstrained(space.vector(space.template))),
            prior=jnp.asarray(root),
            walk=jnp.asarray(np.concatenate([drift, np.full(p, walk)])),
            noise=jnp.asarray(noise),
            resting=jnp.asarray(np.concatenate([np.zeros(s, bool), tuning.fixed_at_rest(space, hold)])),
            still=jnp.asarray(float(still)),
            memory=jnp.asarray(0.1 * length),
            caution=jnp.asarray(caution / noise),
            settling=jnp.asarray(settling),
            free=space.names,
            scheme=_checked_scheme(Unscented(s + p, alpha, beta, kappa)),
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters."""
        return self.free

    @property
    def states(self) -> int:
        """Number of states of the model."""
        return self.scheme.n - self.z0.shape[0]

    def init(self) -> UkfState:
        """Mean and covariance at the start; the states follow from the first input."""
        mean = jnp.concatenate([jnp.zeros(self.states, self.z0.dtype), self.z0])
        return UkfState(mean, self.prior, jnp.zeros((), self.z0.dtype), jnp.array([-1.0, 0, 0, 0, 0, 1.0]))

    def restart(self, state: UkfState, u: Scalar) -> UkfState:
        """Start of a record: the states are in equilibrium at u with their prior; parameters and their covariance are kept."""
        tally = state.tally.at[0].add(1.0)
        s, root = self.states, self.prior
        root = root.at[s:, s:].set(triangular(state.root[s:].T))
        points = self.scheme.points(jnp.zeros_like(state.mean).at[s:].set(state.mean[s:]), root)
        rest = jax.vmap(lambda z: self._tree(z, tally[0]).init(u))(points[:, s:])
        points = points.at[:, :s].add(rest)
        mean = self.scheme.mean(points)
        return UkfState(mean, self.scheme.root(points - mean, jnp.zeros_like(self.prior)), u, tally)

    def update(self, state: UkfState, sample: Sample) -> tuple[UkfState, Info]:
        """One sample: predict, correct, factorize. `error` is the innovation, error^2 / variance the NIS.

        Where the input is not finite, the previous one is kept and the sample counts as missing.
        """
        known_input = jnp.isfinite(sample.u)
        sample = sample._replace(u=jnp.where(known_input, sample.u, state.u))
        state = jax.lax.cond(sample.first, lambda s, u: self.restart(s, u), lambda s, u: s, state, sample.u)
        points, outputs = self._propagated(state, sample.u, sample.dt)
        mean, predicted = self.scheme.mean(points), self.scheme.mean(outputs)
        point_deviations, output_deviations = points - mean, outputs - predicted
        noise = self.noise * (1.0 + self.caution * jnp.exp(-state.tally[1] / jnp.maximum(self.settling, 1e-3)))
        variance = self.scheme.covariance(output_deviations, output_deviations) + noise**2
        held = self.resting & (jnp.abs(sample.u - state.u) <= self.still) & ~sample.first
        measured = jnp.isfinite(sample.y) & known_input
        finite = jnp.isfinite(variance) & jnp.all(jnp.isfinite(mean))
        used = measured & finite
        gain = self.scheme.covariance(point_deviations, output_deviations) / variance
        gain = jnp.where(held | ~used, 0.0, gain)
        error = jnp.where(used, sample.y - predicted, 0.0)
        added = jnp.concatenate([(noise * gain)[None], jnp.diag(jnp.where(held, 0.0, self.walk))])
        root = self.scheme.root(point_deviations - output_deviations[:, None] * gain, added)
        if not self.scheme.safe:  # a Cholesky factorization may fail; a QR factorization of finite rows cannot
            finite &= jnp.all(jnp.isfinite(root))
        new = UkfState(
            jnp.where(finite, mean + gain * error, state.mean),
            jnp.where(finite, root, state.root),
            sample.u,
            self._count(state.tally, used, measured, error**2 / variance),
        )
        return new, Info(new.mean[self.states :], jnp.where(used, error, jnp.nan), used, variance)

    def _propagated(self, state: UkfState, u: Array, dt: Array) -> tuple[Float[Array, "m n"], Float[Array, " m"]]:
        """Sigma points and their outputs after one step of the input to u."""
        s = self.states
        points = self.scheme.points(state.mean, state.root)

        def one(point: Array) -> tuple[Array, Array]:
            return self._tree(point[s:], state.tally[0]).step(point[:s], state.u, u, dt)

        moved, outputs = jax.vmap(one)(points)
        return jnp.concatenate([moved, points[:, s:]], axis=1), outputs

    def _tree(self, z: Array, record: Array) -> Any:
        count = self.coordinates.n_records
        return self.coordinates.tree(z, 0 if count == 1 else jnp.mod(record, count).astype(int))

    def _count(self, tally: Array, used: Array, measured: Array, nis: Array) -> Array:
        nis = jnp.where(used, nis, 0.0)
        added = jnp.stack([used, ~measured, measured & ~used, used]).astype(tally.dtype).at[3].set(nis)
        average = jnp.where(used, tally[5] + (nis - tally[5]) / self.memory, tally[5])
        return jnp.concatenate([tally[:1], tally[1:5] + added, average[None]])

    def covariance(self, state: UkfState) -> Float[Array, "n n"]:
        """Covariance of [state, z], shape (n, n); optimistic, see the class."""
        return state.root @ state.root.T

    def physical(self, theta: np.ndarray) -> np.ndarray:
        """Physical parameters from z, shape (..., p) to (..., p)."""
        rows = jnp.asarray(theta).reshape(-1, len(self.free))
        return np.asarray(jax.vmap(self.coordinates.physical)(rows)).reshape(np.shape(theta))

    def model(self, theta: np.ndarray, record: Record) -> AbstractHysteresis:
        """The identified model for a record; records that are not in the data share the parameters of the first."""
        marks = [name.partition("@")[2] for name in self.free]
        labels = list(dict.fromkeys(mark for mark in marks if mark))
        return self.coordinates.tree(jnp.asarray(theta), labels.index(record.name) if record.name in labels else 0)

    def one_step(self, theta: np.ndarray, data: Dataset) -> np.ndarray:
        """Innovations of a filter of the states only, with the parameters fixed at theta [y], shape (T,)."""
        s = self.states
        frozen = eqx.tree_at(
            lambda f: (f.z0, f.prior, f.walk),
            self,
            (jnp.asarray(theta), self.prior.at[s:, s:].set(0.0), self.walk.at[s:].set(0.0)),
        )
        _, info = run_stream(frozen, frozen.init(), Sample.stream(list(data)))
        return np.asarray(info.error)[np.asarray(info.used)]

    def judge(self, run: Run) -> Judgment:
        """Whether the simulation follows the record and the innovations are as large as predicted; other findings as notes."""
        state, theta = run.state, run.history[-1]
        notes = filter_verdict.skipped(int(state.tally[2]), int(state.tally[3]))
        if not np.isfinite(theta).all() or not np.isfinite(np.asarray(state.root)).all():
            text = "mean or covariance of the filter is not finite: use alpha=1, a smaller prior, or a better start"
            return Judgment(Status.DIVERGED, [*notes, Note(Code.DIVERGED, text, Severity.ERROR)])
        equation_error = float(np.sqrt(np.mean(self.one_step(theta, run.data) ** 2)))
        innovations = filter_verdict.innovations(float(state.tally[5]), float(self.memory))
        notes.append(innovations)
        x = self.physical(run.history[[-max(2, len(run.history) // 10), -1]])
        change = filter_verdict.relative_change(x[0], x[1], np.asarray(self.coordinates.scale))
        if (unsettled := filter_verdict.unsettled(self.names, change)) is not None:
            notes.append(unsettled)
        if run.free_run is None:
            return Judgment(Status.DIVERGED, notes, equation_error)
        measured = np.concatenate([record.y[record.used] for record in run.data])
        excess = filter_verdict.excess(run.free_run.rmse, float(self.noise), float(np.ptp(measured)))
        text = f"the simulation error beyond the noise is {100 * excess:.2g} % of the range (RMS)"
        notes.append(Note(Code.SIMULATION_ERROR, text))
        resting = np.asarray(self.resting)[self.states :]
        shape = [n for n, rests in zip(self.names, resting, strict=True) if rests and not n.startswith("offset")]
        follows = excess <= filter_verdict.FOLLOWS
        if (undetermined := filter_verdict.undetermined(shape, run.data, follows=follows)) is not None:
            return Judgment(Status.UNDETERMINED, [*notes, undetermined], equation_error)
        if not follows:
            return Judgment(Status.NOT_CONVERGED, notes, equation_error)
        consistent = innovations.severity is Severity.INFO
        return Judgment(Status.OK if consistent else Status.INCONSISTENT, notes, equation_error)


def _checked_scheme(scheme: Unscented) -> Unscented:
    """The sigma points, with a warning where a negative weight may spoil covariances."""
    if not scheme.safe:
        warnings.warn(
            f"alpha={scheme.alpha:g}, beta={scheme.beta:g}, kappa={scheme.kappa:g} give the central point the covariance weight "
            f"{scheme.central_weight:.3g}: a covariance may lose positive definiteness; alpha=1 has no negative weight",
            stacklevel=3,
        )
    return scheme
