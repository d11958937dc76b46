"""Preisach models from data: weights, reversal curves, tables, densities, and the properties they presume."""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.interpolate
import scipy.optimize
from hypothesis import given, settings
from hypothesis import strategies as st

import hystfit as hf
from hystfit.data.record import Record
from hystfit.errors import DataError, ModelError
from hystfit.fitting.judgment.covariance import uncertainty
from hystfit.fitting.solvers.smooth_weights import SmoothWeights
from hystfit.inference.problem import Problem
from hystfit.models.preisach import (
    EverettTable,
    check_preisach,
    forc_diagram,
    higher_order,
    smooth,
    stack_inverse,
)
from hystfit.models.preisach.design_matrix import features
from hystfit.models.preisach.everett import cells, second_differences
from hystfit.models.preisach.levels import sharp_levels, steep_levels
from hystfit.models.preisach.model import Preisach
from hystfit.models.preisach.parametric import ParametricPreisach
from hystfit.models.preisach.properties import CONGRUENCY, HIGHER_ORDER, WIPING_OUT, error_by_order, through, wiping_out
from hystfit.models.preisach.signed import SignedPreisach
from hystfit.models.preisach.smooth import SMOOTHNESS, _Trials, fit_smooth
from hystfit.models.preisach.smooth_system import SmoothSystem
from hystfit.models.shared.nonnegative import solve_nonnegative
from hystfit.quality.reversal_curves import recognize_family


def weights_alone(strength):
    """The method for smooth weights with one strength of the penalty."""
    return SmoothWeights(smoothness=(strength,))


def output(model, u):
    A, index = features(model, u)
    return (A @ np.concatenate([model.w, model.slopes, model.b]))[index] + float(model.offset)


def bell(levels, h0=0.35, size=0.2):
    """Masses of a smooth density in the cells between levels."""
    middle = 0.5 * (levels[1:] + levels[:-1])
    i, j = np.tril_indices(middle.size)
    h, m = 0.5 * (middle[i] - middle[j]), 0.5 * (middle[i] + middle[j])
    return np.exp(-0.5 * ((h - h0) / size) ** 2 - 0.5 * (m / size) ** 2)


def truth(initial="demagnetized", n=12, kind=Preisach):
    levels = np.linspace(-1, 1, n + 1)
    return kind(w=bell(levels), levels=levels, initial=initial, spacing="given")


class TestSmoothing:
    """Penalties on second differences of the density, beside a plain loop over cells, and on loops left out."""

    @pytest.mark.parametrize("symmetric", [False, True])
    def test_equals_a_plain_loop(self, symmetric):
        n = 6
        i, j = cells(n)
        density = np.random.default_rng(3).uniform(size=(n, n))
        if symmetric:
            density = density + density[::-1, ::-1].T  # cell (i, j) has its mirror image in (n - 1 - j, n - 1 - i)
        stiffness = {(1, 0): 1.0, (0, 1): 1.0} | ({(1, -1): 4.0} if symmetric else {})
        expected = 0.0
        for (di, dj), factor in stiffness.items():
            for a, b in itertools.product(range(n), range(n)):
                line = [(a + k * di, b + k * dj) for k in (-1, 0, 1)]
                if all(0 <= q <= p < n for p, q in line):
                    before, at, after = (density[place] for place in line)
                    expected += factor * (before - 2 * at + after) ** 2
        mass = density[i, j] * np.where(symmetric & (i == j), 0.5, 1.0)
        tied = [k for k in range(i.size) if (i[k], j[k]) <= (n - 1 - j[k], n - 1 - i[k])] if symmetric else slice(None)
        rough = second_differences(n, symmetric) @ mass[tied]
        assert rough @ rough == pytest.approx(expected, rel=1e-12)


class TestNonnegative:
    @settings(max_examples=40)
    @given(seed=st.integers(0, 10_000), rows=st.integers(5, 30), p=st.integers(1, 12), free=st.integers(0, 3))
    def test_equals_a_bounded_solver(self, seed, rows, p, free):
        rng = np.random.default_rng(seed)
        M, y = rng.normal(size=(rows, p)), rng.normal(size=rows)
        bounded = np.arange(p) >= free
        A = M.T @ M + 1e-3 * np.eye(p)
        w, _ = solve_nonnegative(A, M.T @ y, bounded)
        joint = np.vstack([M, np.sqrt(1e-3) * np.eye(p)]), np.append(y, np.zeros(p))
        expected = scipy.optimize.lsq_linear(*joint, bounds=(np.where(bounded, 0, -np.inf), np.inf), tol=1e-14).x
        cost = lambda w: 0.5 * w @ A @ w - w @ M.T @ y
        assert cost(w) <= cost(expected) + 1e-8
        assert (w[bounded] >= 0).all()


def measured(errors: tuple[float, ...], likely: float | None, *, bounded: bool = True) -> _Trials:
    """Trials whose errors on held-out groups are given, by `SMOOTHNESS`."""
    strength = likely

    class Measured(_Trials):
        likely = strength

        def __init__(self):
            self._bounded = np.full(3, bounded)

        def solved(self, strength):
            pass

        def fitted(self, strength):
            return 0.5 * min(errors)  # rules out none

        def bar(self, strength, most):
            return most

        def error(self, strength, *, refitted, most):
            found = errors[SMOOTHNESS.index(strength)]
            return found if found <= most else np.inf

    return Measured()


