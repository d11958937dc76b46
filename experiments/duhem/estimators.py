"""Estimators of the same Duhem model, and the computing time of the sequential ones."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from cases import PAPER_RLS, Case, near

import hystfit as hf
from hystfit.errors import HystfitError
from hystfit.identify import (
    GradientCorrection,
    Rls,
    Sample,
    bias_compensated,
    decimate,
    identify,
    integrated_regression,
    run_stream,
)

INCREMENT = 2.0  # input increment of the decimation [V]


class Outcome(NamedTuple):
    """Result of an estimator on one record: identified over true rate, equation error [um], largest simulation error [um]."""

    alpha: float
    equation: float
    error: float


def one_step(case: Case, model: hf.Duhem | None) -> float:
    """RMS equation error of a model on the noisy record [um]."""
    if model is None:
        return float("nan")
    regressor = Rls.of(model, case.record).regressor
    rows = regressor.rows(case.record)
    errors = (rows.target - rows.phi @ regressor.theta(model)) * float(regressor.target_unit)
    return float(np.sqrt(np.mean(errors**2)))


def gradient_correction(
    case: Case, seed: int, *, passes: int = 1, basis: str = "legendre", **settings: Any
) -> hf.Duhem | None:
    """Gradient correction from a start within 10 % of the paper's parameters; None where it diverges or the rate is not positive.

    Args:
        case: the record.
        seed: of the start.
        passes: over the record.
        basis, settings: see `GradientCorrection.of`.
    """
    identifier = GradientCorrection.of(case.model, case.record, start="model", basis=basis, **settings)
    start = jnp.asarray(identifier.regressor.from_powers(near(PAPER_RLS, seed)))
    identifier = eqx.tree_at(lambda g: g.theta0, identifier, start)
    state, _ = run_stream(identifier, identifier.init(), Sample.stream([case.record], passes))
    theta = np.asarray(state.theta)
    return identifier.model(theta, case.record) if np.isfinite(theta).all() else None


def output_error(record: hf.Record, scheme: str = "midpoint") -> hf.FitResult:
    """Least squares on the simulated output, started from integrated regression."""
    start = integrated_regression(hf.Duhem(scheme=scheme).start([record]), record)
    return hf.fit(start.model, record, method="lm", start="model", starts=1, noise="iid")


def estimators(scheme: str) -> dict[str, Callable[[Case, int], Any]]:
    """Functions of (case, seed) to a model, by name."""
    blank = hf.Duhem(scheme=scheme)
    return {
        "RLS": lambda case, seed: identify(case.record, "rls", blank).model,
        "RLS, bias-compensated": lambda case, seed: bias_compensated(blank, case.record).model,
        f"RLS, decimated to {INCREMENT:g} V": lambda case, seed: (
            identify(decimate(case.record, INCREMENT), "rls", blank).model
        ),
        "gradient correction": gradient_correction,
        "integrated regression": lambda case, seed: (
            integrated_regression(blank.start([case.record]), case.record).model
        ),
        "output error": lambda case, seed: output_error(case.record, scheme).model,
    }


def outcome(estimate: Callable[[Case, int], hf.Duhem | None], case: Case, seed: int) -> Outcome:
    """Result of one estimator on one record; infinite errors where it finds no valid model.

    Args:
        estimate: one of `estimators`.
        case: the record.
        seed: of the estimator.
    """
    try:
        model = estimate(case, seed)
    except HystfitError:
        model = None
    rate = float("nan") if model is None else float(model.alpha) / float(case.model.alpha)
    return Outcome(rate, one_step(case, model), case.error(model))


def costs(case: Case) -> dict[str, float]:
    """Seconds of one `update` beyond the dispatch of a jitted call, inside a scan, and of a scan of 1e5 samples."""
    seconds = {}
    for name, kind in (("RLS", Rls), ("gradient correction", GradientCorrection)):
        identifier = kind.of(hf.Duhem(), case.record)
        state, sample = identifier.init(), Sample.of(1.0, 1.0)
        state, _ = identifier.update(state, Sample.of(0.5, 0.9, first=True))
        shapes = jax.eval_shape(identifier.update, state, sample)[1]
        empty = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)
        update = jax.jit(lambda s, x, identifier=identifier: identifier.update(s, x))
        # the same leaves in and out without work: the cost of any jitted call
        nothing = jax.jit(lambda s, x, empty=empty: (jax.tree.map(lambda leaf: leaf + 0, s), empty))
        seconds[f"{name}: update beyond dispatch"] = _beyond(update, nothing, state, sample)
        repeats = -(-100_000 // len(case.record))
        stream = jax.tree.map(lambda leaf: leaf[:100_000], Sample.stream([case.record], repeats))
        jax.block_until_ready(run_stream(identifier, identifier.init(), stream))
        seconds[f"{name}: scan of 1e5 samples"] = min(
            _clock(lambda i=identifier, s=stream: run_stream(i, i.init(), s)) for _ in range(3)
        )
    return seconds


def _beyond(call: Callable, floor: Callable, *args: object) -> float:
    """Time of `call` beyond that of `floor`, timed alternately so that other processes slow both."""
    jax.block_until_ready((call(*args), floor(*args)))
    pairs = [(_clock(lambda: call(*args)), _clock(lambda: floor(*args))) for _ in range(1000)]
    spent, least = np.quantile(pairs, 0.1, axis=0)
    return float(spent - least)


def _clock(call: Callable) -> float:
    started = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - started


def quiet() -> None:
    """Hide overflow warnings: simulations of diverged estimates overflow and are reported as infinite."""
    warnings.filterwarnings("ignore", category=RuntimeWarning)
