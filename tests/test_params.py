"""Parameters by name, their maps between physical and unconstrained values, and what the maps do to densities and errors."""

import dataclasses
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jaxtyping import Array, Float

from hystfit.errors import ParameterError
from hystfit.models import BoucWen, Duhem, LogCreep, Offset, Series, Sum, Viscous, simulate
from hystfit.params.param import leaves_of, param, short_names
from hystfit.params.space import ParameterSpace
from hystfit.params.units import Scales, conversion, exponents, parse_unit, quantity

FEW = settings(max_examples=40, deadline=None, derandomize=True)


class Every(eqx.Module):
    """One parameter for each kind of bounds."""

    real: Float[Array, ""] = param(0.5, unit="y", scale=3.0)
    low: Float[Array, ""] = param(2.0, bounds=(-1.0, math.inf), unit="u/s")
    high: Float[Array, ""] = param(-3.0, bounds=(-math.inf, 4.0))
    both: Float[Array, ""] = param(0.25, bounds=(-2.0, 6.0))
    w: Float[Array, "2 3"] = param(((1.0, 2.0, 3.0), (4.0, 5.0, 6.0)), bounds=(0.0, math.inf), unit="y")
    held: Float[Array, ""] = param(9.0, fixed=True)
    label: str = eqx.field(static=True, default="no parameter")


class Noise(eqx.Module):
    sigma: Float[Array, ""] = param(0.1, bounds=(0.0, math.inf), unit="y")
    c: Float[Array, ""] = param(7.0)


class Pair(NamedTuple):
    model: Any
    noise: Any


# -- names ---------------------------------------------------------------------------------------------------------------


