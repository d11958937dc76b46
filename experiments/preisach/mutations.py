"""Faults that the Preisach experiment must notice (experiments/mutations.py)."""

from __future__ import annotations

import equinox as eqx
import identification
import jax.numpy as jnp
import numpy as np
import plant
import run
import tracking
from common import Mutation, Results, substitute
from plant import Thunder

import hystfit as hf
from hystfit.models.preisach import everett
from hystfit.models.preisach.plane import AbstractPlane
from hystfit.models.preisach.stack_inverse import PreisachStep


def curves(results: Results) -> None:
    """S1, S6 and S7."""
    _, cells, tabulated = run.reversal_curves(results)
    run.prediction(results, {"cells": cells, "table": tabulated})


def properties(results: Results) -> None:
    """S2 to S5."""
    run.lag(results, identification.static_model(identification.reversal_record(plant.actuator(), 0.01, 2.0, seed=1)))
    run.wiping_out(results)
    run.minor_loops(results)


def tracked(results: Results) -> None:
    """The loop's design, and S8 to S10 on the unchanged plant."""
    record = identification.reversal_record(plant.actuator(), 0.01, 2.0, seed=1)
    models = {"": identification.static_model(record), "table ": identification.table_model(record)}
    made, secant = run.loop(results, models[""])
    names = ("FF", "FB", "line+FB", "FF+FB", "table FF+FB")
    runs = tracking.arms(run.MAJOR, models, secant, made, {}, names)
    run.report(results, "S8-10 major, plant unchanged", runs, 0.0)
    quiet = tracking.arms(run.MAJOR, models, secant, made, {}, ("line+FB", "FF+FB"), noise=0.0)
    run.report(results, "S8-10 major, plant unchanged, no sensor noise", quiet, 0.0)


def fast(results: Results) -> None:
    """S15."""
    record = identification.reversal_record(plant.actuator(), 0.01, 2.0, seed=1)
    run.frequency(results, record, identification.static_model(record))


def _line() -> None:
    def straight(model, extrema, frequency):
        u = tracking.reference(extrema, frequency) * float(hf.invert(model, np.linspace(0, 100, 50)).u[-1]) / 100
        return u, np.ones(u.size, dtype=bool)

    substitute(tracking.feedforward, straight)


def _nearest() -> None:
    place = everett.place

    def rounded(levels, u):
        at = place(levels, u)
        return everett.Place(at.cell, jnp.round(at.part))

    substitute(place, rounded)


def _no_triangles() -> None:
    of = hf.TabulatedPreisach.from_table.__func__
    hf.TabulatedPreisach.from_table = classmethod(
        lambda cls, table: (made := of(cls, table)).replace(**{f"slopes[{k}]": 0.0 for k in range(made.slopes.size)})
    )


def _over_smooth() -> None:
    identification.SMOOTHNESS = 1.0


def _no_history() -> None:
    AbstractPlane.remember = lambda self, extrema, u: jnp.full(extrema.shape, u)


def _inverse_without_history() -> None:
    advance = PreisachStep.advance

    def forgetful(self, state, u0, u1, dt):
        after, y = advance(self, state, u0, u1, dt)
        return jnp.full(after.shape, u1), y

    PreisachStep.advance = forgetful


def _no_loop() -> None:
    Thunder._everett = lambda self, a, b: (self.k1 + 180 * self.rho) * (a - b)


def _congruent() -> None:
    step = Thunder.step

    def linear(self, state, u0, u1, dt):
        return step(eqx.tree_at(lambda m: m.bend, self, jnp.zeros(())), state, u0, u1, dt)

    Thunder.step = linear


def _late_wiping() -> None:
    def remembers(self, state, u0, u1, dt):
        before = jnp.concatenate([jnp.zeros(1), state[:-1]])
        inside = (jnp.minimum(before, state) < u1) & (0.8 * u1 < jnp.maximum(before, state))
        kept = jnp.minimum(jnp.sum(inside.at[0].set(0.8 * u1 < state[0])), state.shape[0] - 1)
        state = jnp.where(jnp.arange(state.shape[0]) < kept, state, u1)
        before = jnp.concatenate([jnp.zeros(1), state[:-1]])
        sign = jnp.where(state >= before, 1.0, -1.0)
        h = jnp.sum(sign * self._everett(jnp.maximum(state, before), jnp.minimum(state, before)))
        return state, self.gain * (h + self.bend * h * (1 - h / 120))

    Thunder.step = remembers


def _no_relaxation() -> None:
    actuator = plant.actuator
    substitute(actuator, lambda **options: actuator(**{**options, "relaxation": None}))


def _no_feedback() -> None:
    track = tracking.track
    substitute(track, lambda extrema, ahead, made, **options: track(extrema, ahead, None, **options))


def _tenfold_feedback() -> None:
    design = tracking.design
    substitute(design, lambda **options: design(**{**options, "gain": 0.1 * options["gain"]}))


def _no_relaxation_in_the_inverse() -> None:
    made = run.with_relaxation
    substitute(made, lambda records: made(records).parts[0])


def _more_noise() -> None:
    track = tracking.track
    substitute(track, lambda *args, noise, **options: track(*args, noise=5 * noise, **options))


MUTATIONS = (
    Mutation("inverse replaced by the straight line r / secant", "the hysteresis in the feed-forward", _line, tracked),
    Mutation("inverse without the stack of extrema", "the history of the voltage", _inverse_without_history, tracked),
    Mutation("history not carried by the model", "all extrema but the last", _no_history, curves),
    Mutation("interpolation replaced by the nearest node", "equations (4) and (5)", _nearest, curves),
    Mutation("triangles on the diagonal left out", "equation (5)", _no_triangles, curves),
    Mutation("cells smoothed a million times more", "the shape of the density", _over_smooth, curves),
    Mutation("hysteresis deleted in the device", "the loops of the surrogate", _no_loop, properties),
    Mutation("hysteresis deleted in the device, tracking", "the use of an inverse", _no_loop, tracked),
    Mutation("the device is congruent", "the nonlinearity behind the relays", _congruent, properties),
    Mutation("extrema are wiped out 25 % too late", "wiping-out in the device", _late_wiping, properties),
    Mutation("relaxation deleted in the device", "lag and slow memory", _no_relaxation, properties),
    Mutation("relaxation deleted in the inverse", "fast references", _no_relaxation_in_the_inverse, fast),
    Mutation("feedback gain zero", "the feedback", _no_feedback, tracked),
    Mutation("feedback gain times 10", "damping and phase margin", _tenfold_feedback, tracked),
    Mutation("sensor noise times 5", "the noise of the surrogate", _more_noise, tracked),
)
