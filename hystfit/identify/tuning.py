"""Settings of the unscented filter from records: noise, priors of states and parameters, parameters fixed at rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import jax
import numpy as np

from hystfit.data.dataset import Dataset
from hystfit.errors import ParameterError
from hystfit.identify.base import free_only
from hystfit.identify.identification import free_runs, run_metrics
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.simulation import states_over
from hystfit.models.shared.starting import scales_of
from hystfit.params.coordinates import REAL
from hystfit.params.space import ParameterSpace
from hystfit.quality.faults import noise_rms

_QUIETEST = 1e-4  # least measurement noise, as a fraction of the output's half range


def measurement_noise(data: Dataset, half_range: float, noise: float | None) -> float:
    """Standard deviation of the measurement noise [y]."""
    if noise is not None:
        if np.ndim(noise) or not (noise > 0 and np.isfinite(noise)):
            raise ParameterError(
                f"noise must be a positive standard deviation (one number) in units of the output, got {noise}"
            )
        return float(noise)
    estimates = [rms for rms, _ in (noise_rms(record.y) for record in data) if rms is not None]
    return max([_QUIETEST * half_range, *estimates])


def identified_space(
    model: AbstractHysteresis,
    data: Dataset,
    *,
    fix: Sequence[str] | Mapping[str, float],
    free: Sequence[str],
    only: Sequence[str] | None,
) -> ParameterSpace:
    """The parameters that a filter identifies: those of `only`, or by default all but `fix`, with `free`."""
    if only is not None and (fix or free):
        raise ParameterError("only names all free parameters: leave fix and free out, or leave only out")
    if only is not None:
        space = free_only(model, only, data)
    else:
        records = [record.name for record in data]
        space = ParameterSpace.of(model, fix=fix, free=free, scales=scales_of(data), records=records)
    if not len(space):
        raise ParameterError("every parameter is fixed: there is nothing to identify (use predict)")
    return space


def state_ranges(model: AbstractHysteresis, data: Dataset) -> np.ndarray:
    """Range of every state over the records in a simulation, shape (states,)."""
    runs = [states_over(model, record.u, record.dt) for record in data]
    ranges = np.max([np.ptp(run, axis=0) for run in runs], axis=0)
    if not np.isfinite(ranges).all():
        raise ParameterError("the simulation of the start is not finite: use better starting values, or start='data'")
    return np.maximum(ranges, 1e-12)


def initial_error(space: ParameterSpace, data: Dataset) -> float:
    """Three times the RMS simulation error of the template [y]."""
    z = space.unconstrained(space.vector(space.template))
    models = tuple(space.tree(z, number) for number in range(len(data)))
    return 3.0 * run_metrics(free_runs(models, data), data).rmse


def parameter_root(
    space: ParameterSpace, prior: float | Mapping[str, float] | np.ndarray | None, *, near: bool = False
) -> np.ndarray:
    """Root of the prior covariance of z, shape (p, p), from standard deviations, a covariance, or None; smaller for a start `near`."""
    # With wider priors of many parameters the outer sigma points are too far away for a useful mean.
    unbounded, bounded = (0.02, 0.2) if near else (0.1, 0.5)
    deviations = np.where(space.kinds == REAL, unbounded, bounded)
    if isinstance(prior, Mapping):
        for name, value in prior.items():
            leaf, positions = space.named.find(name)
            rows = [k for k, source in enumerate(space.sources) if source[0] == leaf and source[1] in positions]
            if not rows:
                raise ParameterError(
                    f"prior names {name!r}, which is fixed; the free parameters are {', '.join(space.names)}"
                )
            deviations[rows] = value
    elif isinstance(prior, np.ndarray) and prior.ndim == 2:
        return _root_of(prior, len(space))
    elif np.ndim(prior):
        raise ParameterError(
            f"prior must be one standard deviation, standard deviations by name, or a covariance of shape ({len(space)}, {len(space)}); "
            f"got an array of shape {np.shape(prior)}"
        )
    elif prior is not None:
        deviations = np.full(len(space), float(prior))
    if not (np.isfinite(deviations).all() and (deviations > 0).all()):
        raise ParameterError(f"prior must be positive, got {prior}")
    return np.diag(deviations)


def _root_of(covariance: np.ndarray, size: int) -> np.ndarray:
    if covariance.shape != (size, size):
        raise ParameterError(f"prior covariance must have shape ({size}, {size}), got {covariance.shape}")
    if not np.isfinite(covariance).all() or not np.allclose(covariance, covariance.T, rtol=1e-9, atol=0):
        raise ParameterError("prior covariance must be finite and symmetric")
    try:
        return np.linalg.cholesky(covariance)
    except np.linalg.LinAlgError as error:
        least = np.linalg.eigvalsh(covariance)[0]
        raise ParameterError(
            f"prior covariance is not positive definite (least eigenvalue {least:.3g}): give standard deviations, or add to its diagonal"
        ) from error


def fixed_at_rest(space: ParameterSpace, hold: str) -> np.ndarray:
    """Which free parameters are fixed while the input rests, (p,): those of rate-independent models ("auto"), "all" or "none"."""
    if hold != "auto":
        return np.full(len(space), hold == "all")
    paths = jax.tree_util.tree_flatten_with_path(space.template)[0]
    flags = []
    for leaf, _, _ in space.sources:
        node, owner = space.template, space.template
        for key in paths[space.leaves[leaf].index][0][:-1]:
            node = node[key.idx] if isinstance(key, jax.tree_util.SequenceKey) else getattr(node, key.name)
            owner = node if isinstance(node, AbstractHysteresis) else owner
        flags.append(bool(owner.rate_independent))
    return np.array(flags)


def deviations(given: float | np.ndarray | None, default: np.ndarray, name: str) -> np.ndarray:
    """Standard deviations of the states, shape (states,)."""
    if given is None:
        return default
    values = np.asarray(given, dtype=float)
    if values.shape not in ((), default.shape) or not (np.isfinite(values).all() and (values >= 0).all()):
        raise ParameterError(f"{name} must be one number or {default.size}, finite and not negative; got {given}")
    return np.broadcast_to(values, default.shape)


def not_negative(value: float, name: str) -> float:
    """The value of a setting."""
    if not 0 <= value < np.inf:
        raise ParameterError(f"{name} must be finite and not negative, got {value:g}")
    return float(value)
