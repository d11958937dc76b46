"""Quadratic programs with some unknowns >= 0, from their normal equations, by block principal pivoting (Kim and Park 2011)."""

from __future__ import annotations

import numpy as np
import scipy  # loads its subpackages when they are first used, which optimize is not in most fits
from scipy.linalg.lapack import dpotrs

from hystfit.models.shared.cholesky import cholesky

_PATIENCE = 5  # exchanges of whole blocks allowed without progress, before few unknowns are exchanged at a time
# Of the largest violation on each side of the bounds, above which unknowns are exchanged then: at 0.1, 0.3 and 0.5 the nearly singular
# equations of 1891 weights ended after 25, 24 and 34 exchanges, where one by one they did not.
_WORST = 0.3
_LIMIT = 50  # exchanges: those that end need a dozen, the others go in circles


def solve_nonnegative(
    A: np.ndarray, b: np.ndarray, bounded: np.ndarray, start: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Minimize w'Aw / 2 - b'w with w >= 0 where `bounded`; A is positive definite, shape (p, p).

    With w it returns which unknowns are not held at zero, shape (p,), to `start` a similar problem from; None for none.
    """
    try:
        if b.size and not bounded.any():
            return dpotrs(cholesky(A), b, lower=True)[0], ~bounded
        return _pivot(A, b, bounded, ~bounded if start is None else start | ~bounded)
    except np.linalg.LinAlgError:  # positive definite but for rounding
        return _by_root(A, b, bounded)


def solve_several(
    A: np.ndarray, b: np.ndarray, bounded: np.ndarray, start: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """`solve_nonnegative` for b of shape (K, p) and A, (K, p, p) or one for all: side by side, as calls take longer than arithmetic."""
    A = np.broadcast_to(A, (len(b), *A.shape[-2:]))
    active = np.tile(~bounded, (len(b), 1)) if start is None else start | ~bounded
    found, waiting = np.zeros_like(b), np.arange(len(b))
    fewest, patience, unit = np.full(len(b), b.shape[1] + 1), np.full(len(b), _PATIENCE), np.eye(b.shape[1])
    for _ in range(_LIMIT):
        on, some, right = active[waiting], A[waiting], b[waiting]
        try:
            w = np.linalg.solve(np.where(on[:, :, None] & on[:, None, :], some, unit), (right * on)[..., None])
        except np.linalg.LinAlgError:  # positive definite but for rounding
            break
        wrong = _wrong(w[..., 0], (some @ w)[..., 0] - right, right, bounded, on)
        found[waiting] = np.where(bounded, np.maximum(w[..., 0], 0.0), w[..., 0])
        count = wrong.sum(axis=1)
        better = count < fewest[waiting]
        patience[waiting] = np.where(better, _PATIENCE, patience[waiting] - 1)
        fewest[waiting] = np.minimum(count, fewest[waiting])
        active[waiting] = on ^ np.where(patience[waiting, None] < 0, _last(wrong), wrong)
        waiting = waiting[count > 0]
        if not waiting.size:
            return found, active
    for k in waiting:
        found[k], active[k] = solve_nonnegative(A[k], b[k], bounded, active[k])
    return found, active


def _wrong(w: np.ndarray, dual: np.ndarray, b: np.ndarray, bounded: np.ndarray, active: np.ndarray) -> np.ndarray:
    """Unknowns on the wrong side: negative, or held at zero against the gradient; of one problem (p,) or several (K, p)."""
    slack = 1e-13 * np.abs(w).max(axis=-1, initial=0.0, keepdims=True)
    steep = -1e-11 * np.abs(b).max(axis=-1, initial=1e-300, keepdims=True)
    return bounded & np.where(active, w < -slack, dual < steep)


def _last(wrong: np.ndarray) -> np.ndarray:
    """The last of the unknowns on the wrong side: by Murty's rule an exchange of one at a time always ends."""
    return wrong & (np.cumsum(wrong[..., ::-1], axis=-1)[..., ::-1] == 1)


def _pivot(A: np.ndarray, b: np.ndarray, bounded: np.ndarray, active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    fewest, patience, best = b.size + 1, _PATIENCE, active
    for _ in range(_LIMIT):
        w, dual = _solve_on(A, b, active)
        wrong = _wrong(w, dual, b, bounded, active)
        count = int(wrong.sum())
        if count == 0:
            return np.where(bounded, np.maximum(w, 0.0), w), active
        if count < fewest:
            fewest, patience, best = count, _PATIENCE, active
        elif patience:
            patience -= 1
        else:  # whole blocks go in circles
            for side, size in ((active, -w), (~active, -dual)):
                worst = np.max(size, where=wrong & side, initial=0.0)
                wrong &= ~side | (size >= _WORST * worst)
        active = active ^ wrong
    return _descend(A, b, bounded, best)


def _descend(A: np.ndarray, b: np.ndarray, bounded: np.ndarray, active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """From the feasible point next to a solution that few unknowns are wrong in, by one unknown at a time (Lawson and Hanson 1974).

    Rounding of nearly singular equations may send an unknown back at once that its gradient sets free: it stays at zero.
    """
    w = _solve_on(A, b, active)[0]
    w[bounded & (w < 0)] = 0.0
    stays = np.zeros(b.size, dtype=bool)
    for _ in range(2 * b.size):
        active = ~bounded | (w > 0)
        goal, dual = _solve_on(A, b, active)
        while (back := bounded & active & (goal < 0)).any():
            share = float(np.min(w[back] / (w[back] - goal[back])))
            w += share * (goal - w)
            active &= ~bounded | (w > 0)
            active[back & (w <= np.finfo(float).eps * np.abs(w).max())] = False
            w[~active] = 0.0
            goal, dual = _solve_on(A, b, active)
        w = goal
        free = _wrong(w, dual, b, bounded, active) & ~stays
        if not free.any():
            break
        k = int(np.argmin(np.where(free, dual, 0.0)))
        active[k] = True
        goal = _solve_on(A, b, active)[0]
        stays[k] = goal[k] <= 0
        w[k] = 0.0 if stays[k] else np.finfo(float).tiny
    return w, ~bounded | (w > 0)


def _solve_on(A: np.ndarray, b: np.ndarray, active: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    w = np.zeros(b.size)
    at = np.flatnonzero(active)
    if at.size:
        factor = cholesky(submatrix(A, at), overwrite=at.size < b.size)
        w[at], _ = dpotrs(factor, b[at], lower=True)
    return w, A @ w - b


def submatrix(A: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Rows and columns of a square matrix at rising positions; itself where these are all."""
    return A if at.size == len(A) else A.take(at, 0).take(at, 1)


def _by_root(A: np.ndarray, b: np.ndarray, bounded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Fallback: an active-set method on a square root of A, with free unknowns as differences of two nonnegative ones."""
    values, vectors = np.linalg.eigh(A)
    root = np.sqrt(np.maximum(values, 1e-14 * values.max()))
    if not bounded.any():
        return vectors @ ((vectors.T @ b) / root**2), ~bounded
    L, d = (vectors * root).T, (vectors / root).T @ b
    free = np.flatnonzero(~bounded)
    w, _ = scipy.optimize.nnls(np.column_stack([L, -L[:, free]]), d, maxiter=100 * b.size)
    x = w[: b.size].copy()
    x[free] -= w[b.size :]
    return x, ~bounded | (x > 0)
