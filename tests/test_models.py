"""Every model through the conformance suite; compositions by hand; and the suite itself against broken models."""

import dataclasses
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hystfit
from hystfit.errors import ModelError, ParameterError
from hystfit.models import (
    AbstractHysteresis,
    AsymmetricBoucWen,
    BoucWen,
    BoucWenOscillator,
    Delay,
    Duhem,
    Lag,
    Linear,
    LinearCreep,
    LogCreep,
    Negate,
    Offset,
    ParametricPreisach,
    PrandtlIshlinskii,
    Preisach,
    SaturatingRate,
    SecondOrder,
    Series,
    SignedPreisach,
    Sum,
    TabulatedPreisach,
    Viscous,
    registry,
    simulate,
)
from hystfit.models.curve import Curve
from hystfit.models.jiles_atherton_dynamic import JilesAthertonDynamic
from hystfit.models.jiles_atherton_field import JilesAthertonField
from hystfit.models.rate import Excess
from hystfit.models.shared.bracketed import Root
from hystfit.models.shared.simulation import run
from hystfit.models.shared.step_inverse import AbstractStepInverse
from hystfit.params.param import param
from hystfit.testing import check_model

LOOP = dict(c=1.1, mu=0.5, tau=1.7, rho=0.4, h0=0.07, offset=0.2)
SKEWED = {**LOOP, "skew": 0.2, "b": (0.1, -0.05), "center": 0.1, "half": 1.2}
CURVES = dict(alpha=1.3, f=(0.1, 1.0, 0.2, 0.1), g=(0.4, 0.1, 0.05), w0=0.1, center=0.05, half=1.1)
PLAYS = dict(r=(0.05, 0.17, 0.33), b=(0.8, 0.1), offset=0.3, low=-1.1, high=1.2, level=0.02)
RELAYS = dict(levels=(-0.71, -0.33, 0.13, 0.52), b=(0.4, 0.1), offset=0.2, center=0.03, half=1.1)
WEIGHTS = np.linspace(0.05, 0.4, 10)

