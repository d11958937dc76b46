"""Programs that predict the asked outputs: hystfit, and what people use without it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numba
import numpy as np
import optax
from scipy.optimize import differential_evolution, least_squares
from tasks import Task

import hystfit as hf


@dataclasses.dataclass(frozen=True)
class Prediction:
    """Outputs of every record, each of shape (T,), and the number of fitted parameters."""

    outputs: list[np.ndarray]
    parameters: int


Entrant = Callable[[Task], Prediction]


@dataclasses.dataclass(frozen=True)
class Scaled:
    """Records scaled so that, where outputs are given, inputs span -1..1 and outputs have mean 0 and deviation 1."""

    inputs: list[np.ndarray]
    outputs: list[np.ndarray]
    given: list[np.ndarray]
    center: float
    deviation: float

    @classmethod
    def of(cls, task: Task) -> Scaled:
        """The records of a task."""
        pairs = list(zip(task.records, task.given, strict=True))
        driven = np.concatenate([record.u[mask] for record, mask in pairs])
        low, high = float(driven.min()), float(driven.max())
        known = np.concatenate([record.y[mask] for record, mask in pairs])
        center, deviation = float(known.mean()), float(known.std())
        return cls(
            [2 * (record.u - low) / (high - low) - 1 for record in task.records],
            [(record.y - center) / deviation for record in task.records],
            [np.asarray(mask) for mask in task.given],
            center,
            deviation,
        )

    def known(self, parts: Sequence[np.ndarray]) -> np.ndarray:
        """Rows of all records whose outputs are given, below each other."""
        return np.concatenate([part[mask] for part, mask in zip(parts, self.given, strict=True)])

    def prediction(self, outputs: Sequence[np.ndarray], parameters: int) -> Prediction:
        """Scaled outputs as a prediction."""
        return Prediction([self.center + self.deviation * np.asarray(y) for y in outputs], parameters)

    def linear(self, columns: Sequence[np.ndarray], parameters: int = 0) -> tuple[Prediction, np.ndarray]:
        """The best combination of columns, each of shape (T, K), with a ridge of 1e-6, and its residuals where outputs are given."""
        design, y = self.known(columns), self.known(self.outputs)
        normal = design.T @ design + 1e-6 * len(y) * np.eye(design.shape[1])
        weights = np.linalg.solve(normal, design.T @ y)
        prediction = self.prediction([part @ weights for part in columns], parameters + len(weights))
        return prediction, design @ weights - y


def line(task: Task) -> Prediction:
    """A straight line."""
    scaled = Scaled.of(task)
    return scaled.linear([np.column_stack([np.ones_like(u), u]) for u in scaled.inputs])[0]


def last_cycle(task: Task) -> Prediction:
    """The last rising and the last falling branch of the given outputs, each a function of the input."""
    scaled = Scaled.of(task)
    u, y = scaled.known(scaled.inputs), scaled.known(scaled.outputs)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(u))) != 0) + 1
    spans = sorted(zip([0, *turns], [*turns, u.size - 1], strict=True), key=lambda span: abs(np.ptp(u[list(span)])))
    wide = [span for span in spans if np.ptp(u[list(span)]) > 0.5 * np.ptp(u[list(spans[-1])])]
    branches: dict[bool, tuple[np.ndarray, np.ndarray]] = {}
    for begin, end in sorted(wide):
        order = np.argsort(u[begin : end + 1])
        branches[bool(u[end] > u[begin])] = u[begin : end + 1][order], y[begin : end + 1][order]
    other = next(iter(branches.values()))
    outputs = []
    for x in scaled.inputs:
        rises = np.gradient(x) >= 0
        up, down = (np.interp(x, *branches.get(side, other)) for side in (True, False))
        outputs.append(np.where(rises, up, down))
    return scaled.prediction(outputs, 0)


@numba.njit(cache=True)
def _plays(u: np.ndarray, radii: np.ndarray) -> np.ndarray:
    out = np.empty((u.size, radii.size))
    for k in range(radii.size):
        p = u[0]
        for n in range(u.size):
            p = max(u[n] - radii[k], min(u[n] + radii[k], p))
            out[n, k] = p
    return out


def ten_plays(task: Task) -> Prediction:
    """Ten plays of even radii and a line, by linear least squares."""
    scaled = Scaled.of(task)
    radii = np.linspace(0.09, 0.9, 10)
    return scaled.linear([np.column_stack([np.ones_like(u), u, _plays(u, radii)]) for u in scaled.inputs])[0]


@numba.njit(cache=True)
def _bouc_wen(u: np.ndarray, a: float, beta: float, gamma: float, n: float) -> np.ndarray:
    out, z = np.zeros(u.size), 0.0
    for k in range(1, u.size):
        du = u[k] - u[k - 1]
        z += a * du - (beta * abs(du) * z + gamma * du * abs(z)) * abs(z) ** (n - 1)
        z = min(max(z, -1e6), 1e6)
        out[k] = z
    return out


def bouc_wen(task: Task) -> Prediction:
    """The textbook Bouc-Wen model y = a + b u + c z by scipy's `least_squares` from four starts."""
    scaled = Scaled.of(task)

    def columns(x: np.ndarray) -> list[np.ndarray]:
        a, beta, gamma, n = np.exp(x[0]), np.exp(x[1]), x[2], 1 + np.exp(x[3])
        return [np.column_stack([np.ones_like(u), u, _bouc_wen(u, a, beta, gamma, n)]) for u in scaled.inputs]

    starts = ([0.0, 0.0, 0.0, -1.0], [0.0, 1.5, 1.0, -1.0], [0.0, 1.5, -1.0, 0.0], [0.0, 0.0, 0.5, 0.0])
    limits = [-5.0, -5.0, -30.0, -4.0], [5.0, 5.0, 30.0, 2.0]
    fits = [
        least_squares(lambda x: scaled.linear(columns(x))[1], start, bounds=limits, max_nfev=200) for start in starts
    ]
    best = min(fits, key=lambda fit: fit.cost)
    return scaled.linear(columns(best.x), parameters=4)[0]


