"""The Preisach model: its two exact forms against plain relays, and the laws that it obeys."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hystfit as hf
from hystfit.errors import ModelError
from hystfit.models.preisach.design_matrix import features
from hystfit.models.preisach.everett import Everett, place
from hystfit.models.preisach.model import Preisach
from hystfit.models.preisach.parametric import ParametricPreisach
from hystfit.models.preisach.staircase import compile_input

RESTS = ("demagnetized", "negative", "positive")


def make(elements: str, initial: str, center: float, symmetric: bool, seed: int, n: int = 6) -> Preisach:
    rng = np.random.default_rng(seed)
    base = Preisach.of(n, symmetric=symmetric, elements=elements, initial=initial, degree=2)
    count = base.levels.size
    if symmetric:
        half = np.sort(rng.uniform(0.05, 1, count // 2))
        levels = center + np.concatenate([-half[::-1], np.zeros(count % 2), half])
    else:
        levels = np.sort(rng.uniform(-1, 1, count))
    return Preisach(
        w=rng.uniform(0, 1, base.w.size),
        levels=levels,
        slopes=rng.uniform(0, 1, base.slopes.size),
        b=rng.uniform(-1, 1, 2),
        offset=0.3,
        center=center,
        elements=elements,
        initial=initial,
        symmetric=symmetric,
    )


def relay_loop(up, down, weight, initial, center, u):
    """The definition, one relay at a time, in plain Python."""
    if initial == "demagnetized":
        state = [-1.0 if a + b > 2 * center else 1.0 for a, b in zip(up, down, strict=True)]
    else:
        state = [1.0 if initial == "positive" else -1.0] * len(up)
    out = []
    for v in u:
        for k, (a, b) in enumerate(zip(up, down, strict=True)):
            if v >= a:
                state[k] = 1.0
            elif v <= b:
                state[k] = -1.0
        out.append(sum(w * s for w, s in zip(weight, state, strict=True)))
    return np.array(out)


def fast(model, u):
    """Output by the columns of the compiled form: no compilation a shape."""
    A, index = features(model, u)
    return (A @ np.concatenate([model.w, model.slopes, model.b]))[index] + float(model.offset)


def single(model, u):
    return np.asarray(model.single_valued(jnp.asarray(u)))


# Inputs that hit levels and their mirror images, repeat, reverse fully and leave the levels: small whole numbers, later scaled.
@st.composite
def journeys(draw):
    n = 40
    picks = draw(st.lists(st.integers(-13, 13), min_size=1, max_size=n))
    return np.array(picks, dtype=float)


class TestTwoForms:
    @pytest.mark.parametrize("initial", RESTS)
    @settings(max_examples=40)
    @given(steps=journeys(), center=st.sampled_from([0.0, 1.5, -2.0]), seed=st.integers(0, 3))
    def test_relays_with_ties_equal_the_definition(self, initial, steps, center, seed):
        rng = np.random.default_rng(seed)
        levels = np.sort(rng.choice(np.arange(-10, 11), 6, replace=False)).astype(
            float
        )  # so that inputs fall on levels
        model = Preisach(w=rng.uniform(0, 1, 21), levels=levels, center=center, elements="relays", initial=initial)
        steps = np.resize(steps, 40)  # one shape, one compilation of the definition
        up, down = (np.asarray(t) for t in model.thresholds())
        expected = relay_loop(up, down, np.asarray(model.w), initial, center, steps)
        np.testing.assert_allclose(np.asarray(hf.simulate(model, steps)[0]), expected, atol=1e-12)
        A, index = features(model, steps)
        np.testing.assert_allclose((A @ np.asarray(model.w))[index], expected, atol=1e-12)

    @pytest.mark.parametrize(
        ("elements", "initial", "symmetric"), list(itertools.product(("cells", "relays"), RESTS, (False, True)))
    )
    def test_compiled_equals_the_scan(self, elements, initial, symmetric):
        rng = np.random.default_rng(5)
        model = make(elements, initial, 0.13, symmetric, 0)
        u = rng.uniform(-1.2, 1.2, 150) * np.linspace(0.1, 1, 150)
        levels = np.asarray(model.levels)
        ties = rng.integers(0, 150, 40)
        u[ties] = rng.choice(np.append(levels, 0.26 - levels), 40)
        u[50:60] = u[49]
        scan = np.asarray(hf.simulate(model, u)[0])
        np.testing.assert_allclose(model.free_run(u), scan, atol=1e-12)
        np.testing.assert_allclose(fast(model, u), scan, atol=1e-12)

    @pytest.mark.parametrize("initial", RESTS)
    def test_cells_are_the_limit_of_many_relays(self, initial):
        rng = np.random.default_rng(3)
        model = make("cells", initial, 0.1, False, 2, n=4)
        levels, (i, j) = np.asarray(model.levels), np.tril_indices(4)
        u = rng.uniform(-1, 1, 60)
        errors = []
        for fine in (10, 20):
            part = (np.arange(fine) + 0.5) / fine
            up, down, weight = [], [], []
            for row, column, mass in zip(i, j, np.asarray(model.w), strict=True):
                a, b = np.meshgrid(
                    levels[row] + part * np.diff(levels)[row],
                    levels[column] + part * np.diff(levels)[column],
                    indexing="ij",
                )
                below = a >= b
                up.append(a[below])
                down.append(b[below])
                weight.append(np.full(below.sum(), mass / below.sum()))
            args = (np.concatenate(up), np.concatenate(down), np.concatenate(weight))
            y = relay_loop(*args, initial, 0.1, u)
            errors.append(np.abs(fast(model, u) - single(model, u) - y).max())
        assert errors[1] < 0.6 * errors[0] < 0.3

    def test_gradients_of_the_two_forms_agree(self):
        model = make("cells", "demagnetized", 0.1, False, 1)
        u = np.random.default_rng(1).uniform(-1, 1, 40)

        def value(w):
            return jnp.sum(jnp.sin(hf.simulate(Preisach(w=w, levels=model.levels, center=0.1, depth=16), u)[0]))

        plain = Preisach(w=model.w, levels=model.levels, center=0.1)
        A, index = features(plain, u)
        by_columns = np.cos((A @ np.asarray(plain.w))[index]) @ A[index]
        np.testing.assert_allclose(by_columns, jax.grad(value)(model.w), atol=1e-12)

    @pytest.mark.parametrize(
        "kind",
        [
            "alone",
            "behind lags",
            pytest.param("others alone", marks=pytest.mark.slow),
            pytest.param("others", marks=pytest.mark.slow),
        ],
    )
    def test_free_runs_by_look_ups_equal_the_scan(self, kind):
        cells = make("cells", "negative", 0.0, False, 4)
        rng = np.random.default_rng(6)
        u, dt = rng.uniform(-1, 1, 80), rng.uniform(0.01, 0.1, 80)
        density = ParametricPreisach(levels=np.linspace(-1, 1, 9), slope=0.3)
        slow, resonance = hf.Relaxation(a=(0.1, 0.2), tau=(0.05, 0.5)), hf.SecondOrder(omega=20.0, zeta=0.2)
        models = {
            "alone": (cells, density),
            "others alone": (make("relays", "demagnetized", 0.1, True, 5), hf.Sum(cells, hf.Offset(2.0))),
            "behind lags": (hf.Series(hf.Delay(lag=1.5), hf.Lag(level=0.3), cells, resonance),),
            "others": (hf.Series(cells, slow), hf.Series(hf.Lag(), cells), hf.Series(slow, hf.Lag())),
        }[kind]
        for model in models:
            assert model.has_fast_run == (cells in getattr(model, "parts", (cells,)))
            np.testing.assert_allclose(model.free_run(u, dt), hf.simulate(model, u, dt)[0], atol=1e-12)

    def test_two_halves_equal_one_run(self):
        model = make("cells", "negative", 0.0, False, 4)
        u = np.random.default_rng(2).uniform(-1, 1, 100)
        whole = fast(model, u)
        first, stop = hf.simulate(model, u[:50])
        second, _ = hf.simulate(model, u[50:], resume=stop)
        np.testing.assert_allclose(np.concatenate([first, second]), whole, atol=1e-13)


class TestLaws:
    @settings(max_examples=30)
    @given(picks=st.lists(st.floats(-1, 1), min_size=3, max_size=12), peak=st.floats(1.0, 1.5))
    def test_wiping_out(self, picks, peak):
        model = make("cells", "demagnetized", 0.0, True, 7)
        tail = [0.2, -0.4, 0.1]
        long = fast(model, np.array([*picks, peak, -peak, *tail]))
        short = fast(model, np.array([peak, -peak, *tail]))
        np.testing.assert_allclose(long[-3:], short[-3:], atol=1e-12)

    def test_congruency(self):
        model = make("cells", "negative", 0.0, False, 8)
        branch = np.linspace(-0.3, 0.4, 30)
        before = ([0.9, -0.3], [0.6, -0.8, 0.7, -0.3])
        shapes = [fast(model, np.append(history, branch))[-30:] for history in before]
        # Cells alone: the single-valued part is the same on both.
        np.testing.assert_allclose(shapes[0] - shapes[0][0], shapes[1] - shapes[1][0], atol=1e-12)
        assert abs(shapes[0][0] - shapes[1][0]) > 0.01

    def test_output_of_cells_is_continuous_and_rises_with_the_input(self):
        model = make("cells", "demagnetized", 0.05, False, 9)
        model = Preisach(w=model.w, levels=model.levels, center=0.05)
        u = np.concatenate([np.linspace(0, 1, 4001), np.linspace(1, -1, 8001), np.linspace(-1, 0.7, 6801)])
        y = fast(model, u)
        du, dy = np.diff(u), np.diff(y)
        assert np.abs(dy).max() < 0.02 * np.ptp(y)
        assert (dy * np.sign(du) >= -1e-12).all()

    def test_symmetric_model_is_odd(self):
        model = make("cells", "demagnetized", 0.0, True, 10)
        model = Preisach(w=model.w, levels=model.levels, slopes=model.slopes, symmetric=True)
        u = np.random.default_rng(4).uniform(-1, 1, 50)
        np.testing.assert_allclose(fast(model, -u), -fast(model, u), atol=1e-12)

    def test_everett_of_uniform_density_is_the_triangle_area(self):
        levels = jnp.array([-1.0, -0.2, 0.1, 0.5, 1.0])
        i, j = np.tril_indices(4)
        width = np.diff(levels)
        mass = width[i] * width[j] * np.where(i == j, 0.5, 1.0)
        everett = Everett.of(jnp.asarray(mass), 4)
        rng = np.random.default_rng(6)
        low, high = np.sort(rng.uniform(-1, 1, (2, 50)), axis=0)
        got = everett(place(levels, jnp.asarray(high)), place(levels, jnp.asarray(low)))
        np.testing.assert_allclose(got, 0.5 * (high - low) ** 2, atol=1e-12)

    def test_memory_longer_than_its_depth_forgets_the_smallest_loops_only(self):
        deep = make("cells", "negative", 0.0, False, 11)
        shallow = Preisach(w=deep.w, levels=deep.levels, initial="negative", depth=8)
        deep = Preisach(w=deep.w, levels=deep.levels, initial="negative")
        u = np.array([(-0.9) ** k for k in range(40)])
        u = np.append(u, [1.0, -1.0, 0.3])
        exact, short = fast(deep, u), np.asarray(hf.simulate(shallow, u)[0])
        np.testing.assert_allclose(short[:7], exact[:7], atol=1e-12)
        assert np.abs(short[7:40] - exact[7:40]).max() > 1e-9  # small loops were forgotten
        np.testing.assert_allclose(short[-3:], exact[-3:], atol=1e-12)  # large ones are still known


def remembered(u, rest, center):
    """Dominant extrema before and at every sample, by a plain stack."""
    far = {"negative": -np.inf, "positive": np.inf}
    out, stack = [], []
    for v in u:
        while stack:
            other = stack[-2] if len(stack) > 1 else far.get(rest, 2 * center - stack[-1])
            if min(stack[-1], other) < v < max(stack[-1], other):
                break
            stack.pop()
        stack.append(v)
        out.append(tuple(stack))
    return out


class TestStaircase:
    @pytest.mark.parametrize("rest", RESTS)
    @pytest.mark.parametrize("kind", ["ties", "walk", "noise", "growing", "shrinking"])
    def test_many_reversals_at_once_equal_a_stack(self, rest, kind):
        for seed in range(4):
            rng, t = np.random.default_rng(seed), np.arange(400)
            u = {
                "ties": rng.integers(0, 9, 400),
                "walk": np.cumsum(rng.integers(-2, 3, 400)),
                "noise": 3 * np.sin(t / 30) + rng.normal(size=400),
                "growing": (-1.0) ** t * np.sort(np.abs(rng.normal(size=400))),
                "shrinking": (-1.0) ** t * np.sort(np.abs(rng.normal(size=400)))[::-1],
            }[kind]
            u = u - u.min() if kind == "walk" else u  # whole numbers are codes: none is negative
            stairs = compile_input(u, rest, 1.5)
            histories = []
            for value, node in zip(stairs.state_value, stairs.state_parent, strict=True):
                history = [value]
                while node >= 0:
                    history.append(stairs.node_value[node])
                    node = stairs.node_parent[node]
                histories.append(tuple(history[::-1]))
            expected = remembered(u.tolist(), rest, 1.5)
            assert [histories[k] for k in stairs.index] == expected
            # Every node and state once.
            assert len(set(histories)) == len(histories)
            assert len(set(zip(stairs.node_parent.tolist(), stairs.node_value.tolist(), strict=True))) == (
                stairs.node_value.size
            )

    def test_states_of_a_periodic_input_do_not_grow(self):
        u = np.tile(np.sin(np.linspace(0, 2 * np.pi, 100, endpoint=False)), 20)
        stairs = compile_input(np.round(u, 6), "negative")
        assert stairs.state_value.size < 250
        assert stairs.index.size == 2000

    def test_layers_count_the_ancestors(self):
        u = np.array([(-0.95) ** k for k in range(30)])
        stairs = compile_input(u, "demagnetized")
        steps, node = np.zeros(stairs.node_parent.size), np.arange(stairs.node_parent.size)
        while (node >= 0).any():
            steps, node = steps + (node >= 0), np.where(node >= 0, stairs.node_parent[node], -1)
        layers = np.zeros(steps.size)
        for number, layer in enumerate(stairs.layers(), start=1):
            layers[layer] = number
        np.testing.assert_array_equal(steps, layers)
        assert stairs.depth == layers.max() == 30


class TestBadInput:
    @pytest.mark.parametrize(
        ("options", "words"),
        [
            ({"w": np.ones(3), "levels": [0.0, 1.0]}, "have 1 weights"),
            ({"w": np.ones(3), "levels": [0.0, 2.0, 1.0]}, "rise strictly"),
            ({"w": np.ones(2), "levels": [-1.0, 0.1, 1.0], "symmetric": True}, "symmetric about its center"),
            ({"w": np.ones(1), "levels": [0.0, 1.0], "slopes": np.ones(4)}, "slopes must have"),
            ({"w": np.ones(1), "levels": [0.0, 1.0], "depth": 1}, "depth"),
        ],
    )
    def test_what_is_wrong_is_said(self, options, words):
        with pytest.raises(ModelError, match=words):
            Preisach(**options)

    def test_odd_symmetric_cells_are_refused(self):
        with pytest.raises(ModelError, match="even n"):
            Preisach.of(5, symmetric=True)

    def test_advice_says_where_the_input_leaves_the_levels(self):
        model = make("cells", "negative", 0.0, False, 1)
        assert model.advice(np.linspace(model.levels[0], model.levels[-1], 10)) == ()
        (words,) = model.advice(np.array([0.0, 2.0, 3.0]))
        assert "at 2 of 3 samples" in words