# The thresholds of plays and the levels of cells leave kinks; relays have no derivative in their levels.
MODELS: dict[str, tuple[AbstractHysteresis, dict[str, Any]]] = {
    "bouc-wen": (BoucWen(**LOOP), {}),
    "bouc-wen, exact": (BoucWen(**LOOP, scheme="exact"), {}),
    "asymmetric": (AsymmetricBoucWen(**SKEWED, n=1.6), {}),
    "asymmetric, exact": (AsymmetricBoucWen(**SKEWED, n=0.7, scheme="exact"), {}),
    "duhem": (Duhem(**CURVES), {}),
    "duhem, explicit": (Duhem(**CURVES, scheme="explicit"), {}),
    "duhem, exact": (Duhem(**CURVES, scheme="exact"), {}),
    "force": (hystfit.BoucWenForce(kappa_x=0.4, kappa_w=1.0, rho=2.0, sigma=0.9, n=2.0, w0=0.1), {}),
    "degrading": (
        hystfit.BoucWenBaberNoori(kappa_x=0.2, beta=0.6, n=1.4, dnu=0.05, deta=0.1, p=0.3, dpsi=0.02, offset=0.1),
        {},
    ),
    "self-similar": (
        hystfit.SelfSimilarStops(
            w=np.linspace(0.1, 0.5, 14).reshape(2, 7),
            c=np.linspace(0.5, -0.2, 6).reshape(2, 3),
            fading=np.linspace(0.2, -0.1, 10),
            peaks=(0.3, 0.9),
            floor=0.07,
            offset=0.1,
        ),
        dict(kinked=["r"]),
    ),
    "damper": (
        hystfit.Damper(
            spring=(0.5, 0.1, -0.2, 0.1), bent=(0.1, 0.02, -0.1), coupling=(0.1, -0.2, 0.3, 0.1), half=1.1, speed=9.0
        ),
        {},
    ),
    "dahl": (hystfit.Dahl(Fc=(0.4, 0.3), d=(0.05, 0.4), k=0.2, offset=0.1), {}),
    "lugre": (hystfit.LuGre(sigma0=20.0, sigma1=0.05, vs=3.0, k=0.2, offset=0.1), {}),
    "maxwell slip": (
        hystfit.MaxwellSlip(w=(0.5, 0.3, 0.2), r=(0.05, 0.17, 0.33), vs=3.0, half=1.1, speed=9.0, offset=0.1),
        dict(kinked=["r", "excess", "vs", "half"]),
    ),
    "viscoelastic": (hystfit.Viscoelastic(g=(0.3, 0.2, 0.5), tau=(0.01, 0.1, 1.0)), {}),
    "springpot": (hystfit.Springpot(c=0.4, order=0.3, tau=(0.01, 0.1, 1.0)), {}),
    "rate shift": (hystfit.RateShift(c=0.1, q0=2.0), {}),
    "rate-dependent plays": (
        hystfit.RateDependentPlays(w=(0.2, 0.1, 0.4), r=(0.05, 0.17, 0.33), kappa=0.02, tau=0.03, low=-1.1, speed=30.0),
        dict(kinked=["r", "kappa", "tau", "low", "high", "speed"]),
    ),
    "steel-02": (
        hystfit.Steel02(fy=1.0, E=4.0, b=0.05, cR2=0.2, a1=0.03, a3=0.05, sigInit=0.1, deadband=1e-4, offset=0.1),
        dict(flat=["deadband"]),
    ),
    "voce-chaboche": (
        hystfit.VoceChaboche(E=5.0, sy0=0.4, Q=0.2, b=0.5, D=0.1, a=2.0, S=(0.3, 0.1), g=(2.0, 20.0), offset=0.1),
        {},
    ),
    "jiles-atherton": (
        hystfit.JilesAtherton(Ms=1.3, a=0.2, coupling=0.6, k=0.15, c=0.3, slope=0.05, offset=0.1),
        {},
    ),
    "jiles-atherton with losses": (
        JilesAthertonDynamic(
            Ms=1.3, a=0.2, coupling=0.6, k=0.15, c=0.3, slope=0.05, offset=0.1, eddy=1e-3, excess=0.02, e=0.5
        ),
        {},
    ),
    "jiles-atherton driven by B": (
        JilesAthertonField(Ms=1.3, a=0.2, coupling=0.6, k=0.15, c=0.3, q=[1.0], slope=0.5, offset=0.1),
        {},
    ),
    "relaxation": (hystfit.Relaxation(), {}),
    "oscillator": (BoucWenOscillator(m=0.01, c=0.05, r_unl=0.7, n=1.5, between="linear"), {}),
    "oscillator, hardening, held": (BoucWenOscillator(m=0.01, c=0.05, r_load=-0.5, r_unl=0.7, between="hold"), {}),
    "density": (ParametricPreisach(levels=(-0.71, -0.33, 0.13, 0.52, 0.8), depth=8), dict(kinked=["levels"])),
    "relays": (Preisach(w=WEIGHTS, elements="relays", **RELAYS), dict(flat=["levels"])),
    "relay": (hystfit.Relay(up=0.31, down=-0.2, low=-0.4, high=1.2), dict(flat=["up", "down"])),
    "cells": (Preisach(w=np.linspace(0.05, 0.4, 6), depth=8, **RELAYS), dict(kinked=["levels"])),
    "everett table": (dataclasses.replace(TabulatedPreisach.of(2), depth=8), dict(kinked=["levels"])),
    "cells of either sign": (SignedPreisach(w=np.linspace(-0.1, 0.4, 6), depth=8, **RELAYS), dict(kinked=["levels"])),
    "plays": (PrandtlIshlinskii(w=[[0.2, 0.1, 0.4]], **PLAYS), dict(kinked=["r"])),
    "generalized plays": (
        PrandtlIshlinskii(
            w=np.linspace(0.1, 0.9, 9).reshape(3, 3), envelopes=("identity", "square", "mirror"), **PLAYS
        ),
        dict(kinked=["r"]),
    ),
    "hardening stops": (
        PrandtlIshlinskii(w=[[0.2, 0.1, 0.4]], operator="stop", hardening=(0.1, -0.2, 0.3), s0=2.0, **PLAYS),
        dict(kinked=["r"]),
    ),
    "delay": (Delay(lag=2.3), dict(counts_samples=True)),
    "lag": (Lag(tau=0.02, level=0.1), {}),
    "lag of order one": (Lag(tau=0.02, level=0.1, order=1), {}),
    "curve": (
        Curve(rise=0.7, bend=(0.3, -2.0, 4.0, 1.0), knots=(0.0, 0.2, 0.7, 1.0), offset=0.1, low=-0.8, high=0.7),
        {},
    ),
    "second order": (SecondOrder(omega=60.0, zeta=0.2), {}),
    "viscous": (Viscous(c=0.1), {}),
    "saturating": (SaturatingRate(F=0.3, v0=2.0), {}),
    "excess": (Excess(g=0.3, e=0.5), {}),
    "log creep": (LogCreep(gamma=(0.01, 0.002), tau=(0.05, 0.5), weights=(0.9, 0.8)), {}),
    "linear creep": (LinearCreep(a=(0.01, 0.05), tau=(0.03, 0.4), low=-1.0, high=1.0), {}),
    "offset": (Offset(value=0.3), {}),
    "linear": (Linear(k=-0.3), {}),
    "falling loop": (Series(Negate(), BoucWen(**LOOP)), {}),
    "series in a sum": (Sum(Series(Lag(tau=0.02, level=0.1), Duhem(**CURVES)), Viscous(c=0.02), Offset(value=0.1)), {}),
}