@numba.njit(cache=True)
def _jiles_atherton(h: np.ndarray, a: float, alpha: float, k: float, c: float) -> np.ndarray:
    """Magnetization over its saturation, from the demagnetized state at the first field."""
    out, m = np.zeros(h.size), 0.0
    for n in range(h.size):
        dh = h[n] - (h[n - 1] if n else 0.0)
        steps = max(1, min(50, int(abs(dh) / (0.2 * a))))
        for j in range(steps):
            x = (h[n] - dh + dh * (j + 1) / steps + alpha * m) / a
            if abs(x) < 1e-3:
                anhysteretic, slope = x / 3, 1 / 3 / a
            else:
                t = np.tanh(x)
                anhysteretic, slope = 1 / t - 1 / x, (1 / x**2 - (1 / t**2 - 1)) / a
            gap, sign = anhysteretic - m, 1.0 if dh >= 0 else -1.0
            irreversible = gap / (sign * k - alpha * gap) if gap * sign > 0 else 0.0
            rate = ((1 - c) * irreversible + c * slope) / (1 - c * alpha * slope)
            m = min(max(m + max(rate, 0.0) * dh / steps, -1.5), 1.5)
        out[n] = m
    return out


def jiles_atherton(task: Task) -> Prediction:
    """Jiles-Atherton by scipy's differential evolution (population 48, 60 generations, seed 0), with an offset and a linear term."""
    scaled = Scaled.of(task)

    def columns(x: np.ndarray) -> list[np.ndarray]:
        a, alpha, k = np.exp(x[:3])
        return [np.column_stack([np.ones_like(u), u, _jiles_atherton(u, a, alpha * a, k, x[3])]) for u in scaled.inputs]

    def cost(x: np.ndarray) -> float:
        return float(np.sum(scaled.linear(columns(x))[1] ** 2))

    limits = [(-7, 1), (-7, 1), (-7, 1), (0, 0.99)]
    found = differential_evolution(cost, limits, popsize=12, maxiter=60, seed=0, polish=False, tol=1e-8)
    return scaled.linear(columns(found.x), parameters=4)[0]


