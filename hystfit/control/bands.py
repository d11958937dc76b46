"""Inverses by posterior draws: bands of the input, and of the tracking error of the input computed for the fit."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hystfit.config import verb
from hystfit.control.inverse import Inverse, Task, invert, prepare
from hystfit.control.online_inverse import Answer, Limits
from hystfit.errors import ParameterError
from hystfit.models.shared.simulation import Resume, simulate
from hystfit.results.estimates import edges_of
from hystfit.sampling.posterior import Posterior


@dataclasses.dataclass(frozen=True)
class InverseBands:
    """A reference inverted by draws of a posterior.

    Attributes:
        reference: desired output, shape (T,).
        given: the inverse of the fitted model, whose input is what an experiment would apply.
        u: input that the inverse of each draw gives, shape (count, T).
        error: output of each draw for the input of `given`, minus the reference, shape (count, T): the tracking error if the
            parameters were those of the draw.
        missed: fraction of the samples that the inverse of each draw does not meet, shape (count,).
    """

    reference: np.ndarray
    given: Inverse
    u: np.ndarray
    error: np.ndarray
    missed: np.ndarray

    def __repr__(self) -> str:
        spread = float(np.median(np.std(self.u, axis=0)))
        return f"InverseBands({self.u.shape[0]} draws of {self.u.shape[1]} samples, median sd of u {spread:.3g}; given {self.given!r})"

    def band(self, of: str = "u", level: float = 0.9) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(lower, median, upper) of "u" or "error", pointwise, each (T,).

        Raises:
            ParameterError: another name, or a level outside (0, 1).
        """
        if of not in ("u", "error"):
            raise ParameterError(f'a band is of "u" or "error", got {of!r}')
        lower, median, upper = np.quantile(getattr(self, of), edges_of(level), axis=0)
        return lower, median, upper

    @property
    def rms(self) -> np.ndarray:
        """Root mean square tracking error of each draw, shape (count,)."""
        return np.sqrt(np.mean(self.error**2, axis=1))

    def plot(self, level: float = 0.9) -> Any:
        """Bands of input and tracking error over the samples; returns the matplotlib figure."""
        import matplotlib.pyplot as plt

        figure, axes = plt.subplots(2, 1, figsize=(7.2, 4.6), sharex=True, layout="constrained")
        at = np.arange(self.reference.size)
        for ax, of, label in zip(axes, ("u", "error"), ("input", "tracking error"), strict=True):
            low, middle, high = self.band(of, level)
            ax.fill_between(at, low, high, color="#d55e00", alpha=0.35, lw=0, label=f"{100 * level:.0f} % of the draws")
            ax.plot(
                at,
                self.given.u if of == "u" else middle,
                color="#0072b2",
                lw=0.9,
                label="applied" if of == "u" else "median",
            )
            ax.set_ylabel(label)
            ax.legend(frameon=False, fontsize=8)
        axes[1].set_xlabel("sample")
        return figure


@verb
def inverse_bands(
    posterior: Posterior,
    reference: Any,
    dt: Any = None,
    *,
    limits: Limits | None = None,
    rest: float | None = None,
    count: int = 100,
    seed: int = 0,
) -> InverseBands:
    """Invert a reference by the fitted model and by draws of its posterior.

    Args:
        posterior: its fit gives the input that is applied, its draws the bands.
        reference: desired output, shape (T,).
        dt: time between samples, a number or shape (T,); a rate-independent model needs none.
        limits: lowest and highest input; None for the range of the fitted input.
        rest: input at which the device was in equilibrium before the first sample, see `invert`.
        count: draws used.
        seed: of their choice.

    Raises:
        ModelError, DataError: see `invert`.
    """
    fit = posterior.result
    edges = fit.input_range if limits is None else limits
    given = invert(fit, reference, dt, limits=limits, rest=rest)
    wanted = np.asarray(reference, dtype=float)
    models = list(posterior.models(count, seed))
    inputs, codes = _invert_all(models, wanted, dt, edges, rest)
    errors = np.array([_simulated(model, given.u, dt, rest) - wanted for model in models])
    return InverseBands(wanted, given, inputs, errors, np.mean(codes != 0, axis=1))


def _simulated(model: Any, u: np.ndarray, dt: Any, rest: float | None) -> np.ndarray:
    """Output for the input u, shape (T,), in equilibrium before it at `rest`, or at its first sample."""
    if rest is None:
        return np.asarray(simulate(model, u, dt)[0])
    u0 = jnp.asarray(rest, dtype=float)
    return np.asarray(simulate(model, u, dt, resume=Resume(model.init(u0), u0))[0])


def _invert_all(
    models: list[Any], wanted: np.ndarray, dt: Any, edges: Limits, rest: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Inputs and codes by model, each (count, T): side by side in one scan where all inverses are of one form."""
    tasks = [prepare(model, wanted, dt, limits=edges, rest=rest) for model in models]
    forms = {jax.tree_util.tree_structure(task) for task in tasks}
    if tasks[0].inverse is None or len(forms) > 1:
        every = [invert(model, wanted, dt, limits=edges, rest=rest) for model in models]
        return np.array([one.u for one in every]), np.array([one.codes for one in every])
    found = _run_all(jax.tree_util.tree_map(lambda *leaves: jnp.stack(leaves), *tasks))
    return np.asarray(found.u), np.asarray(found.status)


@eqx.filter_jit
def _run_all(tasks: Task) -> Answer:
    return jax.vmap(lambda task: task.inverse.run(task.start, task.wanted, task.steps)[1])(tasks)