class TestWeights:
    def test_rich_input_gives_back_the_weights(self):
        model = truth("negative")
        u = hf.signals.random_reversals(duration=400, rate=20, speed=1.0, seed=1)[1]
        record = Record(u, output(model, u))
        fit = hf.fit(model, record, method=weights_alone(1e-14), fix={"offset": 0.0})
        assert fit.train.nrmse_percent < 1e-4
        seen = SmoothSystem.of([model.design_matrix(u)], [record]).reach[: model.w.size] > 0.5
        assert seen.sum() > 60
        np.testing.assert_allclose(np.asarray(fit.model.w)[seen], np.asarray(model.w)[seen], atol=5e-3)

    @pytest.mark.parametrize("symmetric", [False, True])
    def test_levels_are_dense_where_a_saturating_loop_switches(self, symmetric):
        """A hard magnet that switches within 3 % of the fields: evenly spread levels miss its coercivity."""
        field = np.concatenate([np.linspace(1, -1, 201), np.linspace(-1, 1, 201)[1:]])
        sign = np.append(np.ones(201), -np.ones(200))
        record = Record(field, np.tanh(30 * (field + 0.1 * sign)) + 0.1 * field)
        fits = {
            name: hf.fit(Preisach.of(12, spacing=name, symmetric=symmetric), record, method=weights_alone(1e-6))
            for name in ("square" if symmetric else "quantile", "uniform", "steep")
        }
        errors = [fit.train.nrmse_percent for fit in fits.values()]
        assert errors[-1] < 0.3 * min(errors[:-1])
        levels = np.asarray(fits["steep"].model.levels)
        assert (levels[0], levels[-1]) == (-1.0, 1.0)
        relays, _ = steep_levels([record], 9, 0.0 if symmetric else None, relays=True)
        assert relays.size == 9
        assert -1 < relays[0] < relays[-1] < 1

    def test_a_steady_cycle_without_history_is_fitted_from_the_state_after_a_cycle(self):
        """One period that begins at zero field, on a branch and not in the demagnetized state."""
        model, period = truth(), np.sin(np.linspace(0, 2 * np.pi, 121))
        record = Record(period, output(model, np.tile(period, 3))[-121:])
        systems = [SmoothSystem.of([model.design_matrix(r.u)], [r]) for r in (record, record.repeating())]
        errors = [np.sqrt(fit_smooth(system, [1e-14]).rss / len(record)) for system in systems]
        assert errors[0] > 0.01 * np.ptp(record.y)
        assert errors[1] < 1e-4 * np.ptp(record.y)
        with pytest.raises(DataError, match="not a period of a cycle"):
            Record(period[:90], period[:90]).repeating()

    def test_cells_that_the_data_never_switched_are_told(self):
        model = truth("negative")
        u = np.concatenate([np.linspace(-1, 0, 50), np.linspace(0, -1, 50)])
        system = SmoothSystem.of([model.design_matrix(u)], [Record(u, output(model, u))])
        i, _ = np.tril_indices(12)
        np.testing.assert_array_equal(system.reach[: model.w.size] < 1e-9, i >= 6)  # cells above u = 0
        assert "never switched" in " ".join(system.notes())

    @pytest.mark.parametrize(("n", "symmetric", "states"), [(6, False, 100), (4, True, 100), (16, False, 1000)])
    @pytest.mark.parametrize("level", [0.0, 1e6])
    def test_distinct_states_give_the_normal_equations_of_all_samples(self, level, n, symmetric, states):
        """Of few states as of many, more than weights, whose rows are multiplied as sums of triangles."""
        rng = np.random.default_rng(3)
        model = Preisach.of(n, initial="negative", spacing="given", symmetric=symmetric)
        u = np.tile(np.round(np.sin(np.linspace(0, 6, states)) * np.linspace(1, 0.4, states), 3), 3)
        record = Record(u, level + rng.normal(size=u.size), weight=rng.integers(0, 3, u.size))
        system = SmoothSystem.of([model.design_matrix(u)], [record])
        A, index = features(model, u)
        # The equations are those of the distance from an output's level where that is far from zero.
        middle = np.mean(record.y[record.used]) / system.size if level else 0.0
        assert system.origin == pytest.approx([0.0] * A.shape[1] + [middle])
        y = record.y / system.size - middle
        joint = np.column_stack([A[index], np.ones(u.size), y]) * np.sqrt(record.weight)[:, None]
        np.testing.assert_allclose(system.grams.sum(axis=0), joint.T @ joint, atol=1e-6 if level else 1e-9)
        assert system.visited[0][0].shape[0] < np.unique(index[record.used]).size
        span = np.ptp(A[np.unique(index[record.used])], axis=0)[: model.w.size]
        np.testing.assert_allclose(
            system.reach[: model.w.size], span / (2 * model.design_matrix(u).blocks[0].penalty.cells), atol=1e-12
        )
        assert system.counts.sum() == record.weight.sum()

    @pytest.mark.parametrize(
        "errors",
        [
            (
                1.847,
                1.562,
                1.622,
                0.599,
                0.673,
                0.673,
                0.589,
                0.283,
                0.086,
            ),  # three centered loops, 40 cells along each axis
            (290.8, 43.05, 4.049, 1.400, 1.577, 1.473, 0.993, 0.309, 0.088),  # the same with masses of either sign
            (2.562, 1.566, 0.981, 0.784, 0.694, 0.384, 0.129, 0.296, 0.424),  # the same with symmetric cells
        ],
    )
    @pytest.mark.parametrize("strength", [None, SMOOTHNESS[0], SMOOTHNESS[4]])
    def test_the_smoothness_is_the_best_of_all_where_weak_ones_have_minima_of_their_own(self, errors, strength):
        assert min(measured(errors, strength).left_out(SMOOTHNESS, refitted=True)) == min(errors)

    def test_a_likely_smoothness_is_not_forgotten_behind_a_minimum_of_stronger_ones(self):
        errors = (0.1, 0.2, 0.8, 0.85, 0.9, 0.6, 0.4, 0.5, 0.7)
        found = measured(errors, SMOOTHNESS[0], bounded=False).left_out(SMOOTHNESS, refitted=True)
        assert int(np.argmin(found)) == 0
        assert not np.isfinite(found[2:]).any()  # none of these was finished

    @pytest.mark.parametrize("kind", [Preisach, SignedPreisach])
    def test_groups_are_solved_until_the_error_is_above_what_is_asked(self, monkeypatch, kind):
        model = truth("negative", n=6, kind=kind)
        u = hf.signals.random_reversals(duration=60, rate=20, speed=1.0, seed=2)[1]
        y = output(model, u) + 0.05 * np.random.default_rng(1).normal(size=u.size)
        system = SmoothSystem.of([model.design_matrix(u)], [Record(u, y)])
        fixed, strength = np.full(system.roughness.shape[0], np.nan), 1e-3
        whole = _Trials(system, fixed).error(strength, refitted=True)
        solved, solve = [], smooth._solve
        monkeypatch.setattr(smooth, "_solve", lambda *args: solved.append(1) or solve(*args))
        trials, groups = _Trials(system, fixed), system.counts.size - 1
        assert trials.error(strength, refitted=True, most=0.5 * whole) == np.inf
        assert len(solved) < 1 + groups
        assert trials.error(strength, refitted=True, most=0.4 * whole) == np.inf  # as it is known to be
        assert len(solved) < 1 + groups
        assert trials.error(strength, refitted=True, most=1.01 * whole) == whole
        held, bar = system.counts[:-1].sum(), trials.bar(strength, whole)
        every = bar**2 * held + trials.fitted_squares(strength, slice(-1, None))
        assert min(bar, np.sqrt(every / system.counts.sum())) == pytest.approx(whole)

    def test_of_equal_errors_on_scattered_samples_the_strongest_penalty_wins(self):
        """Every error by a plain solve of each group of samples; samples of a single loop do not tell weak penalties apart."""
        u = np.cos(np.linspace(0, 2 * np.pi, 161))
        y = np.tanh(3 * (u - 0.3 * np.sign(np.gradient(-u)))) + 0.003 * np.random.default_rng(0).normal(size=u.size)
        record = Record(u, y)
        model = SignedPreisach.of(16, initial="positive").start([record])
        system = SmoothSystem.of([model.design_matrix(u)], [record])
        total, count, errors = system.grams.sum(axis=0), system.counts.sum(), []
        for strength in SMOOTHNESS:
            squares = 0.0
            for own, samples in zip(system.grams[:-1], system.counts[:-1], strict=True):
                others = total - own
                A = others[:-1, :-1] + strength * (count - samples) * system.roughness
                A += 1e-12 * np.trace(A) / len(A) * np.eye(len(A))
                r = np.append(-np.linalg.solve(A, others[:-1, -1]), 1.0)
                squares += r @ own @ r
            errors.append(np.sqrt(squares / system.counts[:-1].sum()))
        equal = np.flatnonzero(np.array(errors) <= 1.01 * min(errors))
        assert equal.size > 1
        fit = fit_smooth(system)
        assert fit.smoothness == SMOOTHNESS[equal[-1]]
        assert fit.error == pytest.approx(errors[equal[-1]])
        assert SMOOTHNESS[int(np.argmin(errors))] < fit.smoothness  # which the smallest error alone would choose

    def test_held_parameters_stay_and_the_others_fit_around_them(self):
        model = truth("negative", n=6)
        u = hf.signals.random_reversals(duration=60, rate=20, speed=1.0, seed=2)[1]
        system = SmoothSystem.of([model.design_matrix(u)], [Record(u, output(model, u) + 0.7)])
        held = np.full(system.roughness.shape[0], np.nan)
        held[-1] = 0.7
        fit = fit_smooth(system, [1e-12], fixed=held)
        assert fit.weights[-1] == 0.7
        assert fit.rss / system.counts.sum() < 1e-8 * system.size**2

    def test_hystfit_fit_serves_the_model(self):
        model = truth("negative", n=6)
        u = hf.signals.random_reversals(duration=60, rate=20, speed=1.0, seed=2)[1]
        flat = Preisach(w=np.ones(21), levels=model.levels, initial="negative")
        result = hf.fit(flat, Record(u, output(model, u)))
        assert result.train.nrmse_percent < 0.3
        assert np.asarray(result.model.w).std() > 0.1

    def test_fewer_samples_than_weights_are_fitted(self):
        u = np.sin(np.linspace(0, 12, 60)) * np.linspace(1, 0.3, 60)
        result = hf.fit(Preisach.of(12), Record(u, output(truth(), u)))
        assert len(result.free_names) > 60
        assert result.train.nrmse_percent is not None
        assert result.train.nrmse_percent < 3

    def test_the_noise_of_few_samples_is_that_which_was_added(self):
        """A penalty holds more weights together than there are samples: counting each would leave one degree of freedom."""
        u = -np.cos(np.linspace(0, 2 * np.pi, 160))
        clean, sd = output(truth("negative", n=60), u), 0.004
        clean = clean / np.ptp(clean)
        rng = np.random.default_rng(8)
        fits = [hf.fit("preisach:n=30", Record(u=u, y=clean + sd * rng.normal(size=u.size))) for _ in range(4)]
        assert fits[0].model.w.size > u.size
        np.testing.assert_allclose(np.sqrt(np.mean([fit.sigma**2 for fit in fits])), sd, rtol=0.15)


