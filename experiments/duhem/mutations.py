"""Faults that the Duhem experiment must notice (experiments/mutations.py)."""

from __future__ import annotations

from common import Mutation
from run import gradient, noise_free

from hystfit.identify import GradientCorrection, Rls


def _flipped_rls() -> None:
    update = Rls.update

    def against(self, state, sample):
        after, info = update(self, state, sample)
        return after._replace(theta=2 * state.theta - after.theta), info

    Rls.update = against


def _tenfold_step() -> None:
    gain = GradientCorrection._gain
    GradientCorrection._gain = lambda self, power: 10 * gain(self, power)


MUTATIONS = (
    Mutation("RLS steps the other way", "recovery", _flipped_rls, noise_free),
    Mutation("step of gradient correction times 10", "convergence", _tenfold_step, gradient),
)
