"""Faults that the experiment of structural loops must notice (experiments/mutations.py)."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import laws
import numpy as np
import run
from common import Mutation, substitute

import hystfit as hf
from hystfit.models.rate_plays import RatePlayStep
from hystfit.models.steel02 import strain_noise
from hystfit.models.varying import Varying


def _changed(kind: type, **fields: Any) -> Any:
    """Puts other values of fields in place wherever a model of this kind is simulated."""

    def apply() -> None:
        other = lambda model: dataclasses.replace(model, **{k: v(model) for k, v in fields.items()})
        for name in ("step", "design_matrix"):
            if name in vars(kind):
                original = getattr(kind, name)
                setattr(kind, name, lambda self, *rest, original=original: original(other(self), *rest))

    return apply


def _rough_derivatives() -> None:
    step = hf.Steel02.step
    forgets = lambda self, state, *rest: step(self, jax.lax.stop_gradient(state), *rest)
    hf.Steel02.step = forgets


def _no_deadband() -> None:
    substitute(strain_noise, lambda records: 0.0)


def _far_starts() -> None:
    hf.Steel02.start = lambda self, records: dataclasses.replace(self, fy=40.0, E=3e5, b=0.2, cR1=0.4, cR2=2.0)


def _quiet() -> None:
    """A record with half of its noise."""
    original = run.coupon

    def quieter(*given: Any) -> Any:
        record, truth = original(*given)
        clean = np.asarray(hf.simulate(hf.Steel02(**truth), record.u)[0])
        return record.replace(y=clean + 0.5 * (record.y - clean)), truth

    run.coupon = quieter


def _plain_stops() -> None:
    """Stops of the input itself: its peak is that of the record from the start."""
    kind = hf.SelfSimilarStops
    design = kind.design_matrix
    kind.design_matrix = lambda self, u, dt=None: design(
        dataclasses.replace(self, floor=float(np.max(np.abs(self.peaks)))), u, dt
    )


def _no_flow() -> None:
    """No force of the velocity."""
    design = hf.Damper.design_matrix

    def still(self: Any, u: Any, dt: Any = None) -> Any:
        made = design(self, u, dt)
        held = {leaf for leaf in ("viscous", "bent", "saturating")}
        names = [field.name for field in dataclasses.fields(self)]
        blocks = tuple(
            dataclasses.replace(b, columns=np.asarray(b.columns) * (names[b.leaf] not in held)) for b in made.blocks
        )
        return dataclasses.replace(made, blocks=blocks)

    hf.Damper.design_matrix = still


def _inverse_at_rest() -> None:
    rate = hf.RateDependentPlays.rate
    solve = RatePlayStep.solve

    def slow(self: Any, state: Any, *rest: Any) -> Any:
        hf.RateDependentPlays.rate = lambda model, state, dt: (0.0 * state[-2], state[-1])
        root = solve(self, state, *rest)
        hf.RateDependentPlays.rate = rate
        return root

    RatePlayStep.solve = slow


def _one_relaxation() -> None:
    start = hf.Viscoelastic.start
    hf.Viscoelastic.start = lambda self, records: start(hf.Viscoelastic.of(2), records)


def _held(model: str, **values: float) -> Any:
    """Puts fits of a model in place that hold parameters."""

    def apply() -> None:
        original = hf.fit

        def held(name: Any, *rest: Any, **options: Any) -> Any:
            fix = {**options.pop("fix", {}), **(values if name == model else {})}
            return original(name, *rest, fix=fix, **options)

        hf.fit = held

    return apply


def _same_for_all() -> None:
    Varying.of_record = lambda self, record: self


no_yield_plateau = _changed(hf.VoceChaboche, Q=lambda m: 0 * m.Q, D=lambda m: 0 * m.D)

MUTATIONS = (
    Mutation(
        "no shift of the asymptotes",
        "a1, a3",
        _changed(hf.Steel02, a1=lambda m: 0 * m.a1 + 1e-4, a3=lambda m: 0 * m.a3 + 1e-4),
        run.coupons,
    ),
    Mutation("constant sharpness", "cR1, cR2", _changed(hf.Steel02, cR1=lambda m: 0.3 + 0 * m.cR1), run.coupons),
    Mutation("slope after yielding 2 % larger", "b", _changed(hf.Steel02, b=lambda m: 1.02 * m.b), run.coupons),
    Mutation("modulus 1 % larger", "fy, E", _changed(hf.Steel02, E=lambda m: 1.01 * m.E), run.coupons),
    Mutation("half of the noise", "the noise of the coupons", _quiet, run.coupons),
    Mutation("starts far away", "starting values", _far_starts, run.coupons),
    Mutation("derivatives forget the history", "derivatives", _rough_derivatives, run.coupons),
    Mutation("every reversal of the strain counts", "noise of the strain", _no_deadband, run.coupons),
    Mutation("no isotropic hardening", "cyclic hardening", no_yield_plateau, run.steel),
    Mutation("stops that do not scale with the peak", "peak-oriented stiffness loss and slip", _plain_stops, run.walls),
    Mutation("stops that do not scale with the peak, fastener", "the same", _plain_stops, run.fastener),
    Mutation("no force of the velocity", "viscous and yield forces", _no_flow, run.dampers),
    Mutation(
        "stops without force at the start",
        "movement before the record",
        _changed(hf.Damper, strain=lambda m: 0 * m.strain),
        run.dampers,
    ),
    Mutation("no pinching", "slip", _held("bouc-wen-baber-noori", zs=0.1), laws.damage),
    Mutation("two relaxation times", "relaxation between the rates", _one_relaxation, laws.viscoelasticity),
    Mutation(
        "another power of time", "order of the relaxation", _held("linear+springpot", order=0.3), laws.viscoelasticity
    ),
    Mutation("the inverse of static plays", "thresholds that grow with the rate", _inverse_at_rest, laws.rate),
    Mutation(
        "thresholds grow half as much",
        "kappa",
        _changed(hf.RateDependentPlays, kappa=lambda m: 0.5 * m.kappa),
        laws.rate,
    ),
    Mutation("no static friction", "the Stribeck effect", _held("lugre", dFs=1e-6), laws.friction),
    Mutation(
        "limits that do not depend on the velocity",
        "the Stribeck effect",
        _changed(hf.MaxwellSlip, excess=lambda m: 0 * m.excess),
        laws.friction,
    ),
    Mutation("one temperature for all records", "covariates", _same_for_all, laws.temperature),
)