# What takes longest to compile, and models whose parts are checked alone. In the quick form relays and both schemes of the loop keep the
# laws; the tests of Jiles-Atherton, of the oscillator, of dampers, friction, steel, forces and degrading loops fit by their derivatives,
# and those of Duhem and of the resonance have derivatives of their own.
SLOW = (
    "force",
    "lugre",
    "maxwell slip",
    "springpot",
    "generalized plays",
    "duhem, explicit",
    "duhem, exact",
    "degrading",
    "damper",
    "steel-02",
    "voce-chaboche",
    "second order",
    "oscillator",
    "asymmetric, exact",
    "oscillator, hardening, held",
    "density",
    "cells",
    "cells of either sign",
    "everett table",
    "jiles-atherton",
    "jiles-atherton driven by B",
    "jiles-atherton with losses",
    "lag of order one",
    "falling loop",
    "series in a sum",
)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in MODELS]
)
def test_every_model_keeps_the_laws(name: str) -> None:
    model, options = MODELS[name]
    check_model(model, samples=32, **options)


def test_every_public_model_is_in_the_table() -> None:
    def parts(model: Any) -> list[type]:
        return [type(model)] + [kind for part in getattr(model, "parts", ()) for kind in parts(part)]

    public = {
        kind
        for kind in (getattr(hystfit, name) for name in hystfit.__all__)
        if isinstance(kind, type)
        and issubclass(kind, AbstractHysteresis)
        and not getattr(kind, "__abstractmethods__", 0)
    }
    assert public <= {kind for model, _ in MODELS.values() for kind in parts(model)}


# -- rate independence -----------------------------------------------------------------------------------------------------


@settings(max_examples=25)
@given(
    st.lists(st.floats(-1.0, 1.0), min_size=12, max_size=12).map(np.array),
    st.sampled_from(["bouc-wen, exact", "relays", "plays", "duhem, exact"]),
)
def test_slower_and_resting_inputs_give_the_same_output(u: np.ndarray, name: str) -> None:
    """Each branch run in three parts and each part held for a sample: what counts is the path, not its sampling."""
    model, _ = MODELS[name]
    parts = np.linspace(u[:-1], u[1:], 4, axis=1)[:, 1:]
    parts[:, -1] = u[1:]
    held = np.repeat(np.concatenate([u[:1], parts.reshape(-1)]), 2)
    slow = np.asarray(simulate(model, held)[0])
    np.testing.assert_allclose(slow[::6], simulate(model, u)[0], atol=1e-11)


# -- composition -----------------------------------------------------------------------------------------------------------

