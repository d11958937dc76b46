"""Plays and relays against plain loops and the laws of Preisach's memory: wiping-out and congruency."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.interpolate
from hypothesis import given, settings
from hypothesis import strategies as st

from hystfit.errors import ModelError
from hystfit.models import PrandtlIshlinskii, Preisach, RateDependentPlays, simulate

FEW = settings(max_examples=30, deadline=None, derandomize=True)
RNG = np.random.default_rng(0)
LEVELS = np.array([-0.8, -0.45, -0.1, 0.2, 0.55, 0.9])
RELAYS = Preisach(
    w=RNG.uniform(0.0, 1.0, 21), levels=LEVELS, elements="relays", b=(0.3, -0.1), offset=0.4, center=0.05, half=1.0
)
CELLS = Preisach(w=RNG.uniform(0.0, 1.0, 15), levels=LEVELS, offset=0.4, center=0.05, half=1.0, depth=16)
R = np.array([0.04, 0.11, 0.2, 0.36])
PLAYS = PrandtlIshlinskii(w=RNG.uniform(0.1, 1.0, (1, 4)), r=R, b=(0.5, 0.2), offset=0.3, low=-1.0, high=1.0, level=0.1)
GENERAL = PrandtlIshlinskii(
    w=RNG.uniform(0.1, 1.0, (3, 4)),
    r=R,
    rise=(0.3, 0.0, 0.5),
    low=-1.0,
    high=1.0,
    envelopes=("identity", "square", "mirror"),
)
STOPS = PrandtlIshlinskii(w=RNG.uniform(0.1, 1.0, (1, 4)), r=R, b=(1.0,), low=-1.0, high=1.0, operator="stop")
MEMORIES = {"relays": RELAYS, "cells": CELLS, "plays": PLAYS, "general plays": GENERAL, "stops": STOPS}

LENGTH = 24
WALK = st.lists(st.floats(-1.2, 1.2), min_size=LENGTH, max_size=LENGTH).map(np.array)


def plain_relays(model: Preisach, u: np.ndarray, initial: str) -> np.ndarray:
    pairs = [(LEVELS[i], LEVELS[j]) for i in range(6) for j in range(i + 1)]
    center = float(model.center)
    rest = {"negative": lambda a, b: -1.0, "positive": lambda a, b: 1.0}
    state = [rest.get(initial, lambda a, b: -1.0 if a + b > 2 * center else 1.0)(a, b) for a, b in pairs]
    out = []
    for v in u:
        state = [1.0 if v >= a else -1.0 if v <= b else s for (a, b), s in zip(pairs, state, strict=True)]
        x = (v - center) / float(model.half)
        reversible = 0.3 * x - 0.1 * (1.5 * x**2 - 0.5)
        out.append(0.4 + sum(float(w) * s for w, s in zip(model.w, state, strict=True)) + reversible)
    return np.array(out)


@pytest.mark.parametrize("initial", ["demagnetized", "negative", "positive"])
def test_relays_equal_a_plain_loop(initial: Any) -> None:
    model = Preisach(
        w=RELAYS.w, levels=LEVELS, elements="relays", b=(0.3, -0.1), offset=0.4, center=0.05, half=1.0, initial=initial
    )
    u = np.concatenate([np.random.default_rng(1).uniform(-1.0, 1.0, 60), LEVELS])
    np.testing.assert_allclose(simulate(model, u)[0], plain_relays(model, u, initial), rtol=1e-12)


ENVELOPES = {
    "identity": lambda x: x,
    "square": lambda x: x * abs(x),
    "mirror": lambda x: 1 - (1 - x) * abs(1 - x),
}


def rising(increments: np.ndarray, x: float) -> float:
    """The rising single-valued part by scipy's Bernstein polynomials, with its tangents outside 0 to 1."""
    if not increments.size:
        return 0.0
    inside = scipy.interpolate.BPoly(np.append(0.0, np.cumsum(increments))[:, None], [0.0, 1.0])
    edge = min(max(x, 0.0), 1.0)
    return float(inside(edge) + inside(edge, nu=1) * (x - edge))


@pytest.mark.parametrize("model", [PLAYS, GENERAL, STOPS], ids=["plays", "general", "stops"])
def test_plays_equal_a_plain_loop(model: PrandtlIshlinskii) -> None:
    u = np.random.default_rng(2).uniform(-1.2, 1.1, 60)
    place = lambda v: (v + 1.0) / 2.0
    shapes = [ENVELOPES[kind] for kind in model.envelopes]
    plays = [[shape(place(float(model.level)))] * R.size for shape in shapes]
    out = []
    for v in u:
        y = float(model.offset)
        for e, shape in enumerate(shapes):
            target = shape(place(v))
            plays[e] = [max(target - r, min(target + r, p)) for r, p in zip(R, plays[e], strict=True)]
            element = [target - p for p in plays[e]] if model.operator == "stop" else plays[e]
            y += sum(float(w) * p for w, p in zip(model.w[e], element, strict=True))
        y += np.polynomial.legendre.legval(2 * place(v) - 1, [0.0, *np.asarray(model.b)])
        out.append(y + rising(np.asarray(model.rise), place(v)))
    np.testing.assert_allclose(simulate(model, u)[0], out, rtol=1e-12, atol=1e-13)