def family(model, count=25, points=60):
    """Curves that rise from reversal points to saturation."""
    curves = []
    for k, start in enumerate(np.linspace(0.9, -1, count)):
        u = np.linspace(start, 1.0, points)
        curves.append(Record(u, output(model, u), name=f"curve {k}"))
    return curves


class TestReversalCurves:
    def test_other_curves_are_predicted(self):
        curves = family(truth("positive"))
        fit = hf.fit("preisach-forc:n=20", curves[::2])
        y = np.concatenate([r.y for r in curves[1::2]])
        error = np.concatenate([fit.predict(r) for r in curves[1::2]]) - y
        assert np.sqrt(np.mean(error**2)) < 0.01 * np.ptp(y)

    def test_diagram_peaks_where_the_density_does(self):
        diagram = forc_diagram(family(truth("positive", n=30), 60, 120), smoothing=3)
        at = np.unravel_index(np.nanargmax(diagram.density), diagram.density.shape)
        assert diagram.coercivity[at] == pytest.approx(0.35, abs=0.08)
        assert diagram.interaction[at] == pytest.approx(0.0, abs=0.08)

    def test_diagram_of_a_quadratic_is_its_mixed_derivative(self):
        curves = [
            Record(np.linspace(a, 1, 80), 3.0 * a * np.linspace(a, 1, 80), name=f"{a:g}")
            for a in np.linspace(-1, 0.8, 30)
        ]
        density = forc_diagram(curves).density
        np.testing.assert_allclose(density[np.isfinite(density)], -1.5, rtol=1e-6)

    def test_samples_that_do_not_count_are_no_part_of_a_curve(self):
        # A calibration point at saturation stands before each curve of a magnetometer's file; the first curve has one sample.
        curves = [
            r.replace(u=np.append(1.0, r.u), y=np.append(r.y[-1], r.y), weight=np.append(0.0, np.ones(r.u.size)))
            for r in family(truth("positive"), 12)
        ]
        dot = Record(
            np.array([1.0, 0.95]), output(truth("positive"), np.array([1.0, 0.95])), weight=np.array([0.0, 1.0])
        )
        found = recognize_family([dot, *curves])
        assert found is not None
        assert found.rising
        assert len(found.curves) == 12
        np.testing.assert_array_equal(found.curves[0].u, curves[0].u[1:])
        plain, counted, more = (
            hf.fit("preisach-forc:n=6", data, method=weights_alone(1e-4))
            for data in (family(truth("positive"), 12), curves, [dot, *curves])
        )
        np.testing.assert_allclose(counted.model.w, plain.model.w, atol=1e-9)
        assert more.usable
        assert more.train.n == plain.train.n + 1

    def test_falling_curves_are_rising_ones_turned_over(self):
        rising = family(truth("positive"), 12)
        falling = [r.replace(u=-r.u, y=-r.y) for r in rising]
        found = recognize_family(falling)
        assert found is not None
        assert not found.rising
        one, other = (hf.fit("preisach-forc:n=8", f, method=weights_alone(1e-4)) for f in (rising, falling))
        assert other.model.initial == "negative"
        u = np.linspace(-0.5, 0.9, 50)
        np.testing.assert_allclose(other.model.free_run(-u), -one.model.free_run(u), atol=5e-4 * np.ptp(rising[-1].y))

    def test_loops_are_no_family(self):
        curves = family(truth("positive"), 12)
        assert recognize_family(curves[:4]) is None
        assert recognize_family([r.segment(0, 20) for r in curves]) is None  # they end before the first one's reversal
        assert (
            recognize_family([Record(np.sin(np.arange(50.0)), np.arange(50.0), name=str(k)) for k in range(6)]) is None
        )

    def test_relays_take_equal_shares_of_the_output(self):
        # y = u^2: its slope has equal shares between the roots of equal parts.
        u = np.linspace(0, 1, 20001)
        np.testing.assert_allclose(
            sharp_levels([(u, 2 * u)], 8, power=1.0, even=0.0), np.sqrt(np.arange(9) / 8), atol=2e-3
        )
        np.testing.assert_allclose(
            sharp_levels([(u, 2 * u)], 8, power=0.5, even=0.0), (np.arange(9) / 8) ** (2 / 3), atol=2e-3
        )

    @pytest.mark.slow
    def test_a_family_is_recognized_and_has_one_constant(self):
        curves = family(truth("positive"), 14)
        result = hf.fit(Preisach.of(8, spacing="reversal-curves"), curves)
        assert result.usable
        assert "14 first-order reversal curves" in " ".join(map(str, result.notes))
        assert [p.name for p in result.parameters if p.name.startswith("offset")] == ["offset"]
        blind = hf.fit(Preisach.of(8), curves)
        assert blind.status == "no-loop"
        assert "preisach-forc" in str(blind.notes[0])

    def test_standard_errors_are_those_of_a_regression_with_one_constant(self):
        """Reversal curves come from one state: a constant for each would absorb their differences, and errors would be too large."""
        rng = np.random.default_rng(4)
        curves = [r.replace(y=r.y + 1e-3 * rng.normal(size=len(r))) for r in family(truth("positive"), 14)]
        unpenalized = SmoothWeights(smoothness=(1e-14,))
        result = hf.fit(SignedPreisach.of(5, spacing="reversal-curves"), curves, method=unpenalized, noise="iid")
        rows = []
        for record in result.data:
            A, index = features(result.model, record.u)
            rows.append(np.column_stack([A, np.ones(len(A))])[index][record.used])
        expected = result.sigma * np.sqrt(np.diag(np.linalg.inv(np.concatenate(rows).T @ np.concatenate(rows))))
        known = [(p.stderr, e) for p, e in zip(result.parameters, expected, strict=False) if p.stderr is not None]
        assert len(known) > 10
        np.testing.assert_allclose(*np.transpose(known), rtol=1e-4)

    def test_bad_families_are_told(self):
        curves = family(truth("positive"), 6)
        with pytest.raises(DataError, match="two reversal curves or more"):
            hf.fit("preisach-forc:n=4", curves[:1])
        turned = curves[0].replace(u=np.append(curves[0].u[:-1], curves[0].u[0]))
        with pytest.raises(DataError, match="reverses at sample"):
            hf.fit("preisach-forc:n=4", [turned, *curves[1:]])
        falling = curves[1].replace(u=curves[1].u[::-1], y=curves[1].y[::-1])
        with pytest.raises(DataError, match="rise and the others fall"):
            hf.fit("preisach-forc:n=4", [curves[0], falling])
        back = np.append(curves[0].u, np.linspace(1.0, 0.95, 20)[1:])
        slowly = curves[0].replace(u=back, y=np.interp(back, curves[0].u, curves[0].y), weight=np.ones(back.size))
        with pytest.raises(DataError, match="reverses at sample 59"):
            hf.fit("preisach-forc:n=4", [slowly, *curves[1:]])
        crossing = [r.replace(y=r.y + (40 if k == 3 else 0)) for k, r in enumerate(curves)]
        notes = " ".join(map(str, hf.fit("preisach-forc:n=4", crossing, method=weights_alone(1e-3)).notes))
        assert "cross" in notes
        assert "do not close" in notes


