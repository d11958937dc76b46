"""Sweeps that use even sampling against a scan of `step`, which does not."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hystfit as hf
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.even_steps import even_step

MODELS = {
    "log creep": hf.LogCreep(gamma=(0.02, 0.01)),
    "linear creep": hf.LinearCreep(a=0.1, level=0.3),
    "relaxation": hf.Relaxation(),
    "lag": hf.Lag(tau=0.01, level=0.2),
    "lag of order one": hf.Lag(tau=0.01, level=0.2, order=1),
    "resonance": hf.SecondOrder(omega=300.0, zeta=0.2),
    "delay": hf.Delay(lag=2.3),
    "delay of whole samples": hf.Delay(lag=3.0),
    "no delay": hf.Delay(lag=0.0, longest=1),
    "exact Bouc-Wen": hf.BoucWen(tau=3.0, mu=0.6, h0=0.3, scheme="exact"),
    "asymmetric": hf.AsymmetricBoucWen(tau=3.0, skew=0.2, b=(0.1, 0.05), h0=0.3),
    "hardening stops": hf.PrandtlIshlinskii(
        w=[[0.2, 0.1, 0.4]], r=(0.05, 0.17, 0.33), operator="stop", hardening=(0.1, -0.2, 0.3), s0=2.0
    ),
    "asymmetric, n = 1.6": hf.AsymmetricBoucWen(tau=3.0, skew=0.2, b=(0.1, 0.05), n=1.6),
}
SAMPLES = 77  # no whole number of blocks
EVEN = np.full(SAMPLES, 0.001)
CLOCKS = {
    "even": EVEN,
    "even but for the rounding of time stamps": np.diff(0.001 * np.arange(SAMPLES + 1)),
    "padded": np.where((np.arange(SAMPLES) > 0) & (np.arange(SAMPLES) < 70), EVEN, 0.0),
    "uneven": EVEN * (1 + 0.3 * np.sin(np.arange(SAMPLES))),
}


@pytest.mark.parametrize("name", MODELS)
def test_a_sweep_equals_a_scan_of_steps(name: str) -> None:
    model = MODELS[name]
    u = jnp.asarray(np.sin(np.arange(SAMPLES) / 5) + 0.3 * np.sin(np.arange(SAMPLES) / 1.3))

    def outputs(sweep: Any) -> Any:
        run = lambda model, dt: sweep(model, model.init(u[0]), u[0], u, dt)
        ones = jax.tree_util.tree_map(jnp.ones_like, model)
        return jax.jit(lambda dt: jax.jvp(lambda model: run(model, dt), (model,), (ones,)))

    found, expected = outputs(type(model).sweep), outputs(AbstractHysteresis.sweep)
    for clock, dt in CLOCKS.items():
        leaves = (jax.tree_util.tree_leaves(of(jnp.asarray(dt))) for of in (found, expected))
        for a, b in zip(*leaves, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-11, err_msg=clock)


@pytest.mark.parametrize("clock", [*CLOCKS, "repeated", "at rest"])
@pytest.mark.parametrize(
    "model",
    [
        MODELS["lag"],
        MODELS["linear creep"],
        hf.LinearCreep(a=np.linspace(-0.1, 0.2, 7), rest="first"),
        hf.Viscous(c=0.3),
        hf.SaturatingRate(v0=50.0),
        hf.Relaxation(a=(0.3, -0.1), tau=(0.02, 1.3)),
    ],
    ids=["lag", "creep", "creep of several weights", "viscous", "saturating", "relaxation"],
)
def test_a_run_on_the_host_equals_the_simulation(model: Any, clock: str) -> None:
    dt = {**CLOCKS, "repeated": np.where(np.arange(SAMPLES) % 5 == 2, 0.0, EVEN), "at rest": 0.0 * EVEN}[clock]
    u = np.sin(np.arange(SAMPLES) / 5) + 0.3 * np.sin(np.arange(SAMPLES) / 1.3)
    np.testing.assert_allclose(model.free_run(u, dt), hf.simulate(model, u, dt)[0], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("clock", CLOCKS)
def test_a_filter_of_columns_filters_each(clock: str) -> None:
    model, dt = hf.Relaxation(a=(0.3, -0.1), tau=(0.02, 1.3)), CLOCKS[clock]
    columns = np.random.default_rng(0).standard_normal((SAMPLES, 4)).cumsum(0)
    found = model.filtered(columns, dt)
    for column, out in zip(columns.T, found.T, strict=True):
        np.testing.assert_allclose(out, hf.simulate(model, column, dt)[0], rtol=1e-9, atol=1e-12)


def test_log_creep_of_an_even_clock_is_the_same_to_the_last_bit() -> None:
    """The decay factors of an even clock are the same numbers, whether they are computed once or for each sample."""
    model, u, dt = MODELS["log creep"], jnp.asarray(np.sin(np.arange(SAMPLES) / 5)), jnp.asarray(EVEN)
    sweep = lambda kind, dt: kind.sweep(model, model.init(u[0]), u[0], u, dt)[1]
    uneven = dt.at[-1].multiply(1.1)  # all samples but the last are the same
    even, varying = sweep(hf.LogCreep, dt), sweep(hf.LogCreep, uneven)
    np.testing.assert_allclose(even[:-1], varying[:-1], rtol=1e-15, atol=0.0)


@pytest.mark.parametrize(
    ("dt", "even"),
    [([0.0, 1.0, 1.0, 0.0], True), ([1.0, 1.0, 1.0 + 1e-9], False), ([0.1, 0.1 + 2e-17, 0.1], True), ([0.0], True)],
)
def test_an_even_clock_has_one_step_and_steps_of_zero(dt: list[float], even: bool) -> None:
    assert bool(even_step(jnp.asarray(dt))[0]) is even