def test_names_follow_the_fields_and_the_elements() -> None:
    space = ParameterSpace.of(Every())
    elements = [f"w[{i},{j}]" for i in range(2) for j in range(3)]
    assert list(space.names) == ["real", "low", "high", "both", *elements]
    assert space.vector(Every()).tolist() == [0.5, 2.0, -3.0, 0.25, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert space.fixed() == [("held", 9.0, space.leaves[-1].info)]


def test_names_are_as_short_as_they_can_be_and_no_shorter() -> None:
    assert short_names([("a", "c"), ("b", "c"), ("b", "d")]) == ["a.c", "b.c", "d"]
    assert short_names([("c",), ("sub", "c")]) == ["c", "sub.c"]


def test_nested_models_are_named_after_their_class() -> None:
    space = ParameterSpace.of(Sum(Series(BoucWen(), LogCreep()), Viscous(c=0.5)))
    assert {"bouc_wen.c", "viscous.c", "mu", "gamma[0]"} <= set(space.names)
    twice = ParameterSpace.of(Sum(Offset(value=1.0), Offset(value=2.0)))
    assert twice.names == ("offset1.value", "offset2.value")
    assert twice.vector(twice.template).tolist() == [1.0, 2.0]


@pytest.mark.parametrize("pack", [tuple, list, lambda p: Pair(*p), lambda p: dict(zip("mn", p, strict=True))])
def test_a_model_with_its_noise_is_one_space(pack: Any) -> None:
    space = ParameterSpace.of(pack([BoucWen(c=2.0), Noise()]), fix={"sigma": 0.2})
    own = [name for name in space.names if name.split(".")[-1] == "c"]
    assert len(own) == 2
    assert "mu" in space.names
    tree = space.tree(space.unconstrained(space.vector(space.template)))
    model, noise = tree.values() if isinstance(tree, dict) else tree
    assert float(model.c) == pytest.approx(2.0, rel=1e-15)
    assert (float(noise.c), float(noise.sigma)) == (7.0, 0.2)


def test_a_tuple_of_two_trees_is_not_taken_for_two_records() -> None:
    tree = (BoucWen(c=2.0), Noise())
    space = ParameterSpace.of(tree, records=("a", "b"))
    x = dict(zip(space.names, space.vector(tree), strict=True))
    assert (x["bouc_wen.c"], x["noise.c"]) == (2.0, 7.0)
    later = (BoucWen(c=2.0, offset=5.0), Noise())
    x = dict(zip(space.names, space.vector([tree, later]), strict=True))
    assert (x["offset@a"], x["offset@b"]) == (0.0, 5.0)


# -- fixing and freeing --------------------------------------------------------------------------------------------------


def test_fix_and_free_by_name_and_by_element() -> None:
    space = ParameterSpace.of(Every(), fix={"w[0,1]": 0.75, "low": None, "both": 1.0}, free=["held"])
    assert "w[0,1]" not in space.names
    assert not {"low", "both"} & set(space.names)
    assert "held" in space.names
    tree = space.tree(space.unconstrained(2.0 * space.vector(space.template)))
    np.testing.assert_allclose(tree.w, [[2.0, 0.75, 6.0], [8.0, 10.0, 12.0]], rtol=1e-14)
    assert (float(tree.low), float(tree.both)) == (2.0, 1.0)
    assert float(tree.held) == 18.0


def test_a_whole_array_is_fixed_to_one_value_or_to_one_each() -> None:
    values = np.linspace(1.0, 2.0, 6)
    assert np.array_equal(ParameterSpace.of(Every(), fix={"w": values}).template.w, values.reshape(2, 3))  # type: ignore[dict-item]
    assert np.array_equal(ParameterSpace.of(Every(), fix={"w": 3.0}).template.w, np.full((2, 3), 3.0))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"fix": ["cc"]}, ["no parameter 'cc'", "real, low, high, both, w, held"]),
        ({"free": ["w[2,0]"]}, ["w has shape (2, 3)"]),
        ({"free": ["w[1]"]}, ["w has shape (2, 3)"]),
        ({"fix": ["w[-1,0]"]}, ["no parameter"]),
        ({"fix": {"w": [1.0, 2.0]}}, ["6 elements"]),
        ({"fix": {"low": -1.5}}, ["low", "-1.5", "outside its bounds", "[-1, inf]"]),
        ({"fix": {"low": math.nan}}, ["low", "finite"]),
        ({"fix": ["low"], "free": ["low"]}, ["low", "fixed and free at once"]),
        ({"fix": ["w"], "free": ["w[0,0]"]}, ["fixed and free at once"]),
    ],
)
def test_errors_say_what_was_found_and_what_there_is(options: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(ParameterError) as error:
        ParameterSpace.of(Every(), **options)
    assert all(word in str(error.value) for word in words), str(error.value)


def test_an_ambiguous_name_is_answered_with_the_names() -> None:
    with pytest.raises(ParameterError, match=r"ambiguous.*bouc_wen\.c, viscous\.c"):
        ParameterSpace.of(Sum(BoucWen(), Viscous()), fix=["c"])
    assert "bouc_wen.c" not in ParameterSpace.of(Sum(BoucWen(), Viscous()), fix=["bouc_wen.c"]).names


def test_a_tree_without_parameters_is_refused() -> None:
    with pytest.raises(ParameterError, match="no parameters"):
        ParameterSpace.of(jnp.ones(3))


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.1])
def test_a_start_outside_the_bounds_is_refused(value: float) -> None:
    space = ParameterSpace.of(Every())
    x = space.vector(Every())
    x[1] = value
    with pytest.raises(ParameterError, match="'low'"):
        space.unconstrained(x)
    with pytest.raises(ParameterError, match="expected 10 values"):
        space.unconstrained(x[:-1])
    if not math.isinf(value):
        with pytest.raises(ParameterError, match=r"'low'.*outside its bounds"):
            ParameterSpace.of(Every(low=value))


@pytest.mark.parametrize("bad", [dict(bounds=(1.0, 1.0)), dict(scale=0.0), dict(scale=math.inf), dict(unit="volt")])
def test_a_bad_declaration_is_refused(bad: dict[str, Any]) -> None:
    with pytest.raises(ParameterError):
        param(1.0, **bad)


@pytest.mark.parametrize("value", ["abc", 1j, np.array([1j]), [[1.0], [1.0, 2.0]], jnp.array(1j)])
def test_a_value_that_is_no_real_number_is_refused(value: Any) -> None:
    with pytest.raises(ParameterError, match="real number"):
        Noise(sigma=value)


# -- values in a model ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [2, 2.0, np.float32(2.0), np.array(2), jnp.array(2), True])
def test_numbers_become_differentiable_arrays(value: Any) -> None:
    sigma = Noise(sigma=value).sigma
    assert isinstance(sigma, jax.Array)
    assert sigma.dtype == jnp.float64
    assert sigma.shape == ()


def test_a_number_given_for_a_vector_is_a_vector_of_one() -> None:
    assert LogCreep(gamma=0.02).gamma.shape == (1,)
    assert ParameterSpace.of(LogCreep(gamma=0.02)).names == ("gamma[0]",)