def interpolated(table, alpha, beta):
    """X by eqs. (4) and (5) of Song et al. 2005: bilinear in a rectangle, linear in a triangle on the diagonal."""
    levels, X = table.levels, table.X
    i, j = (int(np.clip(np.searchsorted(levels, u, side="right") - 1, 0, levels.size - 2)) for u in (alpha, beta))
    p, q = ((u - levels[k]) / (levels[k + 1] - levels[k]) for u, k in ((alpha, i), (beta, j)))
    if i == j:
        return max(p - q, 0.0) * X[i + 1, i]
    return (1 - p) * ((1 - q) * X[i, j] + q * X[i, j + 1]) + p * ((1 - q) * X[i + 1, j] + q * X[i + 1, j + 1])


def outputs(table, u):
    """Output of the model of a table."""
    return hf.TabulatedPreisach.from_table(table).free_run(u)


def plain_table_output(table, u):
    """Eqs. (2) and (3) with lists of alternating extrema."""
    out, extrema = [], [table.levels[0]]
    for v in u:
        kept = list(extrema)
        while len(kept) > 1 and not min(kept[-2:]) < v < max(kept[-2:]):
            kept.pop()
        extrema = [*kept, v]
        total = 0.0
        for a, b in itertools.pairwise(extrema):
            total += np.sign(b - a) * interpolated(table, max(a, b), min(a, b))
        out.append(total)
    return table.base + np.array(out)