TIME = np.linspace(0.0, 1.0, 40)
U = np.sin(9 * TIME) + 0.1
DT = np.diff(TIME, prepend=0.0)


def test_a_sum_adds_its_parts() -> None:
    parts = BoucWen(**LOOP), Viscous(c=0.02), LinearCreep(a=0.1)
    by_hand = sum(np.asarray(simulate(part, U, DT)[0]) for part in parts)
    np.testing.assert_allclose(simulate(Sum(*parts), U, DT)[0], by_hand, atol=1e-14)
    assert not Sum(*parts).rate_independent
    assert Sum(BoucWen(), Offset()).rate_independent


def test_a_series_feeds_each_output_into_the_next() -> None:
    parts = Delay(lag=1.5), BoucWen(**LOOP), SecondOrder(omega=60.0, zeta=0.2), LogCreep(gamma=0.02)
    signal = U
    for part in parts:
        signal = np.asarray(simulate(part, signal, DT)[0])
    np.testing.assert_allclose(simulate(Series(*parts), U, DT)[0], signal, atol=1e-13)


def test_the_advice_of_the_parts_is_passed_on() -> None:
    coarse = BoucWen(tau=5.0)
    said = coarse.advice(U)
    assert len(said) == 1
    assert Sum(coarse, Viscous()).advice(U) == said
    assert Series(Lag(), coarse).advice(U) == said
    assert Series(Lag(), BoucWen(tau=1e-3)).advice(U) == ()


# -- bad arguments ---------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("as_users_run")
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Sum(), "at least 1"),
        (lambda: Sum(BoucWen(), 3.0), "'float'"),
        (lambda: Series(BoucWen()), "at least 2"),
        (lambda: PrandtlIshlinskii(w=[[1.0, 2.0]], r=(0.1,)), "must have shape"),
        (lambda: PrandtlIshlinskii(w=[[1.0]], r=(0.1,), envelopes=("cubic",)), "cubic"),
        (lambda: Preisach(w=(1.0, 2.0), levels=(0.0, 0.5), elements="relays"), "weights"),
        (lambda: Preisach(w=(1.0,), levels=(0.0,), elements="relays", initial="warm"), "'warm'"),
        (lambda: simulate(BoucWen(), np.zeros((2, 3))), r"shape \(T,\).*\(2, 3\)"),
        (lambda: simulate(BoucWen(), np.zeros(0)), r"T > 0"),
        (lambda: simulate(BoucWen(), 3.0), r"shape \(T,\)"),
        (lambda: simulate(Viscous(), np.zeros(3)), "Viscous depends on time: give dt"),
        (lambda: simulate(Sum(BoucWen(), Viscous()), np.zeros(3)), "Sum depends on time"),
        (lambda: simulate(Viscous(), np.zeros(3), np.zeros(4)), r"shape of the input \(3,\), got \(4,\)"),
    ],
)
def test_bad_arguments_are_refused_with_what_was_found(make: Any, words: str) -> None:
    with pytest.raises(ModelError, match=words):
        make()


def test_the_first_time_step_counts_where_the_rest_was_elsewhere() -> None:
    """Two lags of 0.5 s from rest on 0: 1 - (1 + t / 0.5) exp(-t / 0.5), read 0.5 and 0.6 s after the input became 1."""
    t = np.array([0.5, 0.6])
    expected = 1 - (1 + 2 * t) * np.exp(-2 * t)
    np.testing.assert_allclose(simulate(Lag(tau=1.0), np.ones(2), np.array([0.5, 0.1]))[0], expected, rtol=1e-13)
    y, end = simulate(Lag(tau=1.0), np.ones(2), 0.1)
    again, _ = simulate(Lag(tau=1.0), np.ones(2), 0.1, resume=end)
    np.testing.assert_allclose(np.concatenate([y, again]), simulate(Lag(tau=1.0), np.ones(4), 0.1)[0], rtol=1e-14)


# -- the suite finds broken models -----------------------------------------------------------------------------------------


