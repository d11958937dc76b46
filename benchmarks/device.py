"""The same work on a GPU and on this machine's CPU: one long record by associative scans, many parameter vectors in one kernel.

Where no GPU is found, each row says so and nothing is timed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from rows import Row, beside
from steps import BOUC_WEN, MODELS, signal
from timing import alternate

import hystfit as hf
from hystfit.inference.problem import Problem
from hystfit.models.parallel.route import on_gpu
from hystfit.models.simulation import run

LONG = ("20 stops", "Duhem", "linear creep", "resonance")  # models with an associative form
WORK = (*(f"{name}, one long record" for name in LONG), "Bouc-Wen, Jacobians of many starts", "Bouc-Wen, many walkers")


def measure(quick: bool) -> list[Row]:
    """Rows of the suite; outputs of both devices are compared before they are timed."""
    if not on_gpu():
        return [Row(f"{name} / CPU", None, None, "no GPU found") for name in WORK]
    samples, lanes, repeats = (5_000, 64, 1) if quick else (1_000_000, 4096, 5)
    u, dt = signal(samples), np.full(samples, 0.001)
    calls: list[tuple[Callable[..., Any], Any]] = [
        (lambda model, u, dt: run(model, u, dt)[0], (MODELS[name], u, dt)) for name in LONG
    ]
    short = signal(2_000)
    y = np.asarray(hf.simulate(hf.BoucWen(**BOUC_WEN), short)[0])
    y = y + np.random.default_rng(0).normal(0, 0.003, y.size)
    density = Problem(hf.BoucWen(**BOUC_WEN), hf.Record(u=short, y=y), noise="ou").density
    z = np.random.default_rng(1).normal(0, 0.1, (lanes, density.p + len(density.noise.kinds)))
    calls.append((lambda d, z: jax.vmap(d.objective.linearize_at)(z[:, : d.p]), (density, z)))
    calls.append((lambda d, z: jax.vmap(d.log_likelihood_lean)(z), (density, z)))
    return [row for name, call in zip(WORK, calls, strict=True) for row in _on_both(name, *call, repeats)]


def _on_both(name: str, function: Callable[..., Any], arguments: Any, repeats: int) -> list[Row]:
    """The function on the GPU beside the same on the CPU, each in its own form.

    Args:
        name: of the row.
        function: traced.
        arguments: arrays and trees of them.
        repeats: of each.
    """
    calls = {}
    for words, where in {"hystfit": "gpu", "CPU": "cpu"}.items():
        device = jax.local_devices(backend=where)[0]
        compiled, placed = jax.jit(function), jax.device_put(arguments, device)

        def call(device: Any = device, compiled: Any = compiled, placed: Any = placed) -> Any:
            with jax.default_device(device):  # decides the form: see hystfit.models.parallel.route
                return compiled(*placed)

        calls[words] = call
    agree = lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-8)
    jax.tree.map(agree, calls["hystfit"](), calls["CPU"]())
    return beside(alternate(calls, repeats), name)


if __name__ == "__main__":
    from run import alone

    alone("device")