class TestPictures:
    def test_axes_show_what_was_asked(self):
        matplotlib = pytest.importorskip("matplotlib")
        matplotlib.use("Agg")
        from hystfit.results.preisach_plots import plot_curves, plot_density, plot_forc_diagram

        curves = family(truth("positive"), 12)
        model = truth("positive")
        cells_untouched = np.arange(model.w.size) < 5
        ax = plot_density(model, reach=1.0 - cells_untouched)
        assert len(ax.patches) == 5  # one hatched cell each
        assert ax.get_xlabel().endswith("beta")
        drawn = ax.collections[0].get_array()
        i, j = np.tril_indices(12)
        area = np.where(i == j, 0.5, 1.0) / 36
        np.testing.assert_allclose(drawn[i, j], np.asarray(model.w) / area)
        diagram = forc_diagram(curves, 2)
        picture = plot_forc_diagram(diagram).collections[0]
        shown, corners = picture.get_array(), picture.get_coordinates()
        at = np.unravel_index(np.argmax(shown), shown.shape)
        top = np.unravel_index(np.nanargmax(diagram.density), diagram.density.shape)
        assert corners[at].tolist() == pytest.approx([diagram.coercivity[top], diagram.interaction[top]], abs=0.1)
        assert shown.max() == pytest.approx(np.nanmax(diagram.density), rel=0.05)
        lines = plot_curves(curves, [r.y for r in curves], every=3).lines
        assert len(lines) == 8
        matplotlib.pyplot.close("all")