class Spring(AbstractHysteresis):
    """A model of two lines that keeps every law; the classes below break one each."""

    rate_independent: ClassVar[bool] = True
    k: jax.Array = param(2.0, bounds=(0.0, np.inf), unit="y/u")

    def init(self, u0: Any) -> Any:
        return u0[None]

    def step(self, state: Any, u0: Any, u1: Any, dt: Any) -> Any:
        return 0.5 * (state + u1), self.k * u1

    def start(self, records: Any) -> Any:
        return type(self)(k=1.0)


class Whole(Spring):
    def step(self, state: Any, u0: Any, u1: Any, dt: Any) -> Any:
        return u1[None], self.k * u1


class Pair(Whole):
    def init(self, u0: Any) -> Any:
        return jnp.stack([u0[None], u0[None]])


class Stretching(Whole):
    def step(self, state: Any, u0: Any, u1: Any, dt: Any) -> Any:
        return jnp.concatenate([state, state]), self.k * u1


class Infinite(Whole):
    def step(self, state: Any, u0: Any, u1: Any, dt: Any) -> Any:
        return u1[None], self.k / (u1 - u1)


class Hurried(Whole):
    def step(self, state: Any, u0: Any, u1: Any, dt: Any) -> Any:
        return u1[None], self.k * u1 + dt


class Forgetful(Whole):
    """Its state drifts with the number of samples."""

    def step(self, state: Any, u0: Any, u1: Any, dt: Any) -> Any:
        return state + 0.1, self.k * (u1 + state[0])


class Counting(Whole):
    """Drifts with every sample, moved or not."""

    def step(self, state: Any, u0: Any, u1: Any, dt: Any) -> Any:
        return state + 0.1 * jnp.sign(u1 - u0) + jnp.where(u1 == u0, 0.3, 0.0), self.k * (u1 + state[0])


@jax.custom_jvp
def _wrong_slope(x: Any) -> Any:
    return x


@_wrong_slope.defjvp
def _(primals: Any, tangents: Any) -> Any:
    return primals[0], 1.01 * tangents[0]


class Crooked(Whole):
    def step(self, state: Any, u0: Any, u1: Any, dt: Any) -> Any:
        return u1[None], _wrong_slope(self.k) * u1


class Rooted(Whole):
    """Finite, with an infinite derivative."""

    def step(self, state: Any, u0: Any, u1: Any, dt: Any) -> Any:
        return u1[None], self.k * u1 + jnp.sqrt(0.0 * self.k)


class Eager(Whole):
    def step(self, state: Any, u0: Any, u1: Any, dt: Any) -> Any:
        return u1[None], self.k * u1 + (1.0 if isinstance(u1, jax.core.Tracer) else 0.0)


class Weighing(Whole):
    """A spring that is declared linear in its square root."""

    root: jax.Array = param(2.0, linear=True)

    def step(self, state: Any, u0: Any, u1: Any, dt: Any) -> Any:
        return u1[None], self.k * u1 + self.root**2 * u1


class Halving(AbstractStepInverse):
    model: Whole
    needs_limits: ClassVar[bool] = False

    def solve(self, state: Any, u0: Any, target: Any, dt: Any, low: Any, high: Any) -> Root:
        return Root(0.5 * target / self.model.k, self.model.k > 0)


class Misled(Whole):
    def step_inverse(self, sign: float = 1.0) -> Halving:
        return Halving(self)


class Alien(Whole):
    def start(self, records: Any) -> Any:
        return BoucWen()


class Hopeless(Whole):
    def start(self, records: Any) -> Any:
        return eqx.tree_at(lambda m: m.k, self, jnp.asarray(jnp.nan))