def test_parameter_values_are_never_static() -> None:
    traces = []

    @eqx.filter_jit
    def output(model: BoucWen, u: Array) -> Array:
        traces.append(1)
        return model.step(model.init(u), u, u + 1.0, u)[1]

    values = [float(output(BoucWen(c=c, tau=2), jnp.array(0.0))) for c in (1, 2.0, np.float64(3.0))]
    assert len(traces) == 1
    assert values[1] == pytest.approx(2 * values[0], rel=1e-14)  # with mu c, h scales with c
    assert values[2] == pytest.approx(3 * values[0], rel=1e-14)
    gradient = eqx.filter_grad(lambda model: output(model, jnp.array(0.0)))(BoucWen(c=2.0))
    assert float(gradient.c) != 0.0


# -- maps ----------------------------------------------------------------------------------------------------------------

SPACE = ParameterSpace.of(Every(), fix=["w"])
JACOBIAN = jax.jit(jax.jacfwd(SPACE.coordinates.physical))
Z = st.lists(st.floats(-30.0, 30.0), min_size=4, max_size=4).map(np.array)


@FEW
@given(Z)
def test_z_to_x_stays_within_the_bounds_and_comes_back(z: np.ndarray) -> None:
    x = SPACE.physical(z)
    assert (x >= [-np.inf, -1.0, -np.inf, -2.0]).all()
    assert (x <= [np.inf, np.inf, 4.0, 6.0]).all()
    back = SPACE.unconstrained(x)
    slope = np.abs(np.diag(np.asarray(JACOBIAN(jnp.asarray(z)))))
    rounding = np.finfo(float).eps * np.maximum(np.abs(x), 6.0) / slope  # what x next to its bound leaves of z
    known = rounding < 0.1
    assert (np.abs(back - z) <= 4.0 * rounding + 1e-14 * np.abs(z))[known].all()
    np.testing.assert_allclose(SPACE.physical(back)[known], x[known], rtol=1e-13, atol=1e-14)


