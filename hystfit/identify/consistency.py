"""Is an unscented filter to be believed: innovations against their predicted size, settled parameters, and the free run as judge."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from hystfit.data.record import Dataset
from hystfit.models.base import simulate
from hystfit.quality.loops import reversals

if TYPE_CHECKING:
    from hystfit.identify.base import Info
    from hystfit.identify.ukf import Ukf, UkfState

NIS_BAND = (0.8, 1.2)  # mean normalized innovation squared of a filter that believes neither too much nor too little
SETTLED = 1e-3  # largest relative change of a parameter over the last tenth of the record
FOLLOWS = 0.01  # free-run error beyond the noise, RMS in parts of the output's range


def nis(info: Info) -> np.ndarray:
    """Normalized innovation squared of every sample, shape (T,), NaN where a sample was not used; its mean should be 1."""
    return np.asarray(info.error) ** 2 / np.asarray(info.variance)


def nees(error: Any, covariance: Any) -> float:
    """Normalized estimation error squared  e^T P^-1 e  of a simulated truth; its mean should be the rank of P.

    Directions in which P has no variance (one state a function of others) are left out.
    """
    error, covariance = np.asarray(error, dtype=float), np.asarray(covariance, dtype=float)
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    inverse = np.linalg.pinv(covariance / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    return float((error / scale) @ inverse @ (error / scale))


def amplitudes(data: Dataset) -> int:
    """How many different loops the inputs describe: pairs of neighboring turning points apart by 5 % of the range."""
    low, high = min(r.u.min() for r in data), max(r.u.max() for r in data)
    span = max(high - low, 1e-300)
    pairs: list[np.ndarray] = []
    for record in data:
        turns = (record.u[reversals(record.u, 0.02 * span)] - low) / span
        for pair in np.sort(np.stack([turns[:-1], turns[1:]], axis=1), axis=1):
            if all(np.max(np.abs(pair - other)) > 0.05 for other in pairs):
                pairs.append(pair)
    return len(pairs)


def free_run_excess(ukf: Ukf, data: Dataset, z: np.ndarray) -> float | None:
    """RMS error of the free run beyond the measurement noise, in parts of the output's range; None where it is not finite."""
    square, count, low, high = 0.0, 0, np.inf, -np.inf
    for record in data:
        model = ukf.model(z, record)
        if model is None:
            return None
        y = np.asarray(simulate(model, jnp.asarray(record.u), jnp.asarray(record.dt))[0])
        used = record.used
        square += float(np.sum((record.y - y)[used] ** 2))
        count += int(used.sum())
        low, high = min(low, record.y[used].min()), max(high, record.y[used].max())
    if not np.isfinite(square):
        return None
    return float(np.sqrt(max(0.0, square / count - float(ukf.noise) ** 2)) / (high - low))


def verdict(ukf: Ukf, data: Dataset, state: UkfState, history: np.ndarray) -> tuple[str, list[str]]:
    """Status and notes: the free run decides, the innovations and the parameters' drift are told beside it."""
    notes = _counts(state)
    if not np.isfinite(history[-1]).all() or not np.isfinite(np.asarray(state.root)).all():
        return "diverged", [
            *notes,
            "the filter lost its covariance or its mean: use alpha=1, a smaller prior, or start nearer",
        ]
    average = float(state.tally[5])
    told = f"mean normalized innovation squared over the last tenth: {average:.3g}"
    if average > NIS_BAND[1]:
        told += "; the filter believes too much: raise noise or walk, or the model leaves something out"
    elif average < NIS_BAND[0]:
        told += "; the filter believes too little: lower noise or walk"
    notes.append(told + ". The filter's covariance is no error bar: fit by least squares from here for errors")
    moved = _drift(ukf, history)
    if moved:
        notes.append(f"still moving over the last tenth of the record: {moved}")
    excess = free_run_excess(ukf, data, history[-1])
    if excess is None:
        return "diverged", [*notes, "the free run of the identified model is not finite"]
    notes.append(f"free run of the final parameters: {100 * excess:.2g} % of range RMS beyond the noise")
    loops = _determined(ukf, data, follows=excess <= FOLLOWS)
    if loops is not None:
        return "undetermined", [*notes, loops]
    return ("ok" if excess <= FOLLOWS else "not-converged"), notes


def _counts(state: UkfState) -> list[str]:
    missing, refused = int(state.tally[2]), int(state.tally[3])
    notes = []
    if missing:
        notes.append(f"{missing} measurements were missing and skipped; the model ran through them on its input")
    if refused:
        notes.append(f"{refused} samples were refused: the sigma points gave no finite prediction there")
    return notes


def _drift(ukf: Ukf, history: np.ndarray) -> str:
    x = ukf.physical(history[[-max(2, len(history) // 10), -1]])
    size = np.maximum(np.abs(x[1]), np.asarray(ukf.coordinates.scale))
    change = np.abs(x[1] - x[0]) / size
    return ", ".join(
        f"{name} by {100 * part:.2g} %" for name, part in zip(ukf.names, change, strict=True) if part > SETTLED
    )


def _determined(ukf: Ukf, data: Dataset, *, follows: bool) -> str | None:
    shape = [
        name
        for name, rests in zip(ukf.names, np.asarray(ukf.resting)[ukf.states :], strict=True)
        if rests and not name.startswith("offset")
    ]
    count = amplitudes(data)
    if len(shape) < 2 or count > 2:
        return None
    return (
        f"the data do not determine {', '.join(shape)}: the input describes {count or 'no'} loop(s) of one amplitude, on which they "
        f"trade against each other. The model {'predicts' if follows else 'does not even predict'} this loop; "
        "for others excite several amplitudes (signal amplitude-sweep)"
    )
