"""Faults that the experiment of the unscented filter must notice (experiments/mutations.py)."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import identification
import jax.numpy as jnp
import numpy as np
import three_axes
import tracking
from common import Mutation, Results, substitute
from plants import LIMITS

from hystfit import BoucWen, LogCreep, SecondOrder, Series
from hystfit.control import invert, lead
from hystfit.identify import BlockVerdict, Ukf, identify_in_stages
from hystfit.identify.sigma_points import Unscented
from hystfit.params.coordinates import REAL
from hystfit.stage import Decoupled, StageInverse


def recovery(results: Results) -> None:
    """M4 on one record of each noise, and from far starts."""
    identification.filter_and_least_squares(results, 1)
    identification.methods(results, 2)


def stairs(results: Results) -> None:
    """M7 and M8."""
    tracking.ladder(results, identification.in_stages(results)[1])


def sines(results: Results) -> None:
    """M5 and M6."""
    tracking.sines(results, True, identification.in_stages(results)[1])


def _line() -> None:
    def line(model: Any, reference: Any, *_: Any, **__: Any) -> Any:
        slope = float(model.parts[0].c * (1 - 0.5 * model.parts[0].mu))
        return SimpleNamespace(u=np.clip(np.asarray(reference) / slope, *LIMITS))

    substitute(invert, line)


def _inverted_without_creep() -> None:
    original = invert
    still = lambda model: Series(model.parts[0], dataclasses.replace(model.parts[1], gamma=0 * model.parts[1].gamma))
    substitute(invert, lambda model, *rest, **options: original(still(model), *rest, **options))


def _changed_filter(change: Any) -> Any:
    """Puts a change of every new filter in place."""

    def apply() -> None:
        make = Ukf.of.__func__
        Ukf.of = classmethod(lambda cls, *rest, **options: change(make(cls, *rest, **options)))

    return apply


def _unbounded(ukf: Ukf) -> Ukf:
    """Parameters in linear coordinates, as if they had no bounds."""
    x = ukf.coordinates.physical(ukf.z0)
    linear = dataclasses.replace(ukf.coordinates, kinds=(REAL,) * x.size, scale=jnp.abs(x) + 1e-3)
    return dataclasses.replace(ukf, coordinates=linear, z0=x / linear.scale)


def _heavy_points() -> None:
    weights = Unscented.weights
    Unscented.weights = lambda self, center, like: 2.0 * weights(self, center, like)


def _other_side() -> None:
    step, sweep = BoucWen.step, BoucWen.sweep
    flipped = lambda model: dataclasses.replace(model, rho=-model.rho)
    BoucWen.step = lambda self, *rest: step(flipped(self), *rest)
    BoucWen.sweep = lambda self, *rest, **options: sweep(flipped(self), *rest, **options)


def _creep_first() -> None:
    original = identify_in_stages

    def swapped(model: Any, stages: Any, **options: Any) -> Any:
        return original(model, [stages[1], stages[0], *stages[2:]], **options)

    substitute(identify_in_stages, swapped)


def _slow_clock() -> None:
    original = invert
    substitute(invert, lambda model, reference, dt, **options: original(model, reference, 30 * dt, **options))


def _deaf() -> None:
    update = Ukf.update
    Ukf.update = lambda self, state, sample: update(self, state, sample._replace(y=jnp.full_like(sample.y, jnp.nan)))


def _always_converged() -> None:
    BlockVerdict.converged = property(lambda self: True)


def _mixed_axes() -> None:
    make = StageInverse.of.__func__
    turned = lambda cls, models, jacobian, **options: make(cls, models, np.asarray(jacobian)[[1, 0, 2]], **options)
    StageInverse.of = classmethod(turned)


def _no_feedback() -> None:
    ask = Decoupled.ask
    Decoupled.ask = lambda self, state, error: 0 * ask(self, state, error)


def _without_lead() -> None:
    substitute(lead, lambda reference, dt, omega, zeta: np.asarray(reference))


def _rigid() -> None:
    SecondOrder.step = lambda self, state, u0, u1, dt: (state, u1)
    SecondOrder.sweep = lambda self, state, u0, u, dt: (state, u)


def _creep_is_gone() -> None:
    still = lambda model: dataclasses.replace(model, gamma=0 * model.gamma)
    step, sweep = LogCreep.step, LogCreep.sweep
    LogCreep.step = lambda self, *rest: step(still(self), *rest)
    LogCreep.sweep = lambda self, *rest, **options: sweep(still(self), *rest, **options)


_noisy = _changed_filter(lambda ukf: dataclasses.replace(ukf, noise=10 * ukf.noise))
_restless = _changed_filter(lambda ukf: dataclasses.replace(ukf, walk=10 * ukf.walk))
_bold = _changed_filter(lambda ukf: dataclasses.replace(ukf, caution=0 * ukf.caution))

MUTATIONS = (
    Mutation("rho with the other sign", "tips of the loop", _other_side, identification.loops_and_creep),
    Mutation("no 630 Hz mode", "dynamics", _rigid, identification.loops_and_creep),
    Mutation("no creep in the actuator", "creep", _creep_is_gone, identification.loops_and_creep),
    Mutation("process noise times 10", "tuning of the filter", _restless, recovery),
    Mutation("measurement noise times 10", "tuning of the filter", _noisy, recovery),
    Mutation("weights of the sigma points times 2", "unscented transform", _heavy_points, recovery),
    Mutation("no extra noise at the start", "far starts", _bold, recovery),
    Mutation("parameters without bounds", "constraints", _changed_filter(_unbounded), identification.far_starts),
    Mutation("always converged", "on-line verdict", _always_converged, identification.online),
    Mutation("creep before hysteresis", "order of the stages", _creep_first, identification.in_stages),
    Mutation("a straight line for the inverse", "inverse", _line, stairs),
    Mutation("no creep term in the inverse", "inverse", _inverted_without_creep, stairs),
    Mutation("clock of the inverse 30 times too slow", "sampling interval", _slow_clock, stairs),
    Mutation("reference not led", "inverse of the resonance", _without_lead, sines),
    Mutation("x and y exchanged in the Jacobian", "kinematics", _mixed_axes, three_axes.three_axes),
    Mutation("no feedback", "closed loop", _no_feedback, three_axes.three_axes),
    Mutation("gain of the filter zero", "adaptation", _deaf, tracking.adaptive),
)
