"""Compositions with Preisach: their design matrices, smooth solve and inverses against the plain scan."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hystfit as hf
from hystfit.control import invert
from hystfit.models.registry import make_model

T = np.linspace(0.0, 3.0, 400)
U = 40 * np.sin(2 * np.pi * T) * np.exp(-0.3 * T) + 5 * np.sin(7 * T)
DT = np.diff(T, prepend=T[0])
NAMES = {
    "lag+preisach": {"tau": 0.02},
    "preisach+creep": {"a": 0.8},
    "second-order+preisach": {"omega": 60.0, "zeta": 0.2},
}


def truth(name: str) -> hf.models.AbstractHysteresis:
    """A composition with a bell of cells on fixed levels, and parameters away from their starting values."""
    settings = name.replace("preisach", "preisach:n=6:spacing=given")
    model = make_model(settings).start([hf.Record(U, U, t=T)])
    i, j = np.tril_indices(6)
    masses = np.exp(-(((i - j) / 3) ** 2) - ((i + j - 5) / 4) ** 2)
    is_cells = lambda node: isinstance(node, hf.Preisach)
    parts = [
        hf.Preisach(w=masses, levels=np.linspace(-40, 46, 7), slopes=np.full(6, 0.4), spacing="given")
        if is_cells(part)
        else eqx.tree_at(
            lambda m: [getattr(m, k) for k in NAMES[name]],
            part,
            [jnp.full(jnp.shape(getattr(part, k)), v) for k, v in NAMES[name].items()],
        )
        for part in model.parts
    ]
    return type(model)(*parts)


@pytest.mark.parametrize("name", [*NAMES, pytest.param("preisach+log-creep", marks=pytest.mark.slow)])
def test_the_design_matrix_times_the_weights_is_the_scan(name: str) -> None:
    NAMES.setdefault("preisach+log-creep", {"gamma": 0.03})
    model = truth(name)
    design = model.design_matrix(U, DT)
    leaves = jax.tree_util.tree_leaves(model)
    y = design.rest[design.index] + sum(b.columns[design.index] @ np.ravel(leaves[b.leaf]) for b in design.blocks)
    expected = np.asarray(hf.simulate(model, U, DT)[0])
    np.testing.assert_allclose(y, expected, atol=1e-11 * np.ptp(expected))
    np.testing.assert_allclose(model.free_run(U, DT), expected, atol=1e-11 * np.ptp(expected))
    assert sum(b.columns.shape[1] for b in design.blocks) >= 21 + 6 + 1


@pytest.mark.parametrize(
    "name", [name if name == "preisach+creep" else pytest.param(name, marks=pytest.mark.slow) for name in NAMES]
)
def test_the_smooth_solve_fits_a_composition(name: str) -> None:
    model = truth(name)
    y = np.asarray(hf.simulate(model, U, DT)[0])
    y = y + 0.002 * np.ptp(y) * np.random.default_rng(1).normal(size=y.size)
    flat = jax.tree_util.tree_map(lambda leaf: leaf, model)
    flat = type(flat)(
        *(
            eqx.tree_at(lambda m: m.w, p, jnp.full(21, 0.1)) if p.estimator else p.start([hf.Record(U, y, t=T)])
            for p in flat.parts
        )
    )
    record = hf.Record(U, y, t=T)
    result = hf.fit(flat, record, start="model")
    assert result.method == "preisach"
    assert result.usable
    assert result.train.nrmse_percent < 0.25
    np.testing.assert_allclose(result.predict(record), hf.simulate(result.model, U, DT)[0], atol=1e-10 * np.ptp(y))
    found = {p.name.partition("[")[0]: p for p in result.parameters if not p.fixed}
    for parameter, value in NAMES[name].items():
        assert found[parameter].stderr is not None
        assert found[parameter].stderr < 0.2 * value
        # The penalty biases what resembles the cells' response: the weight of the creep.
        assert found[parameter].value == pytest.approx(value, rel=0.25 if parameter == "a" else 0.05)
    # Derivatives of all free parameters against those of the plain scan.
    problem, x = result.problem, result.x
    expected = np.asarray(jax.jacfwd(problem.objective.predict)(jnp.asarray(x))).reshape(-1, x.size)
    jacobian = problem.linearize(x)[1].reshape(-1, x.size)
    np.testing.assert_allclose(jacobian[: U.size], expected[: U.size], atol=1e-6 * np.abs(expected).max())


def test_a_name_alone_fits_by_the_smooth_solve() -> None:
    y = np.asarray(hf.simulate(truth("lag+preisach"), U, DT)[0])
    result = hf.fit("lag+preisach:n=6", hf.Record(U, y, t=T))
    assert result.method == "preisach"
    assert result.train.nrmse_percent < 2  # six cells along an axis, on other levels than the truth's


def test_many_other_free_parameters_are_refused() -> None:
    model = truth("lag+preisach")
    with pytest.raises(hf.HystfitError, match="at most"):
        hf.fit(model, hf.Record(U, U, t=T), start="model", free=["levels"])


@pytest.mark.parametrize("name", ["lag+preisach", pytest.param("preisach+creep", marks=pytest.mark.slow)])
def test_the_inverse_of_a_composition_follows_the_reference(name: str) -> None:
    model = truth(name)
    y = np.asarray(hf.simulate(model, U, DT)[0])
    inverse = invert(model, y, DT)
    again, _ = hf.simulate(model, inverse.u, DT, resume=inverse.start)
    met = inverse.codes == 0
    assert met.mean() > 0.9  # the lag needs inputs beyond the levels at some turns
    assert np.abs(np.asarray(again) - y)[met].max() < 1e-6 * np.ptp(y)


@pytest.mark.slow
def test_a_resonance_after_preisach_is_led() -> None:
    model = truth("second-order+preisach")
    t = np.arange(2000) * 5e-4
    wanted = 8 * np.sin(2 * np.pi * t) ** 3
    inverse = invert(model, wanted, 5e-4)
    y, _ = hf.simulate(model, inverse.u, 5e-4)
    assert np.abs(np.asarray(y) - wanted)[100:-10].max() < 0.01 * np.ptp(wanted)
