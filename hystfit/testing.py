"""The laws that every model keeps: `check_model` tests hystfit's own models, and one of yours, with the optional methods it gives.

Example:
    >>> from hystfit.testing import check_model
    >>> check_model(MyModel(stiffness=2.0), amplitude=10.0)  # in a test
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from hystfit.config import require_x64
from hystfit.data.record import Record
from hystfit.errors import ModelError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.registry import make_model
from hystfit.models.shared.simulation import run, simulate
from hystfit.models.shared.step_inverse import AbstractStepInverse, SearchStep
from hystfit.params.space import ParameterSpace

_EAGER = 5  # samples of the run without jit


class Probe(NamedTuple):
    """What a model is driven with: input and time steps, shape (T,), and an index in the middle."""

    u: np.ndarray
    dt: np.ndarray
    cut: int


def check_model(
    model: AbstractHysteresis | type[AbstractHysteresis] | str,
    *,
    seed: int = 0,
    amplitude: float = 1.0,
    center: float = 0.0,
    dt: float = 0.01,
    samples: int = 64,
    kinked: Sequence[str] = (),
    flat: Sequence[str] = (),
    counts_samples: bool = False,
    tolerance: float = 1e-6,
) -> None:
    """Test the laws of a model on a random input with reversals, repeated values and irregular time steps.

    The model is simulated as it is given: give it parameters away from their bounds and from values where its equations switch.

    Args:
        model: any model; of a class or of my_file.py:MyModel the one with default values.
        seed: of the input.
        amplitude: the input runs within center +- amplitude [u].
        center: middle of the input [u].
        dt: mean time between samples [s].
        samples: length of the input.
        kinked: parameters, by name, in which the output has kinks or jumps: their derivatives are not compared with differences.
        flat: parameters, by name, whose derivative is zero by convention (thresholds of relays).
        counts_samples: the memory of the model counts samples (a delay in samples): repeating one is an event.
        tolerance: of the derivatives, relative to the largest central difference of each parameter.

    Raises:
        AssertionError: a law is broken; the message names it, with the deviation.
        ModelError: a class lacks methods; the message names the class, its file and the methods.
        PrecisionError: double precision is off.
    """
    require_x64()
    model = make_model(model)
    probe = _probe(seed, amplitude, center, dt, samples)
    name = type(model).__name__
    _check_interface(model, probe, name)
    y, end = simulate(model, probe.u, probe.dt)
    y = np.asarray(y)
    _require(bool(np.isfinite(y).all()), f"{name}: the output is not finite at sample {_first_bad(y)}")
    _check_eager(model, probe, y, name)
    _check_continuation(model, probe, y, name)
    if not counts_samples:
        _check_repetition(model, probe, y, end, name)
    _check_time(model, probe, y, name)
    _check_gradients(model, probe, y, name, set(kinked), set(flat), tolerance)
    _check_start(model, probe, y, name)
    _check_columns(model, probe, name)
    _check_inverse(model, probe, name)


def _probe(seed: int, amplitude: float, center: float, dt: float, samples: int) -> Probe:
    """A path through random turning points, some samples repeated, time steps spread over a factor of three."""
    if samples < 24:
        raise ModelError(f"the laws need at least 24 samples, got {samples}")
    rng = np.random.default_rng(seed)
    corners = np.concatenate([[rng.uniform(-0.2, 0.2)], rng.uniform(-1.0, 1.0, 5), [1.0, -0.9, 0.7]])
    u = np.interp(np.linspace(0.0, corners.size - 1.0, samples), np.arange(corners.size), corners)
    u += 0.01 * rng.uniform(-1.0, 1.0, samples)
    u[samples // 3] = u[samples // 3 - 1]
    steps = dt * rng.uniform(0.5, 1.5, samples)
    steps[0] = 0.0
    return Probe(center + amplitude * np.clip(u, -1.0, 1.0), steps, samples // 2)


def _agree(found: Any, expected: Any, law: str, rtol: float = 1e-12, *, allowed: float | None = None) -> None:
    """Equal to rtol times the largest expected value, or to an absolute error that is allowed."""
    found, expected = np.asarray(found), np.asarray(expected)
    if found.shape != expected.shape:
        raise AssertionError(f"{law}: shape {found.shape}, expected {expected.shape}")
    if allowed is None:
        allowed = rtol * max(float(np.max(np.abs(expected), initial=0.0)), 1e-300)
    error = np.abs(found - expected)
    if not (error <= allowed).all():
        at = np.unravel_index(int(np.argmax(np.where(np.isnan(error), np.inf, error))), error.shape)
        place = tuple(int(k) for k in at)
        raise AssertionError(
            f"{law}: off by {error[at]:.3g}, {found[at]:.9g} for {expected[at]:.9g} at {place}, allowed {allowed:.3g}"
        )


def _require(condition: bool, law: str) -> None:
    if not condition:
        raise AssertionError(law)


def _check_interface(model: AbstractHysteresis, probe: Probe, name: str) -> None:
    _require(isinstance(model.rate_independent, bool), f"{name}.rate_independent must be True or False")
    ParameterSpace.of(model)  # refuses values outside their bounds, and a model without parameters
    u0, u1, dt = (jnp.asarray(x) for x in (probe.u[0], probe.u[1], probe.dt[1]))
    state = jax.eval_shape(model.init, u0)
    _require(
        isinstance(state, jax.ShapeDtypeStruct) and state.ndim == 1,
        f"{name}.init must return one array of one dimension",
    )
    _require(state.dtype == u0.dtype, f"{name}.init: state of {state.dtype}, expected {u0.dtype}")
    after, y = jax.eval_shape(model.step, state, u0, u1, dt)
    _require(
        isinstance(after, jax.ShapeDtypeStruct) and after.shape == state.shape and after.dtype == state.dtype,
        f"{name}.step must return a state like that of init, {state.dtype}{list(state.shape)}",
    )
    _require(
        y.shape == () and y.dtype == u0.dtype, f"{name}.step must return one number as output, got shape {y.shape}"
    )


def _check_continuation(model: Any, probe: Probe, y: np.ndarray, name: str) -> None:
    """Rest, first half, and from its end the second half and rest: all of one length, so that one compilation serves."""
    cut, size = probe.cut, probe.u.size
    early = np.concatenate([np.full(size - cut, probe.u[0]), probe.u[:cut]])
    first, middle = simulate(model, early, np.concatenate([np.zeros(size - cut), probe.dt[:cut]]))
    late = np.concatenate([probe.u[cut:], np.full(cut, probe.u[-1])])
    second, _ = simulate(model, late, np.concatenate([probe.dt[cut:], np.zeros(cut)]), resume=middle)
    halves = np.concatenate([first[size - cut :], second[: size - cut]])
    _agree(halves, y, f"{name}: a run in two halves, the first after a rest, must equal one run")


def _check_repetition(model: Any, probe: Probe, y: np.ndarray, end: Any, name: str) -> None:
    size = probe.u.size
    rested, rested_end = simulate(model, np.full(size, probe.u[-1]), np.zeros(size), resume=end)
    _agree(rested_end.state, end.state, f"{name}: padding (last input repeated, dt = 0) must keep the state")
    _agree(rested, np.full(size, y[-1]), f"{name}: padding must keep the output")
    half = size // 2
    times = np.stack([probe.dt[:half], np.zeros(half)], axis=1).reshape(-1)
    twice, _ = simulate(model, _fill(np.repeat(probe.u[:half], 2), size), _fill(times, size, 0.0))
    _agree(twice[: 2 * half : 2], y[:half], f"{name}: samples given twice (dt = 0) must change nothing")


def _fill(values: np.ndarray, size: int, last: float | None = None) -> np.ndarray:
    return np.concatenate([values, np.full(size - values.size, values[-1] if last is None else last)])


def _first_bad(y: Any) -> int:
    return int(np.argmax(~np.isfinite(np.asarray(y))))


def _check_eager(model: AbstractHysteresis, probe: Probe, y: np.ndarray, name: str) -> None:
    state, before = model.init(jnp.asarray(probe.u[0])), jnp.asarray(probe.u[0])
    outputs: list[float] = []
    for u, dt in zip(probe.u[:_EAGER], probe.dt[:_EAGER], strict=True):
        state, output = model.step(state, before, jnp.asarray(u), jnp.asarray(dt))
        before = jnp.asarray(u)
        outputs.append(float(output))
    _agree(outputs, y[:_EAGER], f"{name}: steps without jit must equal the compiled run")


def _check_time(model: AbstractHysteresis, probe: Probe, y: np.ndarray, name: str) -> None:
    """A model declared rate-independent runs without time, and its output does not depend on it."""
    if model.rate_independent:
        _agree(simulate(model, probe.u)[0], y, f"{name} is declared rate independent: it must not need dt")
        _agree(
            simulate(model, probe.u, 7.0 * probe.dt[::-1])[0],
            y,
            f"{name} is declared rate independent: other times must give the same output",
        )
        return
    try:
        simulate(model, probe.u)
    except ModelError:
        return
    raise AssertionError(f"{name} depends on time: simulate must refuse to run without dt")


class _Point(eqx.Module):
    """A model as a function of all its parameters."""

    coordinates: Any

    def __call__(self, x: Array, u: Array, dt: Array) -> Array:
        return run(self.coordinates.assemble(x), u, dt)[0]


@eqx.filter_jit
def _derivatives(point: _Point, x: Array, u: Array, dt: Array, weights: Array) -> tuple[Array, Array]:
    f = lambda x: point(x, u, dt)
    return jax.jacfwd(f)(x), jax.vjp(f, x)[1](weights)[0]


@eqx.filter_jit
def _batched(point: _Point, x: Array, u: Array, dt: Array) -> Array:
    return jax.vmap(lambda x, u: point(x, u, dt))(x, u)


def _check_gradients(
    model: AbstractHysteresis,
    probe: Probe,
    y: np.ndarray,
    name: str,
    kinked: set[str],
    flat: set[str],
    tolerance: float,
) -> None:
    """Forward = reverse = central differences, sample by sample, so at reversals too; of the fixed parameters as well."""
    space = _everything(model)
    bases = [label.split("[")[0] for label in space.names]
    missing = (kinked | flat) - set(bases)
    _require(not missing, f"{name} has no parameter {sorted(missing)}; it has {sorted(set(bases))}")
    x, point, dt = space.vector(model), _Point(space.coordinates), jnp.asarray(probe.dt)
    weights = np.random.default_rng(1).normal(size=probe.u.size)
    forward, reverse = (np.asarray(a) for a in _derivatives(point, x, jnp.asarray(probe.u), dt, jnp.asarray(weights)))
    central, noise = _differences(model, space, probe, y, name)
    for k, label in enumerate(space.names):
        column, expected = forward[:, k], central[:, k]
        _require(
            bool(np.isfinite(column).all()), f"{name}: the derivative in {label} is not finite at {_first_bad(column)}"
        )
        size = float(np.max(np.abs(column)))
        law = f"{name}: reverse mode in {label} against forward mode"
        _agree(reverse[k], weights @ column, law, allowed=1e-11 * probe.u.size * max(size, 1e-300))
        if bases[k] in flat:
            _require(size == 0.0, f"{name}: the derivative in {label} is declared to be zero, found {size:.3g}")
        elif bases[k] not in kinked:
            law = f"{name}: derivative in {label} against central differences"
            _agree(column, expected, law, allowed=tolerance * float(np.max(np.abs(expected))) + noise[k])


def _differences(
    model: AbstractHysteresis, space: ParameterSpace, probe: Probe, y: np.ndarray, name: str
) -> tuple[np.ndarray, np.ndarray]:
    """Central differences, shape (T, p), and their rounding, from one batch that also tests vmap against a loop."""
    x = space.vector(model)
    h = np.array([_step(*row) for row in zip(x, space.infos, strict=True)])
    inputs = np.stack([probe.u, probe.u[::-1], 0.5 * (probe.u + probe.u[0])])
    points = np.concatenate([np.tile(x, (3, 1)), x + np.diag(h), x - np.diag(h)])
    driven = np.concatenate([inputs, np.tile(probe.u, (2 * x.size, 1))])
    out = np.asarray(_batched(_Point(space.coordinates), *(jnp.asarray(a) for a in (points, driven, probe.dt))))
    for found, u in zip(out, inputs, strict=False):
        _agree(found, simulate(model, u, probe.dt)[0], f"{name}: a batch under vmap must equal a loop")
    above, below = out[3 : 3 + x.size], out[3 + x.size :]
    return ((above - below) / (2.0 * h[:, None])).T, 1e-14 * np.max(np.abs(y)) / h


def _everything(model: AbstractHysteresis) -> ParameterSpace:
    """The space in which nothing is fixed."""
    held = ParameterSpace.of(model).fixed()
    return ParameterSpace.of(model, free=[row[0] for row in held])


def _step(x: float, info: Any) -> float:
    """Step of a central difference that stays within the bounds."""
    h = 1e-5 * (abs(x) or info.scale)
    lower, upper = info.bounds
    room = min(x - lower, upper - x)
    if room == 0.0:
        raise AssertionError(f"a parameter lies on its bound {x:g}: give the model values inside the bounds")
    return min(h, 0.5 * room) if math.isfinite(room) else h


def _check_start(model: AbstractHysteresis, probe: Probe, y: np.ndarray, name: str) -> None:
    noise = 1e-3 * np.ptp(y) * np.random.default_rng(2).normal(size=probe.u.size)
    started = model.start([Record(u=probe.u, y=y + noise, t=np.cumsum(probe.dt))])
    _require(type(started) is type(model), f"{name}.start returned a {type(started).__name__}")
    same: Callable[[Any], Any] = jax.tree_util.tree_structure
    _require(same(started) == same(model), f"{name}.start must keep the structure of the model")
    shapes = [[np.shape(leaf) for leaf in jax.tree_util.tree_leaves(tree)] for tree in (started, model)]
    _require(shapes[0] == shapes[1], f"{name}.start changed the shapes of the parameters: {shapes[0]}, {shapes[1]}")
    space = ParameterSpace.of(started)  # refuses what is not finite or outside its bounds
    _require(bool(np.isfinite(space.vector(started)).all()), f"{name}.start gave a parameter that is not finite")
    again, _ = simulate(started, probe.u, probe.dt)
    _require(bool(jnp.isfinite(again).all()), f"{name}.start gave a model whose output is not finite")


def _check_columns(model: AbstractHysteresis, probe: Probe, name: str) -> None:
    """Linear weights times their columns, and the short cut, equal the scan; on few reversals, as memories may be limited."""
    a, b = probe.u.size // 3, 2 * probe.u.size // 3
    u = np.concatenate([np.sort(probe.u[:a]), np.sort(probe.u[a:b])[::-1], np.sort(probe.u[b:])])
    y = np.asarray(simulate(model, u, probe.dt)[0])
    design, leaves = model.design_matrix(u, probe.dt), jax.tree_util.tree_leaves(model)
    linear = sum((b.columns @ np.ravel(np.asarray(leaves[b.leaf])) for b in design.blocks), start=design.rest)
    _agree(linear[design.index], y, f"{name}.design_matrix times the linear weights must equal simulate", 1e-9)
    if model.has_fast_run:
        _agree(model.free_run(u, probe.dt), y, f"{name}.free_run must equal simulate", 1e-9)
    reach = model.reach()
    _require(reach is None or reach[0] < reach[1], f"{name}.reach must be (low, high) with low < high, got {reach}")


@eqx.filter_jit
def _inverted(inverse: AbstractStepInverse, u: Array, dt: Array, low: Array, high: Array) -> tuple[Array, ...]:
    """Per sample: output, output for the input that the inverse gives, whether the output rises there, and the inverse's own step."""
    model = inverse.model

    def body(carry: tuple[Array, Array], sample: tuple[Array, Array]) -> tuple[tuple[Array, Array], tuple[Array, ...]]:
        (state, u0), (u1, dt) = carry, sample
        after, y = model.step(state, u0, u1, dt)
        root = inverse.solve(state, u0, y, dt, low, high)
        again = model.step(state, u0, root.x, dt)[1]
        return (after, u1), (y, again, root.rising, inverse.advance(state, u0, u1, dt)[1])

    return jax.lax.scan(body, (model.init(u[0]), u[0]), (u, dt))[1]


def _check_inverse(model: AbstractHysteresis, probe: Probe, name: str) -> None:
    """A closed-form inverse of one sample gives an input with the same output; a search is tested with hystfit itself."""
    try:
        inverse = model.step_inverse()
    except ModelError:
        return
    if type(inverse) is SearchStep:
        return
    low, high = model.reach() or (float(probe.u.min()), float(probe.u.max()))
    low, high = min(low, float(probe.u.min())), max(high, float(probe.u.max()))
    y, again, rising, stepped = (
        np.asarray(a) for a in _inverted(inverse, *(jnp.asarray(v) for v in (probe.u, probe.dt, low, high)))
    )
    _require(bool(rising.any()), f"{name}.step_inverse: there is no sample at which the output rises with the input")
    _agree(stepped, y, f"{name}.step_inverse: advance must equal step", 1e-9)
    _agree(again[rising], y[rising], f"{name}.step_inverse must give an input with the same output", 1e-7)