@pytest.mark.parametrize(
    ("model", "law"),
    [
        (Pair(), "one array of one dimension"),
        (Stretching(), "state like that of init"),
        (Infinite(), "not finite at sample 0"),
        (Hurried(), "padding must keep the output"),
        (Counting(), "first after a rest"),
        (Forgetful(), "first after a rest"),
        (Crooked(), "derivative in k against central differences"),
        (Rooted(), "derivative in k is not finite"),
        (Eager(), "without jit"),
        (Alien(), "start returned a BoucWen"),
        (Weighing(), "design_matrix times the linear weights"),
        (Misled(), "must give an input with the same output"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, AbstractHysteresis) else "",
)
def test_the_suite_names_the_law_that_is_broken(model: Any, law: str) -> None:
    with pytest.raises(AssertionError, match=law):
        check_model(model, samples=24)


def test_the_suite_accepts_a_model_of_the_user() -> None:
    check_model(Whole(), samples=24, amplitude=50.0, center=20.0)


def test_the_suite_refuses_starting_values_that_are_no_numbers() -> None:
    with pytest.raises(ParameterError, match="nan"):
        check_model(Hopeless(), samples=24)


def test_the_suite_wants_known_names_and_values_inside_the_bounds() -> None:
    with pytest.raises(AssertionError, match=r"no parameter \['kk'\]"):
        check_model(Whole(), samples=24, kinked=["kk"])
    with pytest.raises(AssertionError, match="on its bound"):
        check_model(Whole(k=0.0), samples=24)


@pytest.mark.parametrize("name", registry.MODELS)
def test_name_of_a_model_makes_it_again(name):
    expression = (
        name if registry.MODELS[name].place == "core" else registry.model_name(registry.make_model(f"bouc-wen+{name}"))
    )
    assert registry.model_name(registry.make_model(expression)) == expression
    assert name in expression.split("+")
    made = type(registry.MODELS[name].default)  # the class that its entry states is told without making one
    assert [other for other, entry in registry.MODELS.items() if entry.makes(made)] == [
        other for other, entry in registry.MODELS.items() if type(entry.default) is made
    ]


def test_settings_follow_a_name():
    made = registry.make_model("lag:rest=first+prandtl-ishlinskii-generalized:plays=8:degree=2+creep")
    assert isinstance(made, Series)
    plays = next(part for part in made.parts[1].parts if hasattr(part, "w"))
    assert (plays.w.shape, plays.rise.shape, made.parts[0].rest) == ((3, 8), (2,), "first")
    assert registry.make_model("bouc-wen: scheme = exact").scheme == "exact"
    assert registry.make_model("duhem:f=5:g=0").f.shape == (6,)
    assert not registry.make_model("preisach:n=12:reversible=no").slopes.size


@pytest.mark.parametrize("name", registry.MODELS)
def test_settings_shown_are_those_of_the_plain_name(name):
    entry = registry.MODELS[name]
    plain, said = (
        entry.make(),
        entry.make(**registry._chosen(name, entry.shown())) if entry.settings() else entry.make(),
    )
    assert eqx.tree_equal(plain, said)


@pytest.mark.usefixtures("as_users_run")
@pytest.mark.parametrize(
    ("expression", "message"),
    [
        ("bouc-wen:schem=exact", "got 'schem=exact'; it has scheme=semi-implicit"),
        ("bouc-wen:", "NAME=VALUE"),
        ("bouc-wen:scheme=exact:scheme=exact", "each once"),
        ("offset:value=3+bouc-wen", "no settings"),
        ("bouc-wen:scheme=implicit", "semi-implicit or exact"),
        ("preisach:n=many", "n is a whole number, got 'many'"),
        ("preisach:reversible=2", "reversible is yes or no"),
        ("preisach:n=0", "at least one"),
        ("duhem:f=-1", "0 or more"),
    ],
)
def test_settings_that_a_model_does_not_have_are_refused(expression, message):
    with pytest.raises(ModelError, match=message):
        registry.make_model(expression)


def test_derivatives_of_a_force_that_yields_within_one_sample_are_those_of_differences():
    """On the bound three arguments of the clipping agree; derivatives that mix them grew to 1e20 within a cycle."""
    u = jnp.asarray(12 * np.sin(np.linspace(0, 4 * np.pi, 100)))
    force = jax.jit(
        lambda rho: run(hystfit.BoucWenForce(rho=rho, sigma=2.3, n=2.9, kappa_w=46.0), u, jnp.ones_like(u))[0]
    )
    h, rho = 1e-5, jnp.asarray(24.0)
    want = (force(rho + h) - force(rho - h)) / (2 * h)
    np.testing.assert_allclose(jax.jit(jax.jacfwd(force))(rho), want, rtol=1e-4, atol=1e-4)