def continued(model: Any, history: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Output along `after`, both of a fixed length so that one compilation serves."""
    _, end = simulate(model, history)
    return np.asarray(simulate(model, after, resume=end)[0])


@pytest.mark.parametrize("name", MEMORIES)
@FEW
@given(WALK, st.floats(-1.3, 1.3), st.floats(0.01, 1.0), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_larger_excursion_wipes_out_a_smaller_one(
    name: str, history: np.ndarray, low: float, size: float, first: float, second: float
) -> None:
    """After low -> high, any excursion inside [low, high] that returns to high leaves no trace."""
    model = MEMORIES[name]
    high = low + size
    inside = [low + size * first, low + size * max(first, second)]
    probe = [high, low + 0.3 * size, high, low - 0.4, high + 0.3, low, high + 0.1, -2.0]
    with_loop = np.array([low, high, *inside, high, *probe])
    without = np.array([low, high, high, high, high, *probe])
    found, expected = (continued(model, history, after)[4:] for after in (with_loop, without))
    np.testing.assert_allclose(found, expected, atol=1e-11)


@pytest.mark.parametrize("name", MEMORIES)
@FEW
@given(WALK, WALK, st.floats(-1.0, 0.9), st.floats(0.01, 1.0))
def test_loops_between_the_same_inputs_are_congruent(
    name: str, one: np.ndarray, other: np.ndarray, low: float, size: float
) -> None:
    """The rise and fall of the output around a minor loop do not depend on what went before."""
    model = MEMORIES[name]
    part = np.linspace(low, low + size, 5)
    loop = np.concatenate([part[::-1], part, part[::-1]])[: 3 * 5]
    loops = [continued(model, history, loop) for history in (one, other)]
    steady = [y[4:] - y[4] for y in loops]  # from the first time at `low` on
    np.testing.assert_allclose(steady[0], steady[1], atol=1e-11)
    assert steady[0][-1] == pytest.approx(0.0, abs=1e-11)  # the loop closes


@pytest.mark.parametrize("name", ["relays", "cells", "plays", "general plays"])
@FEW
@given(WALK)
def test_loops_run_counter_clockwise(name: str, u: np.ndarray) -> None:
    """With weights >= 0 the output lags: over a closed cycle the sum of u dy, u where dy has happened, is not negative."""
    model = MEMORIES[name]
    model = eqx.tree_at(lambda m: m.b, model, jnp.zeros_like(model.b))  # the single-valued part may fall
    y = np.asarray(simulate(model, np.concatenate([u, u]))[0])  # the second run through the same corners is a cycle
    assert np.sum(u * np.diff(y[LENGTH - 1 :])) >= -1e-12


@FEW
@given(WALK, st.floats(-1.4, 1.4), st.lists(st.floats(0.0, 2.0), min_size=1, max_size=5))
def test_the_output_of_plays_never_falls_while_the_input_rises(
    history: np.ndarray, end: float, rise: list[float]
) -> None:
    """From any state, on the way to any input: what an inverse needs."""
    model = eqx.tree_at(lambda m: m.rise, GENERAL, jnp.asarray(rise[:3] + [0.0] * (3 - len(rise[:3]))))
    way = np.linspace(history[-1], end, LENGTH)
    y = continued(model, history, way)
    assert (np.diff(y) * np.sign(end - history[-1])).min() >= -1e-12


def test_an_infinitely_wide_play_is_stuck_and_a_narrow_one_follows() -> None:
    u = np.random.default_rng(3).uniform(-1.0, 1.0, 30)
    for r, expected in ((10.0, np.full(30, 0.5)), (0.0, (u + 1) / 2)):
        model = PrandtlIshlinskii(w=[[1.0]], r=(r,), b=(0.0,), low=-1.0, high=1.0)
        np.testing.assert_allclose(simulate(model, u)[0], expected, atol=1e-15)


def test_saturated_relays_add_up_to_all_weights() -> None:
    model = Preisach(w=RELAYS.w, levels=LEVELS, elements="relays")
    y = np.asarray(simulate(model, np.array([0.0, 2.0, -2.0]))[0])
    assert y[1] == pytest.approx(float(np.sum(RELAYS.w)), rel=1e-14)
    assert y[2] == pytest.approx(-float(np.sum(RELAYS.w)), rel=1e-14)


def test_plays_by_number_have_thresholds_that_are_dense_where_loops_are_small() -> None:
    for made in (PrandtlIshlinskii.of(3), RateDependentPlays.of(3)):
        np.testing.assert_allclose(made.r, [1 / 32, 4 / 32, 9 / 32], rtol=1e-15)
        with pytest.raises(ModelError, match="at least one play"):
            type(made).of(0)
    with pytest.raises(ModelError, match="degree one"):
        PrandtlIshlinskii.of(3, degree=0)