class TestEverettTable:
    levels = np.linspace(0, 180, 13)

    def table(self):
        return EverettTable.from_masses(self.levels, np.random.default_rng(1).uniform(0, 1, 78), base=2.0)

    def test_masses_and_table_are_inverse(self):
        masses = np.random.default_rng(1).uniform(0, 1, 78)
        np.testing.assert_allclose(self.table().masses(), masses, atol=1e-12)

    def test_output_equals_a_plain_stack(self):
        u = np.random.default_rng(2).uniform(0, 180, 80)
        np.testing.assert_allclose(outputs(self.table(), u), plain_table_output(self.table(), u), atol=1e-11)

    def test_output_equals_the_model_off_the_diagonal(self):
        i, j = np.tril_indices(12)
        masses = np.where(i == j, 0.0, np.random.default_rng(1).uniform(0, 1, 78))
        model = Preisach(w=masses, levels=self.levels, initial="negative")
        u = np.append(0.0, np.random.default_rng(2).uniform(0, 180, 50))
        y = output(model, u)
        np.testing.assert_allclose(outputs(EverettTable.from_masses(self.levels, masses), u), y - y[0], atol=1e-11)

    def test_curves_give_the_table_back(self):
        table, curves = self.table(), []
        for peak in self.levels[1:]:
            u = np.concatenate([np.linspace(0, peak, 200), np.linspace(peak, 0, 200)])
            curves.append(Record(u, outputs(table, u), name=f"{peak:g} V"))
        found = EverettTable.from_descending(curves, self.levels)
        np.testing.assert_allclose(found.X, table.X, atol=0.02 * table.X.max())
        u = through(HIGHER_ORDER)
        np.testing.assert_allclose(outputs(found, u), outputs(table, u), atol=0.02 * np.ptp(outputs(table, u)))

    def test_monotone_tables_are_projections(self):
        rng = np.random.default_rng(3)
        table = self.table()
        noisy = EverettTable(self.levels, table.X + rng.normal(0, 1.0, table.X.shape))
        lower = np.tril_indices(12)
        monotone, moved = noisy.monotone()
        assert np.diff(monotone.X, axis=0)[lower].min() >= -1e-9
        assert np.diff(monotone.X, axis=1)[1:][lower].max() <= 1e-9
        # Nothing monotone is nearer than the projection: not the truth either.
        assert np.sum((monotone.X - noisy.X) ** 2) <= np.sum((table.X - noisy.X)[np.tril_indices(13, -1)] ** 2)
        change = (monotone.X - noisy.X)[np.tril_indices(13, -1)] / np.abs(noisy.X).max()
        assert (moved.rms, moved.largest) == pytest.approx(
            (100 * np.sqrt(np.mean(change**2)), 100 * np.abs(change).max())
        )
        assert 0 < moved.nodes < change.size
        assert monotone.monotone()[1].largest < 1e-6

    def test_steps_the_wrong_way_are_measured(self):
        assert self.table().turned().max() <= 1e-9
        X = np.array([[0, 0, 0], [1.0, 0, 0], [0.5, 0.2, 0]])
        turned = EverettTable(np.arange(3.0), X).turned()
        assert turned.size == 6
        assert turned[turned > 0].tolist() == [0.5]  # from X[1, 0] to X[2, 0]
        assert EverettTable(np.arange(3.0), X).monotone()[0].turned().max() <= 1e-9
        with pytest.raises(DataError, match="1 of its values are not"):
            EverettTable(np.arange(3.0), np.where(X == 0.2, np.nan, X))
        with pytest.raises(DataError, match="3 levels has shape"):
            EverettTable(np.arange(3.0), X[:2, :2])

    def test_unreached_levels_are_refused(self):
        u = np.concatenate([np.linspace(0, 90, 50), np.linspace(90, 0, 50)])
        with pytest.raises(DataError, match="never reached"):
            EverettTable.from_descending([Record(u, u)], self.levels)


