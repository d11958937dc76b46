"""Faults that the Duhem experiment must notice (experiments/mutations.py)."""

from __future__ import annotations

import dataclasses

import cases
import estimators
import numpy as np
from common import Mutation, Results, substitute
from run import free_run, gradient, noise_free, papers_form

import hystfit as hf
from hystfit.identify import DuhemRegressor, GradientCorrection, Rls, Sample, identify
from hystfit.identify.gradient_correction import check_weights


def recovery(results: Results) -> None:
    """The shortest record of `noise_free`."""
    c = cases.case("sine", 201)
    error = c.error(identify(c.record, "rls").model) / c.span
    results.add("noise free: RLS free-run maximum / range, sine, N=201, midpoint", error)


def _flipped_rls() -> None:
    update = Rls.update

    def against(self, state, sample):
        after, info = update(self, state, sample)
        return after._replace(theta=2 * state.theta - after.theta), info

    Rls.update = against


def _frozen_covariance() -> None:
    correct = Rls.correct
    Rls.correct = lambda self, state, phi, error: correct(self, state, phi, error)._replace(root=state.root)


def _short_memory() -> None:
    correct = Rls.correct
    Rls.correct = lambda self, *rest: correct(dataclasses.replace(self, forgetting=0.97), *rest)


def _tight_prior() -> None:
    of = Rls.of
    Rls.of = classmethod(lambda cls, model, data, **settings: of(model, data, **{**settings, "prior": 1e-2}))


def _papers_sign() -> None:
    row = DuhemRegressor.row

    def misprinted(self, u0, u1, y0, y1):
        phi, target = row(self, u0, u1, y0, y1)
        return phi.at[..., self.m].multiply(-1.0), target

    DuhemRegressor.row = misprinted


def _end_of_step() -> None:
    row = DuhemRegressor.row

    def late(self, u0, u1, y0, y1):
        before, target = row(self, u0, u1, y0, y1)
        after, _ = row(self, u1, 2 * u1 - u0, y1, 2 * y1 - y0)
        return 0.5 * (before + after), target

    DuhemRegressor.row = late


def _tenfold_step() -> None:
    gain = GradientCorrection._gain
    GradientCorrection._gain = lambda self, power: 10 * gain(self, power)


def _small_step() -> None:
    gain = GradientCorrection._gain
    GradientCorrection._gain = lambda self, power: 0.1 * gain(self, power)


def _no_floor() -> None:
    GradientCorrection._gain = lambda self, power: self.mu / power


def _forgetful() -> None:
    update = GradientCorrection.update
    GradientCorrection.update = lambda self, state, sample: update(self, state._replace(theta=self.theta0), sample)


def _one_pass() -> None:
    stream = Sample.stream
    Sample.stream = staticmethod(lambda records, passes=1: stream(records, 1))


def _equal_weights() -> None:
    substitute(check_weights, lambda weights, p: np.ones(p))


def _square_root_weights() -> None:
    substitute(check_weights, lambda weights, p: np.sqrt(np.asarray(weights)))


def _one_step_error() -> None:
    substitute(
        estimators.output_error, lambda record, scheme="midpoint": identify(record, "rls", hf.Duhem(scheme=scheme))
    )


def _thin_loop() -> None:
    single_valued = cases.ALPHA * np.array([0.0, cases.G[0], cases.G[1] / 2, cases.G[2] / 3])  # f' = g
    cases.ALPHA_F[:] = 0.9 * single_valued + 0.1 * cases.ALPHA_F


def _more_noise() -> None:
    case = cases.case
    substitute(case, lambda wave, count=2001, noise=0.0, *rest, **more: case(wave, count, 5 * noise, *rest, **more))


MUTATIONS = (
    Mutation("RLS steps against the error", "recovery of the parameters", _flipped_rls, recovery),
    Mutation("RLS never updates its covariance", "the directions already known", _frozen_covariance, noise_free),
    Mutation("RLS starts with a covariance of 0.01", "an uninformative start", _tight_prior, noise_free),
    Mutation("RLS forgets by 0.97 a sample", "the average over the record", _short_memory, free_run),
    Mutation("the paper's sign of the regressor of alpha", "decay towards f", _papers_sign, noise_free),
    Mutation("regressors at the end of the step", "the discretization of the simulation", _end_of_step, noise_free),
    Mutation("step of gradient correction times 10", "the bound of the step", _tenfold_step, gradient),
    Mutation("step of gradient correction over 10", "the speed of convergence", _small_step, gradient),
    Mutation("no floor under the step", "small steps at reversals", _no_floor, gradient),
    Mutation("gradient correction starts anew at every sample", "learning", _forgetful, gradient),
    Mutation("one pass where many are asked for", "convergence over passes", _one_pass, gradient),
    Mutation("weights all one", "the scale of each parameter, in the paper's form", _equal_weights, papers_form),
    Mutation(
        "square roots of the weights",
        "the scale of each parameter, in the paper's form",
        _square_root_weights,
        papers_form,
    ),
    Mutation("output error replaced by one-step error", "an estimate without bias by noise", _one_step_error, free_run),
    Mutation("the device's loop is ten times thinner", "the hysteresis of the surrogate", _thin_loop, free_run),
    Mutation("noise times 5", "the noise of the surrogate", _more_noise, free_run),
)
