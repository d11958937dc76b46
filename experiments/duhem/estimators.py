"""Every way to identify the same Duhem model, side by side, and what each costs."""

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
    output_error,
)
from hystfit.identify.base import run_stream

INCREMENT = 2.0  # V, of the decimation


class Outcome(NamedTuple):
    """What an estimator makes of one record: rate over the true one, equation error [um], largest free-run error [um]."""

    alpha: float
    equation: float
    error: float


def one_step(case: Case, model: hf.Duhem | None) -> float:
    """RMS equation error of a model on the noisy record [um]."""
    if model is None:
        return float("nan")
    rls = Rls.of(model, case.record)
    return float(np.sqrt(np.mean(rls.one_step(rls.regressor.theta(model), hf.Dataset.of(case.record)) ** 2)))


def gradient_correction(case: Case, seed: int, *, floor: float = 1.0, passes: int = 1) -> hf.Duhem | None:
    """From a start within 10 % of the paper's parameters."""
    identifier = GradientCorrection.of(case.model, case.record, start="model", floor=floor)
    regressor = identifier.regressor
    start = jnp.asarray(regressor.from_powers(near(PAPER_RLS, seed)))
    identifier = eqx.tree_at(lambda g: g.theta0, identifier, start)
    state, _ = run_stream(identifier, identifier.init(), Sample.stream([case.record], passes))
    theta = np.asarray(state.theta)
    return identifier.model(theta, case.record) if np.isfinite(theta).all() else None


def estimators(scheme: str) -> dict[str, Callable[[Case, int], Any]]:
    """By name: (case, seed) to a model."""
    blank = hf.Duhem(scheme=scheme)
    started = lambda case: blank.start([case.record])
    return {
        "RLS": lambda case, seed: identify(case.record, "rls", blank).model,
        "RLS, bias-compensated": lambda case, seed: bias_compensated(blank, case.record).model,
        f"RLS, decimated to {INCREMENT:g} V": lambda case, seed: (
            identify(decimate(case.record, INCREMENT), "rls", blank).model
        ),
        "gradient correction": gradient_correction,
        "integrated regression": lambda case, seed: integrated_regression(started(case), case.record).model,
        "output error": lambda case, seed: output_error(started(case), case.record).model,
    }


def outcome(estimate: Callable[[Case, int], hf.Duhem | None], case: Case, seed: int) -> Outcome:
    """Of one estimator on one record; infinite errors where it finds no valid model."""
    try:
        model = estimate(case, seed)
    except HystfitError:
        model = None
    rate = float("nan") if model is None else float(model.alpha) / float(case.model.alpha)
    return Outcome(rate, one_step(case, model), case.error(model))


def costs(case: Case) -> dict[str, float]:
    """Seconds of one `update` beyond the dispatch of a jitted call, inside a scan, and of a scan of 1e5 samples."""
    found = {}
    for name, kind in (("RLS", Rls), ("gradient correction", GradientCorrection)):
        identifier = kind.of(hf.Duhem(), case.record)
        state, sample = identifier.init(), Sample.of(1.0, 1.0)
        state, _ = identifier.update(state, Sample.of(0.5, 0.9, first=True))
        shapes = jax.eval_shape(identifier.update, state, sample)[1]
        empty = jax.tree.map(lambda s: jnp.zeros(s.shape, s.dtype), shapes)
        update = jax.jit(lambda s, x, identifier=identifier: identifier.update(s, x))
        # the same leaves in and out, and no work: what any jitted call costs
        nothing = jax.jit(lambda s, x, empty=empty: (jax.tree.map(lambda leaf: leaf + 0, s), empty))
        found[f"{name}: update beyond dispatch"] = _beyond(update, nothing, state, sample)
        repeats = -(-100_000 // len(case.record))
        stream = jax.tree.map(lambda leaf: leaf[:100_000], Sample.stream([case.record], repeats))
        jax.block_until_ready(run_stream(identifier, identifier.init(), stream))
        found[f"{name}: scan of 1e5 samples"] = min(
            _clock(lambda i=identifier, s=stream: run_stream(i, i.init(), s)) for _ in range(3)
        )
    return found


def _beyond(call: Callable, floor: Callable, *args: object) -> float:
    """What `call` costs more than `floor`, timed in turn so that whatever else runs slows both."""
    jax.block_until_ready((call(*args), floor(*args)))
    pairs = [(_clock(lambda: call(*args)), _clock(lambda: floor(*args))) for _ in range(1000)]
    spent, least = np.quantile(pairs, 0.1, axis=0)
    return float(spent - least)


def _clock(call: Callable) -> float:
    started = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - started


def quiet() -> None:
    """Simulations of hopeless estimates overflow, and are reported as infinite."""
    warnings.filterwarnings("ignore", category=RuntimeWarning)