class TestTabulatedPreisach:
    levels = np.linspace(0, 180, 7)

    def table(self):
        return EverettTable.from_masses(self.levels, np.random.default_rng(1).uniform(0, 1, 21), base=2.0)

    def curves(self, noise: float = 0.0):
        u = np.concatenate([np.append(np.arange(peak), np.arange(peak, 0, -1)) for peak in self.levels[1:]] + [[0.0]])
        return Record(u, outputs(self.table(), u) + noise * np.random.default_rng(2).normal(size=u.size))

    def test_it_is_the_interpolated_table(self):
        """Rectangles by scipy's bilinear interpolation, triangles by the plane through their corners; sums by a plain stack."""
        table, rng = self.table(), np.random.default_rng(3)
        model = hf.TabulatedPreisach.from_table(table)
        grid = scipy.interpolate.RegularGridInterpolator((self.levels, self.levels), table.X)
        for alpha, beta in np.sort(rng.uniform(0, 180, (60, 2)))[:, ::-1]:
            i, j = int(alpha // 30), int(beta // 30)
            corner = table.X[i + 1, i] * (alpha - beta) / 30
            expected = corner if i == j else float(grid((alpha, beta)))
            assert interpolated(table, alpha, beta) == pytest.approx(expected, abs=1e-11)
            assert output(model, np.array([0.0, alpha, beta])) @ [0, 1, -1] == pytest.approx(expected, abs=1e-11)
        u = np.append(0.0, rng.uniform(0, 180, 80))
        np.testing.assert_allclose(output(model, u), plain_table_output(table, u), atol=1e-11)
        np.testing.assert_allclose(model.table().X, table.X, atol=1e-12)

    def test_a_fit_reads_the_curves_and_its_inverse_gives_the_input_back(self):
        result = hf.fit("everett-table:n=6", self.curves())
        assert result.method == "everett-table"
        np.testing.assert_allclose(result.model.table().X, self.table().X, atol=1e-9)
        u = through(HIGHER_ORDER)
        y = plain_table_output(self.table(), u)
        np.testing.assert_allclose(output(result.model, u), y, atol=1e-8)
        found = hf.invert(result, y)
        assert found.counts()["ok"] == u.size
        np.testing.assert_allclose(found.u, u, atol=1e-6)

    def test_noise_is_moved_until_the_table_has_an_inverse(self):
        noisy = EverettTable.from_descending([self.curves(2.0)], self.levels)
        assert noisy.turned().max() > 0.01
        model = hf.fit("everett-table:n=6", self.curves(2.0)).model
        assert model.table().turned().max() < 1e-9
        y = output(model, through((0, 150, 60, 120, 0)))
        assert hf.invert(model, y).counts()["not-monotone"] == 0

    @pytest.mark.parametrize(("fall", "rises"), [(0.0, True), (2**-50, True), (1e-9, False)])
    def test_a_flat_part_of_the_output_rises_but_for_rounding(self, fall, rises):
        """Outputs of a few units on a part without relays, which sums of cells give within some machine epsilons."""
        y = jnp.array([3.75, 3.75, 3.75 - fall])
        one = jnp.array(1.0)
        assert bool(stack_inverse._quadratic(lambda u: y, one, 0 * one, one, 3.75 * one, 4 * one).rising) == rises

    def test_other_records_are_refused(self):
        u = through((0, 150, 60, 120, 0))
        with pytest.raises(DataError, match="reverses between 0 and its peak 150"):
            hf.fit("everett-table:n=4", Record(u, outputs(self.table(), u)))
        with pytest.raises(ModelError, match="method='auto' for other models"):
            hf.fit(hf.Preisach.of(3, initial="negative"), self.curves(), method="everett-table")
        with pytest.raises(ModelError, match="use preisach in compositions"):
            hf.fit("everett-table:n=6+offset", self.curves())
        with pytest.raises(ModelError, match=r"w\[3\] is fixed"):
            hf.fit("everett-table:n=6", self.curves(), fix={"w[3]": 0.1})


class TestProperties:
    table = EverettTable.from_masses(np.linspace(0, 180, 37), bell(np.linspace(-1, 1, 37)))

    def test_wiping_out_signals_end_alike(self):
        long, short = (outputs(self.table, through(extrema)) for extrema in WIPING_OUT)
        np.testing.assert_allclose(long[-101:], short[-101:], atol=1e-12)

    def test_a_preisach_device_passes_and_another_does_not(self):
        u = through(CONGRUENCY, 200)
        y = outputs(self.table, u)
        passed = check_preisach(Record(u, y))
        assert "wiping-out holds" in passed.notes[0]
        assert "congruency holds" in passed.notes[1]
        bent = check_preisach(Record(u, y + 0.01 * y**2 * 180 / y.max()))  # output that stiffens: loops of other height
        assert "congruency does not hold" in bent.notes[1]
        drifting = check_preisach(Record(u, y + np.linspace(0, 0.2 * np.ptp(y), y.size)))
        assert "wiping-out does not hold" in drifting.notes[0]

    def test_closures_are_counted(self):
        u = through((0, 150, 100, 180, 50, 120, 90, 180, 0))
        found = wiping_out(Record(u, u))
        assert sorted(found.at) == [120.0, 150.0, 180.0]
        assert sorted(found.width) == [30.0, 50.0, 130.0]
        np.testing.assert_allclose(found.gap, 0.0, atol=1e-9)

    def test_branches_that_wipe_out_a_loop_on_their_way_are_not_compared(self):
        # 120 to 0 passes 90 and 60, where older loops end; 150 to 0 from 180 passes nothing.
        u = through((0, 120, 0, 180, 60, 150, 90, 120, 0, 120, 0), 200)
        found = check_preisach(Record(u, outputs(self.table, u)))
        assert found.outcomes["congruency"] == "holds"
        assert [(c.low, c.high, c.branches) for c in found.loops] == [(0.0, 120.0, 2), (0.0, 120.0, 2)]

    def test_a_record_without_minor_loops_is_said_to_test_nothing(self):
        u = np.sin(np.linspace(0, 20, 400))
        found = check_preisach(Record(u, outputs(self.table, 90 + 90 * u)))
        assert not found.tested
        assert set(found.outcomes.values()) == {"untested"}
        assert "only the major loop closes" in found.notes[0]
        rising = check_preisach(Record(np.linspace(0, 1, 50), np.linspace(0, 1, 50)))
        assert "no loop closes" in rising.notes[0]
        assert "more than one reversal" in rising.notes[2]

    def test_reversal_curves_predict_higher_orders_of_a_preisach_device_only(self):
        tops = [v for top in np.linspace(9, 180, 20) for v in (top, 0)]
        u = through((0, *tops, *HIGHER_ORDER[1:], 100, 40, 150, 70, 130), 40)
        y = outputs(self.table, u)
        found = check_preisach(Record(u, y))
        assert found.higher is not None
        assert found.higher.held_out
        assert found.outcomes["higher-order"] == "holds"
        assert set(found.higher.errors) == {0, 1, 2, 3, 4, 5}
        # A device with local memory: after each reversal it starts anew.
        local, w = [], 0.0
        for v, du in zip(u, np.diff(u, prepend=u[0]), strict=True):
            w += 0.03 * abs(du) * (v - w) + 0.5 * du
            local.append(w)
        found = check_preisach(Record(u, np.array(local)))
        assert found.higher is not None
        assert found.higher.held_out
        assert found.outcomes["higher-order"] == "fails"
        alone = through((0, *HIGHER_ORDER[1:]), 40)
        undetermined = higher_order(Record(alone, outputs(self.table, alone)))
        assert undetermined is not None
        assert not undetermined.held_out

    def test_errors_are_split_by_order(self):
        model = truth("positive")
        u = through((1.0, -0.8, 0.6, -0.4), 50)
        y = output(model, u)
        orders = error_by_order(model, Record(u, y + 0.1))
        assert sum(n for n, _, _ in orders.values()) == u.size
        assert set(orders) == {0, 1, 2}
        for _, rms, _ in orders.values():
            assert rms == pytest.approx(10 / np.ptp(y), rel=1e-6)


class TestDensities:
    @pytest.mark.parametrize("kind", ["gaussian", pytest.param("lorentzian", marks=pytest.mark.slow), "factorized"])
    def test_parameters_come_back(self, kind):
        t = np.linspace(0, 8, 600)
        u = np.sin(2 * np.pi * t) * np.exp(-0.2 * t)
        true = ParametricPreisach(
            saturation=2.0, coercivity=0.3, width=0.2, spread=0.25, shift=0.05, slope=0.3, offset=0.1, density=kind,
            levels=np.linspace(u.min(), u.max(), 31), center=0.5 * (u.min() + u.max()), initial="negative",
        )  # fmt: skip
        record = Record(u, output(true.preisach(), u))
        fix = ("spread",) if kind == "factorized" else ()
        model = ParametricPreisach(density=kind, levels=np.linspace(-1, 1, 31), initial="negative", depth=20)
        result = hf.fit(model, record, fix=fix, starts=1)
        assert result.train.rmse < 1e-6 * np.ptp(record.y)
        found = result.model
        for name in ("saturation", "coercivity", "width", "shift", "slope"):
            assert float(getattr(found, name)) == pytest.approx(float(getattr(true, name)), rel=1e-3)


def magnetic_loops(measured, name):
    rows = np.genfromtxt(measured / "tidy" / name, delimiter=",", skip_header=1)
    return [Record(rows[rows[:, 0] == k, 1], rows[rows[:, 0] == k, 2], name=str(k)) for k in np.unique(rows[:, 0])]


class TestMeasured:
    def test_the_penalty_along_coercivity_predicts_loops_between_others(self, measured):
        # Without it 0.35 and 1.09 % of full scale.
        loops = magnetic_loops(measured, "mag_bh_MnZn_ferrite.csv")
        scale = np.ptp(np.concatenate([loop.y for loop in loops]))
        for k, limit in ((0, 0.3), (1, 0.9)):
            others = loops[:k] + loops[k + 1 :]
            fit = hf.fit("preisach-magnetic:n=30:spacing=uniform", others)
            error = fit.model.free_run(loops[k].u) - loops[k].y
            assert 100 * np.sqrt(np.mean(error**2)) < limit * scale

    def test_ferrite_loops_in_sample(self, measured):
        loops = magnetic_loops(measured, "mag_bh_MnZn_HP_ferrite.csv")
        span = np.ptp(np.concatenate([loop.y for loop in loops]))
        fitted = lambda records, n=24: hf.fit(Preisach.of(n, symmetric=True), records, fix={"offset": 0.0})
        assert fitted(loops).train.nrmse_percent < 0.2
        # The second largest loop, left out: held out at 0.69 % of the material's full scale.
        order = np.argsort([np.ptp(r.u) for r in loops])
        held = loops[order[-2]]
        fit = fitted([r for r in loops if r is not held])
        assert 100 * np.sqrt(np.mean((fit.predict(held) - held.y) ** 2)) / span <= 1.0
        # The largest is extrapolation, and the model says so.
        largest = loops[order[-1]]
        small = fitted([r for r in loops if r is not largest], 12)
        assert "extrapolation" in small.model.advice(largest.u)[0]

    @pytest.mark.slow
    def test_reversal_curves_left_out(self, measured):
        rows = np.genfromtxt(measured / "tidy" / "mag_forc_FeCo.csv", delimiter=",", skip_header=1, usecols=(0, 2, 3))
        # A calibration point stands before each curve: the first row of each.
        curves = [Record(*rows[rows[:, 0] == k][1:, 1:].T, name=f"{k:g}") for k in np.unique(rows[:, 0])]
        span = np.ptp(np.concatenate([r.y for r in curves]))
        held = [r for k, r in enumerate(curves) if k % 4]
        options = (
            (0.15, 2.0, "preisach-forc:n=40"),
            (0.10, 2.0, "preisach-forc-signed:n=40"),
            (0.60, 5.0, "preisach-forc:n=60:elements=relays"),
        )
        for bar, most, name in options:
            fit = hf.fit(name, curves[::4], method=weights_alone(1e-5))
            error = np.concatenate([output(fit.model, r.u) - r.y for r in held])
            assert 100 * np.sqrt(np.mean(error**2)) / span <= bar
            assert 100 * np.abs(error).max() / span <= most


def test_groups_of_many_weights_are_left_out_side_by_side_with_the_same_error(monkeypatch):
    u = np.sin(np.linspace(0, 30, 600)) * np.linspace(0.3, 1, 600)
    data = hf.Dataset.of(Record(u, u**3 + 0.2 * np.abs(u), name="made"))
    errors = []
    for numbers, cores in ((2**21, 1), (1, 1), (1, 2), (1, 3)):
        for module in ("smooth", "smooth_system"):
            monkeypatch.setattr(f"hystfit.models.preisach.{module}.NUMBERS", numbers)
        monkeypatch.setattr("hystfit.runs.threads.usable_cores", lambda cores=cores: cores)
        errors.append(hf.fit("preisach:n=8", data).left_out)
    assert len(set(errors)) == 1
    assert errors[0] > 0


def test_errors_take_the_smoothness_penalty_as_the_prior_that_it_is():
    """Differences of neighbors, of which the diagonal alone would say far more about a common change of the weights."""
    u = np.concatenate([size * np.cos(np.linspace(0, 4 * np.pi, 400)) for size in (1.0, 0.7, 0.4)])
    clean = output(truth(), u)
    record = hf.Record(u=u, y=clean + 0.01 * np.ptp(clean) * np.random.default_rng(0).normal(size=u.size))
    problem = Problem(Preisach.of(12, spacing="uniform", reversible=False).start([record]), record)
    estimate = weights_alone(1e-4).estimate(problem, np.zeros((1, len(problem.space))))
    residual, J = (of[0] / problem.scales.y for of in problem.linearize(estimate.x))
    live = ~problem.on_bound(estimate.x)
    assert 40 < np.count_nonzero(live) < live.size  # the slopes of the squares and of the penalty balance
    balance = (J.T @ residual + estimate.penalty @ estimate.x)[live]
    np.testing.assert_allclose(balance, 0, atol=1e-6 * np.abs(estimate.penalty @ estimate.x).max())
    found = uncertainty(problem, estimate, correlated=False)
    normal = (J.T @ J + estimate.penalty)[np.ix_(live, live)]
    expected = (found.sigma / problem.scales.y) ** 2 * np.linalg.inv(normal)
    np.testing.assert_allclose(found.joint[np.ix_(live, live)], expected, rtol=1e-6, atol=1e-9 * expected.max())
