"""Forward simulation of every shipped model beside a plain numba loop of it, and of some beside their C code."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from compiled_c import GCC, compiled
from loops import loop_of
from rows import Row, beside
from timing import alternate

import hystfit as hf

BOUC_WEN = dict(c=1.0, mu=0.45, tau=1.5, rho=0.5, offset=0.3)
MODELS: dict[str, hf.AbstractHysteresis] = {
    "Bouc-Wen": hf.BoucWen(**BOUC_WEN),
    "Bouc-Wen, exact": hf.BoucWen(**BOUC_WEN, scheme="exact"),
    "Bouc-Wen, asymmetric, n = 1": hf.AsymmetricBoucWen(**BOUC_WEN, skew=0.1, b=(0.1, -0.05)),
    "Bouc-Wen, asymmetric, n = 1.6": hf.AsymmetricBoucWen(**BOUC_WEN, skew=0.1, b=(0.1, -0.05), n=1.6),
    "Bouc-Wen force, n = 2": hf.BoucWenForce(kappa_x=0.4, kappa_w=1.0, rho=4.0, sigma=0.9, n=2.0, offset=0.1),
    "Duhem": hf.Duhem(alpha=2.0, f=[0.1, 1.0, 0.1, -0.05], g=[0.5, 0.05, 0.02], w0=0.1),
    "10 plays": hf.PrandtlIshlinskii.of(10),
    "3 envelopes of 10 plays": hf.PrandtlIshlinskii.of(10, 5, envelopes=3),
    "20 stops": hf.PrandtlIshlinskii.of(20, operator="stop"),
    "20 hardening stops": hf.PrandtlIshlinskii.of(20, 3, operator="stop", hardening=3),
    "oscillator, linear force": hf.BoucWenOscillator(m=1e-4, c=1e-3, between="linear"),
    "oscillator, band-limited force": hf.BoucWenOscillator(m=1e-4, c=1e-3),
    "oscillator, n = 1.5": hf.BoucWenOscillator(m=1e-4, c=1e-3, between="linear", n=1.5),
    "logarithmic creep": hf.LogCreep(),
    "Bouc-Wen + logarithmic creep": hf.Series(hf.BoucWen(**BOUC_WEN), hf.LogCreep()),
    "linear creep": hf.LinearCreep(a=0.1),
    "relaxation": hf.Relaxation(),
    "delay": hf.Delay(lag=2.3),
    "lag": hf.Lag(tau=0.01),
    "resonance": hf.SecondOrder(omega=200.0),
    "viscous force": hf.Viscous(c=0.1),
    "saturating force": hf.SaturatingRate(F=0.3),
}


def signal(samples: int) -> np.ndarray:
    """20 cycles of growing and falling amplitude, with minor loops."""
    t = np.linspace(0, 20, samples)
    return (0.2 + 0.8 * np.sin(np.pi * t / 20) ** 2) * np.sin(2 * np.pi * t) + 0.1 * np.sin(2 * np.pi * 3.3 * t)


def measure(quick: bool) -> list[Row]:
    """Rows of the suite; each output is compared with the loop's before it is timed."""
    samples, repeats = (1_000, 1) if quick else (100_000, 15)
    u, dt = signal(samples), np.full(samples, 0.001)
    dt[0] = 0.0
    on_device = jnp.asarray(u), jnp.asarray(dt)
    rows = []
    for name, model in MODELS.items():
        loop = loop_of(model)
        np.testing.assert_allclose(hf.simulate(model, u, dt)[0], loop(u, dt), rtol=1e-9, atol=1e-9)
        ours = lambda model=model: hf.simulate(model, *on_device)[0]
        times = alternate({"hystfit": ours, "numba": lambda loop=loop: loop(u, dt)}, repeats)
        rows += beside(times, name)
    return rows + in_c(u, dt, repeats)


IN_C = ("Bouc-Wen", "Bouc-Wen, exact", "Duhem", "10 plays", "linear creep")


def in_c(u: np.ndarray, dt: np.ndarray, repeats: int) -> list[Row]:
    """Some models beside their exported C code, compiled with optimization.

    Args:
        u: input, shape (T,).
        dt: time since the sample before, shape (T,) [s].
        repeats: of each.
    """
    rows, on_device = [], (jnp.asarray(u), jnp.asarray(dt))
    for name in IN_C:
        model = MODELS[name]
        calls = {"hystfit": lambda model=model: hf.simulate(model, *on_device)[0]}
        if GCC is None:
            rows.append(Row(f"{name} / gcc", alternate(calls, repeats)["hystfit"], None, "no C compiler"))
            continue
        loop = compiled(model)
        np.testing.assert_allclose(hf.simulate(model, u, dt)[0], loop(u, dt), rtol=1e-9, atol=1e-9)
        rows += beside(alternate({**calls, "gcc": lambda loop=loop: loop(u, dt)}, repeats), name)
    return rows


if __name__ == "__main__":
    from run import alone

    alone("steps")
