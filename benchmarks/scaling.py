"""Cost against samples, parameters, grid, batch and chains: `python benchmarks/scaling.py` writes benchmarks/scaling.json.

The page on speed draws these numbers.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from loops import loop_of
from run import machine
from sampling import ensemble, record
from steps import MODELS, signal
from timing import alternate

import hystfit as hf
from hystfit.models.shared.simulation import run
from hystfit.params.space import ParameterSpace
from hystfit.sampling.ensemble import start, walk
from hystfit.sampling.setup import prepare

_DRAWS, _WARMUP, _STEPS = 200, 100, 50
SHOWN = ("Bouc-Wen", "Bouc-Wen, exact", "Duhem", "10 plays", "logarithmic creep")
Curve = dict[str, float]


def jacobian(model: hf.AbstractHysteresis, u: jax.Array) -> tuple[Callable[[], Any], int]:
    """Output and derivatives by all free parameters in one forward pass, and how many these are."""
    space = ParameterSpace.of(model)
    x = jnp.asarray(space.vector([model]))

    def both(x: jax.Array, coordinates: Any, u: jax.Array) -> Any:
        output = lambda x: run(coordinates.assemble(x, 0), u, jnp.zeros_like(u))[0]
        push = lambda t: jax.jvp(output, (x,), (t,))
        return jax.vmap(push, out_axes=(None, 0))(jnp.eye(x.shape[0]))

    compiled = jax.jit(both)
    return lambda: compiled(x, space.coordinates, u), x.shape[0]


def by_samples(counts: tuple[int, ...], repeats: int) -> dict[str, Curve]:
    """Nanoseconds a sample of a simulation from and to NumPy, and of the numba loop of Bouc-Wen."""
    curves: dict[str, Curve] = {name: {} for name in (*SHOWN, "numba, Bouc-Wen")}
    loop = loop_of(MODELS["Bouc-Wen"])
    for samples in counts:
        data = signal(samples), np.full(samples, 0.001)
        calls = {name: partial(_simulated, MODELS[name], *data) for name in SHOWN}
        for name, taken in alternate({**calls, "numba, Bouc-Wen": partial(loop, *data)}, repeats).items():
            curves[name][str(samples)] = 1e9 * taken / samples
    return curves


def _simulated(model: hf.AbstractHysteresis, u: np.ndarray, dt: np.ndarray) -> np.ndarray:
    return np.asarray(hf.simulate(model, u, dt)[0])


def by_parameters(plays: tuple[int, ...], samples: int, repeats: int) -> dict[str, Curve]:
    """Time of output and Jacobian over that of the output, for plays with a free weight each."""
    u, curve = jnp.asarray(signal(samples)), {}
    for count in plays:
        model = hf.PrandtlIshlinskii.of(count)
        both, p = jacobian(model, u)
        times = alternate({"both": both, "output": lambda model=model: hf.simulate(model, u)[0]}, repeats)
        curve[str(p)] = times["both"] / times["output"]
    return {"plays": curve}


def by_grid(sizes: tuple[int, ...], samples: int, repeats: int) -> dict[str, Curve]:
    """Milliseconds of a Preisach simulation by its distinct states, the compilation of the input included."""
    u, curve = signal(samples), {}
    for n in sizes:
        model = hf.Preisach.of(n, degree=1, reversible=False, spacing="uniform")
        curve[str(n)] = 1e3 * alternate({"run": lambda model=model: model.free_run(u)}, repeats)["run"]
    return {f"cells, {samples} samples": curve}


def by_batch(lanes: tuple[int, ...], samples: int, repeats: int) -> dict[str, Curve]:
    """Nanoseconds a sample and parameter vector, one after another and side by side."""
    u = jnp.asarray(signal(samples))
    model = MODELS["Bouc-Wen"]
    cost = lambda tau: jnp.sum(run(eqx.tree_at(lambda m: m.tau, model, tau), u, jnp.zeros_like(u))[0])
    each, together = jax.jit(lambda taus: jax.lax.map(cost, taus)), jax.jit(jax.vmap(cost))
    curves: dict[str, Curve] = {"one after another": {}, "side by side (vmap)": {}}
    for count in lanes:
        taus = jnp.linspace(1.0, 2.0, count)
        calls = {
            "one after another": lambda taus=taus: each(taus),
            "side by side (vmap)": lambda taus=taus: together(taus),
        }
        for name, taken in alternate(calls, repeats).items():
            curves[name][str(count)] = 1e9 * taken / (samples * count)
    return curves


def by_chains(chains: tuple[int, ...], walkers: tuple[int, ...], samples: int, repeats: int) -> dict[str, Curve]:
    """Milliseconds of one core a draw of each chain: of whole NUTS runs with their warm-up, and of the steps of emcee's walkers."""
    fit = hf.fit("bouc-wen", record(samples), noise="iid", starts=1)
    nuts = {
        str(count): lambda count=count: hf.sample(fit, "nuts", noise="iid", chains=count, warmup=_WARMUP, draws=_DRAWS)
        for count in chains
    }
    target = prepare(fit, noise="iid").target
    steps = {str(count): ensemble(walk(target, count), start(target, count, 1), _STEPS) for count in walkers}
    return {
        f"NUTS, {_DRAWS} draws and {_WARMUP} of warm-up": _each(nuts, _DRAWS, 1),
        "emcee, a step of all walkers": _each(steps, _STEPS, repeats),
    }


def _each(calls: dict[str, Callable[[], Any]], draws: int, repeats: int) -> Curve:
    return {
        count: 1e3 * taken / (int(count) * draws)
        for count, taken in alternate(calls, repeats, clock=time.process_time).items()
    }


def main() -> None:
    hf.enable_x64()
    found = {
        "machine": machine(),
        "samples": by_samples((100, 1_000, 10_000, 100_000, 1_000_000), 7),
        "parameters": by_parameters((3, 6, 12, 24, 48), 10_000, 7),
        "grid": by_grid((10, 20, 40, 80), 10_000, 7),
        "batch": by_batch((1, 4, 16, 64, 256), 10_000, 5),
        "chains": by_chains((1, 2, 4, 8), (16, 32, 64, 128, 256), 2_000, 5),
    }
    (Path(__file__).parent / "scaling.json").write_text(json.dumps(found, indent=2) + "\n")


if __name__ == "__main__":
    main()
