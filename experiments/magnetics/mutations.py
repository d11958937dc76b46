"""Faults that the experiment on magnetic loops must notice (experiments/mutations.py)."""

from __future__ import annotations

import jax.numpy as jnp
from common import Mutation
from run import data_sheet, fields, instruments, numerics, vectors

from hystfit.identify import field_from_induction, vector_hysteresis
from hystfit.models.jiles_atherton import JilesAtherton
from hystfit.models.jiles_atherton_field import JilesAthertonField
from hystfit.results.measured import instrument_values, magnetic_loop, saturation_law


def _no_demagnetization() -> None:
    magnetic_loop.MagneticLoop._demagnetized = lambda self, sample: self


def _straight_approach() -> None:
    saturation_law._LAWS[saturation_law._LAW] = (lambda h: h,)


def _other_remanence() -> None:
    instrument_values._SIGNED[("remanence", "-")] = "falling"


def _no_slope() -> None:
    instrument_values.SLOPE = "none"


def _no_mean_field_in_the_step() -> None:
    JilesAthertonField.step = lambda self, state, u0, u1, dt: (
        (new := self._moved(state, u0, u1)),
        self.offset + new[0] - self.magnet.mean_field * self.magnet.anhysteretic(new[0] / self.a),
    )


def _pinning_at_the_start() -> None:
    JilesAtherton._pinning_between = lambda self, state, s, field, g0, g1: self.pinning(self.total(state))


def _no_adaptation() -> None:
    model = field_from_induction.FieldFromInduction
    predict = model.predict
    model.predict = lambda self, one, *, adapt=True: predict(self, one, adapt=False)


def _no_rates() -> None:
    model = field_from_induction.FieldFromInduction
    columns = model.columns
    rates = [12, 13, 26, 27]

    def without(self, one, stops):
        found = columns(self, one, stops)
        found[:, rates] = 0.0
        return found

    model.columns = without


def _equal_weights() -> None:
    of = vector_hysteresis._parameters
    vector_hysteresis._parameters = lambda z, cells: (*of(z, cells)[:3], jnp.full(cells, 1.0 / cells))


def _energy_at_the_field_before() -> None:
    run = vector_hysteresis._run

    def against(js, a, kappa, w, h):
        flux, _ = run(js, a, kappa, w, h)
        return flux, jnp.sum(jnp.diff(flux, axis=0, prepend=0.0) * jnp.roll(h, 1, axis=0), axis=1)

    vector_hysteresis._run = against


MUTATIONS = (
    Mutation("no demagnetization", "the field inside the sample", _no_demagnetization, data_sheet),
    Mutation("saturation by a straight line", "the law of approach", _straight_approach, data_sheet),
    Mutation("Pr- read on the other branch", "the convention of the tester", _other_remanence, instruments),
    Mutation(
        "the slope correction of the file is ignored", "the convention of the magnetometer", _no_slope, instruments
    ),
    Mutation(
        "anhysteretic mean field where B drives", "the way back from B to H", _no_mean_field_in_the_step, numerics
    ),
    Mutation("pinning at the beginning of the step", "the order of the step", _pinning_at_the_start, numerics),
    Mutation("no adaptation", "the known past of a sequence", _no_adaptation, fields),
    Mutation("no rates of B", "eddy currents", _no_rates, fields),
    Mutation("vector cells of equal weight", "the weights of the cells", _equal_weights, vectors),
    Mutation(
        "energy with the field before the step", "the dissipation of vector cells", _energy_at_the_field_before, vectors
    ),
)