def network(task: Task, *, width: int = 8, steps: int = 200) -> Prediction:
    """A gated recurrent unit of eight states with a line beside it, 200 steps of Adam, seed 0."""
    scaled = Scaled.of(task)
    longest = max(map(len, scaled.inputs))
    padded = lambda parts: jnp.asarray([np.pad(part, (0, longest - len(part)), mode="edge") for part in parts])
    u, y = padded(scaled.inputs), padded(np.nan_to_num(part) for part in scaled.outputs)
    weight = jnp.asarray([np.pad(mask.astype(float), (0, longest - len(mask))) for mask in scaled.given])
    inputs = jnp.stack([u, jnp.diff(u, axis=1, prepend=u[:, :1]) / jnp.abs(jnp.diff(u, axis=1)).mean()], axis=-1)
    draw = np.random.default_rng(0)
    start = {
        "gates": jnp.asarray(draw.normal(0, 0.3, (3, 2 + width + 1, width))),
        "out": jnp.asarray(draw.normal(0, 0.3, width)),
        "line": jnp.zeros(2),
    }

    def run(p: dict[str, Any]) -> jax.Array:
        def step(state: jax.Array, x: jax.Array) -> tuple[jax.Array, jax.Array]:
            ones = jnp.ones((x.shape[0], 1))
            update, reset = (jax.nn.sigmoid(jnp.hstack([x, state, ones]) @ gate) for gate in p["gates"][:2])
            fresh = jnp.tanh(jnp.hstack([x, reset * state, ones]) @ p["gates"][2])
            state = update * state + (1 - update) * fresh
            return state, state @ p["out"]

        _, out = jax.lax.scan(step, jnp.zeros((u.shape[0], width)), inputs.swapaxes(0, 1))
        return out.T + p["line"][0] + p["line"][1] * u

    optimizer = optax.adam(optax.cosine_decay_schedule(0.02, steps))

    @jax.jit
    def train(p: Any, state: Any) -> tuple[Any, Any]:
        slope = jax.grad(lambda p: jnp.sum(weight * (run(p) - y) ** 2) / weight.sum())(p)
        change, state = optimizer.update(slope, state)
        return optax.apply_updates(p, change), state

    p, state = start, optimizer.init(start)
    for _ in range(steps):
        p, state = train(p, state)
    outputs = [np.asarray(out[: len(part)]) for out, part in zip(run(p), scaled.inputs, strict=True)]
    return scaled.prediction(outputs, sum(leaf.size for leaf in jax.tree.leaves(p)))


def _by_fit(fit: hf.FitResult, task: Task) -> Prediction:
    return Prediction([fit.predict(record) for record in task.records], len(fit.x))


def hystfit_bare(task: Task) -> Prediction:
    """hystfit without a model's name, as `hystfit fit FILE`."""
    return _by_fit(hf.compare(task.training, progress=lambda *_: None).winner, task)


def hystfit_named(task: Task) -> Prediction:
    """hystfit with the model that the task names."""
    return _by_fit(hf.fit(task.model, task.training), task)


ENTRANTS: dict[str, Entrant] = {
    "hystfit": hystfit_bare,
    "hystfit, model by name": hystfit_named,
    "straight line": line,
    "last cycle": last_cycle,
    "ten plays": ten_plays,
    "Bouc-Wen, scipy": bouc_wen,
    "Jiles-Atherton, differential evolution": jiles_atherton,
    "recurrent network": network,
}
