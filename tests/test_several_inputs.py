"""Design matrices of a Preisach model for several inputs in one pass, against those of one input after another."""

import dataclasses

import numpy as np
import pytest

import hystfit as hf
from hystfit.inference.problem import Problem
from hystfit.inference.weights import Split
from hystfit.models import Preisach
from hystfit.models.preisach import design_matrix


@pytest.mark.parametrize("together", [2**14, 100])
@pytest.mark.parametrize(
    "settings",
    [
        {},
        pytest.param({"initial": "negative"}, marks=pytest.mark.slow),
        {"initial": "positive", "degree": 2, "reversible": False},
        pytest.param({"symmetric": True}, marks=pytest.mark.slow),
        {"elements": "relays"},
    ],
)
def test_the_columns_are_those_of_each_input_alone(monkeypatch, settings, together):
    """Of any lengths, with repeats and single samples; also in parts of few samples."""
    monkeypatch.setattr(design_matrix, "_TOGETHER", together)
    rng = np.random.default_rng(3)
    inputs = [np.cumsum(rng.normal(size=size)) for size in (5, 60, 1, 64, 40)]
    inputs.append(np.repeat([0.5, -1.0, 2.0], 3))
    every = np.concatenate(inputs)
    model = Preisach.of(10, **settings).start([hf.Record(every, every)])
    weights = rng.uniform(size=model.w.size)
    model = dataclasses.replace(model, w=weights)
    for several, u in zip(model.design_matrices(inputs), inputs, strict=True):
        alone = model.design_matrix(u)
        np.testing.assert_array_equal(several.index, alone.index)
        for mine, own in zip(several.blocks, alone.blocks, strict=True):
            np.testing.assert_allclose(np.asarray(mine.columns), np.asarray(own.columns), atol=1e-12)
        if u.size in (64, 9):  # a simulation of each length is compiled anew
            np.testing.assert_allclose(several.output(model), np.asarray(hf.simulate(model, u)[0]), atol=1e-9)


def test_the_equations_of_reversal_curves_are_those_of_one_curve_after_another(monkeypatch):
    model, curves = hf.ParametricPreisach(), []
    for number, low in enumerate(np.linspace(0.6, -0.9, 6)):
        down, up = np.linspace(1.0, low, 40), np.linspace(low, 1.0, 40)
        M = np.asarray(model.free_run(np.concatenate([np.linspace(-1, 1, 30), down, up])))[-40:]
        curves.append(hf.Record(u=up, y=M, name=f"curve-{number + 1}"))
    data = hf.Dataset.of(curves)
    started = Preisach.of(8, spacing="reversal-curves").start(curves)
    problem = Problem(started, data)
    split = lambda: Split.of(problem.space, list(data), problem.space.vector(started), held=problem.held_out)
    together = split().system.grams
    one_by_one = lambda model, inputs: (design for u in inputs for design in several(model, [u]))
    several = design_matrix.states_of_several
    monkeypatch.setattr("hystfit.models.preisach.model.states_of_several", one_by_one)
    np.testing.assert_allclose(together, split().system.grams, rtol=1e-12, atol=1e-12 * np.abs(together).max())