@FEW
@given(
    st.floats(-1e200, 1e200),
    st.floats(0.0, 1e200).map(lambda a: -1.0 + a),
    st.floats(0.0, 1e200).map(lambda a: 4.0 - a),
    st.floats(-2.0, 6.0, exclude_min=True, exclude_max=True),
)
def test_x_to_z_is_finite_and_comes_back_for_extreme_values(real: float, low: float, high: float, both: float) -> None:
    x = np.array([real, low, high, both])
    z = SPACE.unconstrained(x)
    assert np.isfinite(z).all()
    on_bound = np.array([False, low == -1.0, high == 4.0, False])
    back = SPACE.physical(z)
    np.testing.assert_allclose(back[~on_bound], x[~on_bound], rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(back[on_bound], x[on_bound], atol=1.01e-3)  # a start on its bound is moved inside


def test_a_value_one_rounding_below_its_bound_has_a_finite_coordinate() -> None:
    x = SPACE.vector(Every())
    x[3] = np.nextafter(6.0, 0.0)
    z = SPACE.unconstrained(x)
    assert np.isfinite(z).all()
    assert SPACE.physical(z)[3] == pytest.approx(6.0, abs=2e-15)


def test_starts_and_estimates_share_one_map_and_differ_only_on_a_bound() -> None:
    inner = np.array([0.5, 2.0, 3.0, -1.999])
    z = np.asarray(SPACE.coordinates.unconstrained(jnp.asarray(inner)))
    np.testing.assert_allclose(SPACE.unconstrained(inner), z, rtol=1e-15)
    hand = [0.5 / 3.0, np.log(3.0), np.log(1.0), np.log(0.001 / 7.999)]  # closed forms of the docstring
    np.testing.assert_allclose(z, hand, rtol=1e-12, atol=1e-15)
    bounds = np.array([0.5, -1.0, 4.0, 6.0])
    gap = np.array([0.0, 1.0, -1.0, -8.0])  # towards the inside, by the scale or the width
    np.testing.assert_allclose(SPACE.physical(SPACE.unconstrained(bounds)), bounds + 1e-3 * gap, atol=1e-5)
    kept = SPACE.physical(SPACE.coordinates.unconstrained(jnp.asarray(bounds)))
    np.testing.assert_allclose(kept, bounds + 1e-9 * gap, rtol=0, atol=1e-14)


def test_bounds_are_attained_in_the_limit_on_both_sides() -> None:
    below, above = SPACE.physical(np.full(4, -60.0)), SPACE.physical(np.full(4, 60.0))
    assert below[0] == -180.0
    assert above[0] == 180.0
    assert below[1] == pytest.approx(-1.0, abs=1e-15)
    assert above[1] > 1e25
    assert below[2] == pytest.approx(4.0, abs=1e-15)
    assert above[2] < -1e25
    assert below[3] == pytest.approx(-2.0, abs=1e-15)
    assert above[3] == pytest.approx(6.0, abs=1e-15)


@FEW
@given(Z)
def test_slope_and_log_jacobian_are_those_of_the_map(z: np.ndarray) -> None:
    exact = np.asarray(JACOBIAN(jnp.asarray(z)))
    assert np.array_equal(exact, np.diag(np.diag(exact)))
    np.testing.assert_allclose(SPACE.coordinates.slope(jnp.asarray(z)), np.diag(exact), rtol=1e-13)
    # log det from differences of the closed forms in the docstring, not from the code's own derivative
    hand = [3.0, np.exp(z[1]), -np.exp(z[2]), 8.0 * np.exp(-abs(z[3])) / (1 + np.exp(-abs(z[3]))) ** 2]
    np.testing.assert_allclose(np.diag(exact), hand, rtol=1e-13)
    _, expected = np.linalg.slogdet(exact)
    assert float(SPACE.coordinates.log_jacobian(jnp.asarray(z))) == pytest.approx(expected, rel=1e-12, abs=1e-12)


def test_maps_have_finite_derivatives_far_out() -> None:
    for size in (-900.0, 900.0):
        z = jnp.array([size, min(size, 500.0), min(size, 500.0), size])
        assert np.isfinite(np.asarray(SPACE.coordinates.slope(z))).all()
        assert np.isfinite(float(SPACE.coordinates.log_jacobian(z)))


def test_covariance_propagates_as_samples_do() -> None:
    rng = np.random.default_rng(5)
    z = SPACE.unconstrained(SPACE.vector(Every()))
    root = 1e-3 * rng.normal(size=(4, 4))
    cloud = np.asarray(jax.vmap(SPACE.coordinates.physical)(z + rng.normal(size=(40_000, 4)) @ root.T))
    found, expected = SPACE.covariance(z, root @ root.T), np.cov(cloud.T)
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.max(np.abs(found - expected) / size) < 0.03  # six standard errors of 40 000 samples


# -- records -------------------------------------------------------------------------------------------------------------


def test_per_record_parameters_have_one_value_for_each_record() -> None:
    model = Sum(BoucWen(c=1.5), Viscous(c=0.1))
    space = ParameterSpace.of(model, records=("up", "down", "slow"))
    assert [n for n in space.names if "@" in n] == ["offset@up", "offset@down", "offset@slow"]
    x = space.vector(model)
    at = space.names.index("offset@up")
    x[at : at + 3] = [1.0, 2.0, 3.0]
    z = space.unconstrained(x)
    trees = [space.tree(z, k) for k in range(3)]
    assert [float(tree.parts[0].offset) for tree in trees] == [1.0, 2.0, 3.0]
    assert {float(tree.parts[0].c) for tree in trees} == {float(trees[0].parts[0].c)}
    np.testing.assert_allclose(space.vector(trees), x, rtol=1e-14)
    traced = jax.vmap(lambda k: space.coordinates.tree(jnp.asarray(z), k).parts[0].offset)(jnp.arange(3))
    assert traced.tolist() == [1.0, 2.0, 3.0]


def test_one_record_needs_no_label() -> None:
    assert "offset" in ParameterSpace.of(BoucWen(), records=("only",)).names


# -- units ---------------------------------------------------------------------------------------------------------------


def test_units_print_and_scale_from_one_expression() -> None:
    scales = Scales(u=50.0, y=5.0, s=0.1, u_unit="V", y_unit="um", s_unit="s")
    space = ParameterSpace.of(BoucWen(), scales=scales)
    units = dict(zip(space.names, space.units, strict=True))
    assert (units["c"], units["mu"], units["tau"], units["offset"]) == ("um/V", "", "1/V", "um")
    scale = dict(zip(space.names, np.asarray(space.coordinates.scale), strict=True))
    assert (scale["c"], scale["tau"], scale["offset"]) == (pytest.approx(0.1), pytest.approx(0.02), 5.0)
    # z is dimensionless: the same physics in other units has the same coordinates
    milli = dataclasses.replace(scales, u=50_000.0, u_unit="mV")
    other = ParameterSpace.of(BoucWen(c=1e-3, tau=1e-3), scales=milli)
    z = [s.unconstrained(s.vector(s.template)) for s in (space, other)]
    np.testing.assert_allclose(z[0], z[1], atol=1e-13)


@pytest.mark.parametrize(
    ("unit", "powers", "size", "label"),
    [
        ("1", {}, 1.0, ""),
        ("y/u^2", {"y": 1, "u": -2}, 3.0 / 4.0, "mm/V^2"),
        ("u*s^2/y", {"u": 1, "s": 2, "y": -1}, 2.0 * 25.0 / 3.0, "V*ms^2/mm"),
        ("1/s", {"s": -1}, 0.2, "1/ms"),
        ("u/u", {}, 1.0, ""),
        ("u^0.5", {"u": 0.5}, math.sqrt(2.0), "V^0.5"),
        ("sample", {"sample": 1}, 1.0, "samples"),
    ],
)
def test_unit_expressions(unit: str, powers: dict[str, float], size: float, label: str) -> None:
    scales = Scales(u=2.0, y=3.0, s=5.0, u_unit="V", y_unit="mm", s_unit="ms")
    assert exponents(unit) == powers
    assert scales.size(unit) == pytest.approx(size, rel=1e-15)
    assert scales.label(unit) == label


def test_unknown_units_keep_their_symbols() -> None:
    assert Scales().label("y/u") == "[y]/[u]"


@pytest.mark.parametrize(
    ("expected", "units"),
    [
        ("field", "Oe kOe A/m kA/m kA*m^-1 A·m⁻¹"),
        ("moment", "emu Am2 Am² A·m² A*m^2 memu"),
        ("magnetization", "emu/g emu/cm3 emu/cm³ Am2/kg A·m²/kg"),
        ("induction", "T mT G kG"),
        ("polarization", "uC/cm2 µC/cm² μC/cm^2 C/m2 C/m^2"),
        ("electric field", "kV/cm V/m MV/m kV*cm^-1"),
        ("displacement", "m mm um µm μm nm in deg"),
        ("velocity", "m/s mm/s m·s⁻¹ m/s2"),
        ("stress", "MPa GPa N/mm2 N/mm²"),
        ("time", "s ms us µs min h"),
        ("frequency", "Hz kHz"),
        ("", "parsec code 1 N/A"),
    ],
)
def test_quantities_of_units(expected: str, units: str) -> None:
    assert [quantity(unit) for unit in units.split(" ")] == [expected] * len(units.split(" "))


def test_every_declared_parameter_of_the_models_has_a_meaning() -> None:
    models = [BoucWen(), Duhem(), LogCreep(), Viscous(), Offset()]
    assert all(leaf.info.doc for model in models for leaf in leaves_of(model))


def test_simulation_at_z_equals_simulation_of_the_tree() -> None:
    space = ParameterSpace.of(BoucWen(c=1.5, offset=0.3))
    z = jnp.asarray(space.unconstrained(space.vector(space.template)))
    u = np.sin(np.linspace(0.0, 9.0, 50))
    np.testing.assert_allclose(
        simulate(space.tree(z), u)[0], simulate(BoucWen(c=1.5, offset=0.3), u)[0], rtol=1e-13, atol=1e-14
    )


WORDS = {
    "A_per_meter": "A/m", "kiloamperes per meter": "kA/m", "tesla": "T", "millitesla": "mT", "Gauss": "G", "oersted": "Oe",
    "Newton": "N", "volts": "V", "inches": "in", "microns": "um", "degrees": "deg", "pound": "lbf", "A m^2": "Am²",
    "NewtonMeter": "Nm", "AmperePerMeter": "A/m", "KiloGauss": "kG",
}  # fmt: skip


@pytest.mark.parametrize(("words", "symbols"), WORDS.items())
def test_units_in_words_are_those_of_their_symbols(words, symbols):
    assert parse_unit(words) == parse_unit(symbols) is not None
    assert conversion(words, symbols) == 1.0


def test_a_power_beyond_those_of_units_is_none() -> None:
    """A damaged file has text such as km999, whose factor no number holds."""
    assert parse_unit("km999") is None
    assert quantity("km999") == ""
    assert parse_unit("mm^4") is not None
