"""Cost against samples, parameters, grid and batch: `python benchmarks/scaling.py` writes benchmarks/scaling.json and .svg."""

from __future__ import annotations

import argparse
import json
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
from steps import MODELS, signal
from timing import alternate

import hystfit as hf
from hystfit.models.simulation import run
from hystfit.params.space import ParameterSpace

HERE = Path(__file__).parent
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


PANELS = {
    "samples": ("samples", "ns a sample"),
    "parameters": ("free parameters", "output and Jacobian / output"),
    "grid": ("cells along an axis", "ms"),
    "batch": ("parameter vectors", "ns a sample and vector"),
}


def draw(found: dict[str, Any], path: Path) -> None:
    """Four panels, logarithmic in both directions."""
    import matplotlib

    matplotlib.use("svg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(2, 2, figsize=(10, 7), layout="constrained")
    for ax, (panel, (across, up)) in zip(axes.flat, PANELS.items(), strict=True):
        for name, curve in found[panel].items():
            ax.loglog([int(k) for k in curve], list(curve.values()), "o-", label=name)
        ax.set(xlabel=across, ylabel=up)
        ax.grid(visible=True, which="both", alpha=0.3)
        ax.legend(fontsize="small")
    about = found["machine"]
    figure.suptitle(
        f"{about['cpu']}, one process, float64; jax {about['jax']}, numba {about['numba']}", fontsize="small"
    )
    figure.savefig(path, metadata={"Date": None})
    pyplot.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--redraw", action="store_true", help="draw the stored numbers again")
    numbers = HERE / "scaling.json"
    if not parser.parse_args().redraw:
        hf.enable_x64()
        found = {
            "machine": machine(),
            "samples": by_samples((100, 1_000, 10_000, 100_000, 1_000_000), 7),
            "parameters": by_parameters((3, 6, 12, 24, 48), 10_000, 7),
            "grid": by_grid((10, 20, 40, 80), 10_000, 7),
            "batch": by_batch((1, 4, 16, 64, 256), 10_000, 5),
        }
        numbers.write_text(json.dumps(found, indent=2) + "\n")
    draw(json.loads(numbers.read_text()), HERE / "scaling.svg")


if __name__ == "__main__":
    main()
