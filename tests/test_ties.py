"""Ties between parameters: their grammar, and estimates, errors, samplers, profiles and saved fits that keep them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

import hystfit as hf
import hystfit.models
from hystfit.errors import ParameterError
from hystfit.params import ParameterSpace
from hystfit.params.ties import parse_tie


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2*k1", (2.0, "k1", 0.0)),
        ("gamma[0]", (1.0, "gamma[0]", 0.0)),
        ("-w[1, 2] / 4 + 1e-3", (-0.25, "w[1, 2]", 1e-3)),
        ("3 - 2 * (parts.tau - 1)", (-2.0, "parts.tau", 5.0)),
    ],
)
def test_an_expression_is_a_multiple_plus_a_number(text, expected):
    assert parse_tie(text) == pytest.approx(expected)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "2",
        "0*a",
        "a*b",
        "a+a*b",
        "a**2",
        "1/a",
        "f(a)",
        "a if a else b",
        "__import__('os')",
        "a/0",
        "'a'",
        "a;b",
        "1e999*a",
    ],
)
def test_anything_else_is_refused(text):
    with pytest.raises(ParameterError, match="multiple of one parameter"):
        parse_tie(text)


def test_the_tree_keeps_the_tie_and_bounds_reach_the_source():
    space = ParameterSpace.of(hf.BoucWen(mu=0.4, tau=0.1), tie={"mu": "2*tau + 0.1"})
    assert "mu" not in space.names
    at = space.names.index("tau")
    assert (space.lower[at], space.upper[at]) == pytest.approx((0.0, 0.45))  # mu lies between 0 and 1
    x = space.vector(space.template)
    assert float(space.template.mu) == pytest.approx(2 * 0.1 + 0.1)
    x[at] = 0.3
    traced = eqx.filter_jit(space.coordinates.assemble)(jnp.asarray(x))
    assert float(space.assembled(x).mu) == pytest.approx(0.7)
    assert float(traced.mu) == pytest.approx(0.7)
    [(tie, value, _, follows)] = space.tied(x)
    assert (tie.name, value, follows) == ("mu", pytest.approx(0.7), at)


def test_trees_of_many_rows_are_those_of_each():
    """With ties, an array of which some elements are free, and constants."""
    ties = {"mu": "2*tau + 0.1", "c": "3*tau"}
    for space in (
        ParameterSpace.of(hf.BoucWen(mu=0.4, tau=0.1), tie=ties),
        ParameterSpace.of(hf.PrandtlIshlinskii.of(3), fix=["w[0,1]"]),
    ):
        x = np.random.default_rng(0).uniform(0.1, 0.4, (4, len(space)))
        for row, tree in zip(x, space.coordinates.assemble_rows(x), strict=True):
            alone = space.coordinates.assemble(row, 0, np.asarray)
            assert jax.tree_util.tree_structure(tree) == jax.tree_util.tree_structure(alone)
            for found, leaf in zip(*map(jax.tree_util.tree_leaves, (tree, alone)), strict=True):
                np.testing.assert_array_equal(found, leaf)


def test_arrays_are_tied_element_by_element_or_to_one_element():
    model = hystfit.models.PrandtlIshlinskii(r=jnp.asarray([0.1, 0.2, 0.3]), w=jnp.asarray([[1.0, 2.0, 3.0]]))
    space = ParameterSpace.of(model, tie={"w[0,2]": "3*w[0,0]"})
    x = space.vector(model)
    np.testing.assert_allclose(space.assembled(x).w, [[1.0, 2.0, 3.0]])
    assert not space.linear[space.names.index("w[0,0]")]  # the output is not that of its own play alone


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tie": {"mu": "2*nothing"}}, "no parameter 'nothing'"),
        ({"tie": {"mu": "mu"}}, "refers to itself"),
        ({"tie": {"mu": "0.5"}}, "multiple of one parameter"),
        ({"tie": {"mu": "tau", "tau": "c"}}, "tied; tie both to the same one"),
        ({"tie": {"mu": "tau"}, "fix": {"mu": 0.1}}, "fixed or free at once"),
        ({"tie": {"mu": "tau + 3"}}, "no value within the bounds of both"),
        ({"tie": {"offset": "c"}}, "a value for each record"),
        ({"fix": {"mu": "tau"}}, "tie={'mu': 'tau'}"),
    ],
)
def test_ties_that_cannot_hold_are_named(options, words):
    with pytest.raises(ParameterError) as caught:
        ParameterSpace.of(hf.BoucWen(), **options)
    assert words in str(caught.value)


@pytest.fixture(scope="module")
def record() -> hf.Record:
    rng, phase = np.random.default_rng(1), np.linspace(0, 1, 300)
    u = np.sin(2 * np.pi * 5 * phase) * (0.4 + 0.6 * phase)
    y = np.asarray(hf.simulate(hf.BoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.5), u)[0])
    return hf.Record(u=u, y=y + 0.01 * rng.normal(size=u.size))


@pytest.fixture(scope="module")
def fitted(record) -> hf.FitResult:
    return hf.fit("bouc-wen", record, starts=1, noise="iid", tie={"mu": "tau/4"}, fix={"rho": 0.5})


def test_estimate_errors_and_saved_fit_keep_the_tie(fitted, record, tmp_path):
    tau, mu = fitted["tau"], fitted["mu"]
    assert abs(tau.value - 2.0) < 4 * tau.stderr
    assert mu.value == pytest.approx(tau.value / 4)
    assert mu.stderr == pytest.approx(tau.stderr / 4)
    assert (mu.fixed, mu.tie) == (False, "tau/4")
    assert "= tau/4" in str(fitted)
    # The same curve with the tie put in by hand: central differences of its simulation.
    x, names = fitted.x, fitted.free_names

    def output(x: np.ndarray) -> np.ndarray:
        values = dict(zip(names, x, strict=True))
        return np.asarray(hf.simulate(hf.BoucWen(**values, mu=values["tau"] / 4, rho=0.5), record.u)[0])

    steps = 1e-6 * np.eye(x.size)
    J = np.stack([(output(x + e) - output(x - e)) / 2e-6 for e in steps], axis=1)
    r = output(x) - record.y
    covariance = np.linalg.inv(J.T @ J) * (r @ r) / (r.size - x.size)
    np.testing.assert_allclose(fitted.covariance, covariance, rtol=1e-3, atol=1e-12)
    fitted.save(tmp_path / "fit")
    again = hf.load_fit(tmp_path / "fit")
    assert again["mu"] == mu
    assert again.problem.space.expressions == {"mu": "tau/4"}
    np.testing.assert_array_equal(again.predict(record), fitted.predict(record))


def test_profiles_and_draws_keep_the_tie(fitted):
    drawn = hf.sample(fitted, "emcee", noise="iid", walkers=16, draws=600)
    assert "mu" not in drawn.names
    for model in drawn.models(5):
        assert float(model.mu) == pytest.approx(float(model.tau) / 4)
    assert drawn["tau"].std() == pytest.approx(fitted["tau"].stderr, rel=0.3)


def test_tied_weights_are_those_of_linear_least_squares_with_their_sum_as_one_column(record):
    r = jnp.asarray([0.1, 0.2, 0.4])
    model = hystfit.models.PrandtlIshlinskii(r=r, w=jnp.asarray([[0.2, 0.3, 0.4]]))
    fit = hf.fit(model, record, starts=1, tie={"w[0,2]": "2*w[0,0]"})
    play = lambda *w: np.asarray(hf.simulate(fit.model.replace(w=jnp.asarray([w]), offset=0.0), record.u)[0])
    columns = np.stack([play(1.0, 0.0, 2.0), play(0.0, 1.0, 0.0), np.ones(record.u.size)], axis=1)
    expected = scipy.optimize.lsq_linear(columns, record.y, bounds=([0, 0, -np.inf], np.inf))
    np.testing.assert_allclose(fit.x, expected.x, rtol=1e-3, atol=1e-3)
    with pytest.raises(ParameterError, match="method='lm'"):
        hf.fit(model, record, method="convex", tie={"w[0,2]": "2*w[0,0]"})


def test_options_of_the_shell():
    from hystfit.cli.options import named_values, tied_values

    assert tied_values(["k2 = 2*k1", "gamma[1]=gamma[0]"]) == {"k2": "2*k1", "gamma[1]": "gamma[0]"}
    with pytest.raises(ParameterError, match="NAME=EXPRESSION"):
        tied_values(["k2"])
    with pytest.raises(ParameterError, match="--tie 'mu=tau'"):
        named_values(["mu=tau"])
