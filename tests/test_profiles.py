"""Profiles against refits and closed forms, other covariances against plain sums, designs against simulation."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

import hystfit as hf
from hystfit.errors import ParameterError
from hystfit.inference.bounded_newton import BoundedNewton
from hystfit.inference.noise import Setting, White
from hystfit.inference.residuals import analyze
from hystfit.outcome import Code, Severity, Status
from hystfit.outcome.note import has
from hystfit.uncertainty.block_covariance import FEWEST, _Blocks, covariance
from hystfit.uncertainty.input_design import Candidate, Design, design
from hystfit.uncertainty.profile_paths import Walk
from hystfit.uncertainty.profiles import Profile, _whitened, profile

TRUTH = hf.BoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.5)
NAMES = ("c", "mu", "tau", "rho", "offset")


def loop(amplitude: float = 1.0, sigma: float = 0.01, T: int = 600, seed: int = 0) -> hf.Record:
    u = amplitude * np.sin(2 * np.pi * 3 * np.arange(T) / T)
    y = np.asarray(hf.simulate(TRUTH, u)[0]) + sigma * np.random.default_rng(seed).normal(size=T)
    return hf.Record(u=u, y=y)


def jacobian(u: np.ndarray, values: dict[str, float]) -> np.ndarray:
    """Derivatives of the output by the parameters of `NAMES`, shape (samples, 5)."""
    output = lambda x: hf.simulate(hf.BoucWen(**dict(zip(NAMES, x, strict=True))), u)[0]
    return np.asarray(jax.jacfwd(output)(jnp.asarray([values[name] for name in NAMES])))


@pytest.fixture(scope="module")
def fitted() -> hf.FitResult:
    return hf.fit(TRUTH, loop(), starts=1, noise="iid")


@pytest.fixture(scope="module")
def faint() -> hf.FitResult:
    """One small amplitude in much noise: classic Bouc-Wen trouble."""
    return hf.fit(TRUTH, loop(0.1, 0.01), starts=4, noise="iid")


def test_a_search_begins_again_inside_the_bounds_of_all_but_the_held_parameter():
    """A nuisance parameter on its bound hardly moves from there; the profiled one stays where the profile is."""
    u = np.sin(np.linspace(0, 12, 50))
    problem = hf.Problem(hf.BoucWen(c=1.0, mu=1.0, tau=2.0, rho=-1.0), hf.Record(u=u, y=u))
    names, newton = (
        list(problem.space.names),
        BoundedNewton(problem, problem.whitened(White()), problem.space.vector(problem.model)),
    )
    at_bounds = newton.coordinates(newton.origin)
    for held in ("mu", "rho", "c"):
        x, inner = (problem.space.physical(v) for v in (at_bounds, newton.inside(at_bounds, names.index(held))))
        moved = {name for name, before, after in zip(names, x, inner, strict=True) if abs(after - before) > 0.01}
        assert moved == {"mu", "rho"} - {held}
    assert newton.inside(newton.inside(at_bounds)) is None


def test_profile_points_are_the_best_refits(fitted):
    found = profile(fitted, ["tau"])["tau"]
    record = fitted.data[0]
    sd2 = fitted.sigma**2

    def loss(rest: np.ndarray, tau: float) -> np.ndarray:
        model = hf.BoucWen(c=rest[0], mu=rest[1], tau=tau, rho=rest[2], offset=rest[3])
        return np.asarray(hf.simulate(model, record.u)[0]) - record.y

    start = [fitted[n].value for n in ("c", "mu", "rho", "offset")]
    free = scipy.optimize.least_squares(lambda x: loss(x[1:], x[0]), [found.value, *start], xtol=1e-12, ftol=1e-12)
    for k in (0, len(found.x) // 2, -1):
        held = scipy.optimize.least_squares(lambda x, k=k: loss(x, found.x[k]), start, xtol=1e-12, ftol=1e-12)
        assert found.statistic[k] == pytest.approx(2 * (held.cost - free.cost) / sd2, rel=0.02, abs=0.02)


def test_limits_of_a_well_determined_fit_are_those_of_its_errors(fitted):
    found = profile(fitted)
    assert found.usable
    assert repr(found) == str(found)  # what a notebook shows of it: words, no arrays
    assert set(found.profiles) == set(fitted.free_names)
    for name, p in found.profiles.items():
        width = 2 * 1.96 * fitted[name].stderr
        assert p.upper - p.lower == pytest.approx(width, rel=0.12), name
        assert p.lower < fitted[name].value < p.upper


@pytest.mark.slow
def test_limits_cover_the_truth_about_as_often_as_they_say():
    inside = []
    for seed in range(12):
        result = hf.fit(TRUTH, loop(seed=seed), starts=1, noise="iid")
        found = profile(result, level=0.9)
        inside += [found[n].lower < float(getattr(TRUTH, n)) < found[n].upper for n in ("c", "mu", "tau", "rho")]
    assert np.mean(inside) >= 0.75  # 48 looks, correlated in fours, at 90 %


@pytest.mark.parametrize("refitted", [("rho",), pytest.param(("c", "mu", "tau"), marks=pytest.mark.slow)])
def test_an_open_side_is_named_and_a_profile_is_that_of_refits_by_another_solver(faint, refitted):
    found = profile(faint)
    opened = [p for p in found.profiles.values() if not p.closed]
    assert opened
    assert not found.usable
    assert has(found.notes, Code.OPEN_SIDE)
    squares = lambda result: result.train.n * result.train.rmse**2
    for p in (found[name] for name in refitted):
        # Refits with the parameter fixed at both ends of its path: an open side stays likely, beyond a limit it is not.
        for k, limit in ((0, p.lower), (-1, p.upper)):
            held = hf.fit(TRUTH, faint.data, method="trf", starts=2, noise="iid", fix={p.name: float(p.x[k])})
            refit = (squares(held) - squares(faint)) / faint.sigma**2
            assert p.statistic[k] == pytest.approx(refit, abs=0.01), p
            assert (refit < 1.96**2) == (limit is None), p
    for p in opened:
        assert faint[p.name].stderr is None or faint[p.name].identifiable is False, p.name
    assert has(faint.notes, Code.NOT_DETERMINED)


@pytest.mark.slow
def test_a_parameter_on_its_bound_moves_off_it_where_others_are_held():
    bound = hf.fit(TRUTH, loop(0.1, 0.01, seed=1), starts=4, noise="iid")
    assert bound["rho"].at_bound == "upper"
    squares = lambda result: result.train.n * result.train.rmse**2
    for p in profile(bound, ["mu", "rho"]).profiles.values():
        held = hf.fit(TRUTH, bound.data, method="trf", starts=8, noise="iid", fix={p.name: float(p.x[0])})
        assert p.statistic[0] == pytest.approx((squares(held) - squares(bound)) / bound.sigma**2, abs=0.01), p


@pytest.fixture(scope="module")
def plays() -> hf.FitResult:
    """Eight plays, half of them with weight zero, in white noise."""
    model = hf.PrandtlIshlinskii.of(8)
    u = np.sin(2 * np.pi * np.arange(400) / 80) * (0.4 + 0.6 * np.arange(400) / 400)
    model = model.start([hf.Record(u=u, y=u)])
    weights = np.where(np.arange(8) % 2, 0.0, 0.3)[None]
    y = np.asarray(hf.simulate(eqx.tree_at(lambda m: m.w, model, jnp.asarray(weights)), u)[0])
    return hf.fit(model, hf.Record(u=u, y=y + 0.02 * np.random.default_rng(0).normal(size=400)), noise="iid")


@pytest.mark.slow
def test_in_a_flat_valley_the_lowest_refit_of_a_path_is_the_next_optimum(monkeypatch):
    """A parabola is the limit of an ever longer and flatter Bouc-Wen loop: every refit of a path is a little lower than the last."""
    k = np.arange(300)
    u = -np.cos(np.pi * k / 300)
    fit = hf.fit("bouc-wen", hf.Record(u=u, y=u + 0.1 * u**2 + 0.01 * np.random.default_rng(0).normal(size=300)))
    follow, paths = Walk.follow, []
    monkeypatch.setattr(Walk, "follow", lambda walk, sign: (paths.append(sign), follow(walk, sign))[1])
    limits = profile(fit, "c")
    assert len(paths) <= 6  # two of each optimum; 26 where the first lower refit was the next optimum
    assert has(limits.notes, Code.OTHER_OPTIMUM)


def test_profiles_of_weights_are_those_of_bounded_linear_least_squares(plays):
    found = profile(plays, ["w", "rise"], noise="iid")
    assert set(found.profiles) == {*(f"w[0,{k}]" for k in range(8)), "rise[0]"}
    record, names = plays.data[0], plays.free_names
    output = lambda x: np.asarray(plays.problem.predict(x)[0])
    base = output(np.zeros(len(names)))
    columns = np.column_stack([output(row) - base for row in np.eye(len(names))])
    lower = np.array([plays[name].lower if plays[name].lower is not None else -np.inf for name in names])
    sd = float(np.sqrt(np.sum((output(plays.x) - record.y) ** 2) / (400 - np.sum(plays.x > 1e-4 * lower))))

    def refit(k: int, value: float) -> float:
        others = np.delete(np.arange(len(names)), k)
        target = record.y - base - value * columns[:, k]
        return 2 * scipy.optimize.lsq_linear(columns[:, others], target, (lower[others], np.inf), method="bvls").cost

    full = 2 * scipy.optimize.lsq_linear(columns, record.y - base, (lower, np.inf), method="bvls").cost
    sd2 = plays.sigma**2
    assert sd == pytest.approx(plays.sigma, rel=0.02)
    for p in found.profiles.values():
        k = names.index(p.name)
        for value, statistic in zip(p.x, p.statistic, strict=True):
            assert statistic == pytest.approx((refit(k, value) - full) / sd2, abs=1e-3, rel=1e-3), p.name
        for limit in (p.lower, p.upper):
            if limit is not None:
                assert (refit(k, limit) - full) / sd2 == pytest.approx(1.96**2, rel=0.05), p.name
        assert p.upper is not None, p.name
        assert p.lower is not None or (refit(k, 0.0) - full) / sd2 < 1.96**2, p.name


def test_weights_are_profiled_by_name_only(plays):
    found = profile(plays)
    assert set(found.profiles) == {"offset"}
    assert has(found.notes, Code.CHOICE)
    assert set(profile(plays, "w[0,2]").profiles) == {"w[0,2]"}


@pytest.mark.slow
def test_the_design_closes_what_was_open(faint):
    made = design(faint, low=-1.0, high=1.0, samples=600, steps=30)
    assert made.closes
    assert made.best.score <= min(c.score for c in made.candidates)
    assert np.all((made.best.u >= -1.0) & (made.best.u <= 1.0))
    y = np.asarray(hf.simulate(TRUTH, made.best.u)[0]) + 0.01 * np.random.default_rng(1).normal(size=600)
    both = [faint.data[0], hf.Record(u=made.best.u, y=y, name="designed")]
    again = profile(hf.fit(TRUTH, both, starts=4, noise="iid"), ["c", "mu", "tau", "rho"])
    assert again.usable, str(again)


def test_predicted_errors_are_those_of_a_fit_to_the_designed_record(fitted):
    made = design(fitted, low=-1.0, high=1.0, samples=600, method="families")
    assert {"two amplitudes", "decaying sine"} <= {c.name for c in made.candidates}
    again = hf.fit(TRUTH, [fitted.data[0], made.record(seed=2)], starts=1, noise="iid")
    for name in ("c", "mu", "tau", "rho"):
        assert again[name].stderr == pytest.approx(made.best.stderr[name], rel=0.25)
        assert made.best.stderr[name] < fitted[name].stderr


def slow_record(repeating: float = 0.0) -> hf.Record:
    """Growing loops in slow noise of correlation time 20 samples and white noise, with an error that is the same in every loop."""
    rng, slow, t = np.random.default_rng(0), np.zeros(800), np.arange(800) / 800
    for k in range(1, 800):
        slow[k] = 0.95 * slow[k - 1] + 0.004 * rng.normal()
    u = np.sin(2 * np.pi * 4 * t) * (0.4 + 0.6 * t)
    noise = slow + 0.002 * rng.normal(size=800) + repeating * np.sin(4 * u)
    return hf.Record(u=u, y=np.asarray(hf.simulate(TRUTH, u)[0]) + noise)


@functools.cache
def in_slow_noise(noise: str, repeating: float = 0.0) -> hf.FitResult:
    """A fit of such a record."""
    return hf.fit(TRUTH, slow_record(repeating=repeating), starts=1, noise=noise)


@pytest.mark.parametrize(("noise", "repeating"), [("auto", 0.0), ("auto", 0.03), ("ou", 0.0)])
def test_a_design_has_the_errors_of_a_fit_in_slow_noise(noise, repeating):
    fit = in_slow_noise(noise, repeating)
    assert fit.error_ratio > 1.3
    made = design(fit, samples=300, method="families")
    for name in NAMES:
        assert made.present[name] == pytest.approx(fit[name].stderr, rel=0.01), name
    assert not has(made.notes, Code.ERRORS_DIFFER)


def test_a_design_in_slow_noise_predicts_least_squares_under_the_dense_covariance():
    fit = in_slow_noise("auto")
    made = design(fit, low=-1.0, high=1.0, samples=300, method="families")
    noise = analyze(fit.problem, fit.x).of_errors
    values = {name: fit[name].value for name in NAMES}

    def cover(T: int) -> np.ndarray:
        """Covariance of the noise, averaged over its uncertainty."""
        lag = np.abs(np.subtract.outer(np.arange(T), np.arange(T)))
        parts = zip(noise.shares, noise.others, strict=True)
        return sum(share * (n.white**2 * np.eye(T) + n.slow**2 * np.exp(-lag / n.time)) for share, n in parts)

    first, further = jacobian(fit.data[0].u, values), jacobian(made.best.u, values)
    rows = np.zeros((1100, 6))  # the further record has an offset of its own
    rows[:800, :5], rows[800:, :4], rows[800:, 5] = first, further[:, :4], further[:, 4]
    both = np.zeros((1100, 1100))
    both[:800, :800], both[800:, 800:] = cover(800), cover(300)
    inverse = np.linalg.pinv(rows)
    expected = np.sqrt(np.diag(inverse @ both @ inverse.T))
    for k, name in enumerate(NAMES):
        assert made.best.stderr[name] == pytest.approx(expected[k], rel=0.02), name


def test_a_design_shows_many_weights_as_one():
    u = np.sin(2 * np.pi * np.arange(240) / 80)
    fit = hf.fit("prandtl-ishlinskii:plays=16", hf.Record(u, np.asarray(hf.simulate(TRUTH, u)[0])))
    names = fit.problem.space.names
    errors = {name: 0.5 + k if k % 3 else None for k, name in enumerate(names)}
    made = Design(fit, (Candidate("sine", u, errors, 0.0),), errors, names, (), None, ())
    cells = made.table().to_list()[1]
    weights = [errors[name] for name in names if name.startswith("w[")]
    assert len(weights) == 16
    assert [key for key in cells if key.startswith("w[")] == ["w[16]"]
    known = sorted(error for error in weights if error is not None)
    assert cells["w[16]"] == pytest.approx((known[7] + known[8]) / 2)
    assert "w[3]" not in str(made)


def test_design_aims_at_one_parameter(fitted):
    plain = design(fitted, samples=300, method="families")
    for name in ("c", "tau", "rho"):
        aimed = design(fitted, samples=300, aim=[name], method="families")
        assert aimed.best.stderr[name] == min(c.stderr[name] for c in plain.candidates)
    assert design(fitted, samples=300, aim=["c"], method="families").best.name != plain.best.name


def test_sandwich_is_the_dense_bias_reduced_one_and_both_agree_with_iid_on_white_noise(fitted):
    plain = covariance(fitted, "iid")
    np.testing.assert_allclose(plain.stderr, [fitted[n].stderr for n in plain.names], rtol=1e-3)
    for kind in ("sandwich", "bootstrap"):
        other = covariance(fitted, kind, block=20, seed=1)
        assert np.all((other.ratio > 0.6) & (other.ratio < 1.5)), kind
    # Bell and McCaffrey (2002), by dense matrices of all samples.
    r, J = (rows[0][:600] for rows in fitted.problem.linearize(fitted.x))
    bread, parts = np.linalg.inv(J.T @ J), np.split(np.arange(600), 8)
    left = np.eye(600) - J @ bread @ J.T
    lifted = np.zeros((8, 600, 5))  # weights of the residuals of each block in the estimates
    for weights, part in zip(lifted, parts, strict=True):
        root = np.real(scipy.linalg.inv(scipy.linalg.sqrtm(left[np.ix_(part, part)])))
        weights[part] = root @ J[part] @ bread
    moved = np.einsum("gtp,t->gp", lifted, r)
    found = covariance(fitted, "sandwich", block=75)
    np.testing.assert_allclose(found.matrix, moved.T @ moved, rtol=1e-6)
    for k, factor in enumerate(found.factor):
        inner = lifted[:, :, k] @ left @ lifted[:, :, k].T
        freedom = np.trace(inner) ** 2 / np.sum(inner**2)
        assert factor == pytest.approx(scipy.stats.t.ppf(0.975, freedom), rel=1e-6)
        assert 2.2 < factor < 4


@pytest.mark.parametrize("correlated", [False, True])
def test_intervals_from_the_fewest_blocks_hold_the_truth(correlated):
    span, inside = 20, {}
    for kind in ("sandwich", "bootstrap"):
        rng, count = np.random.default_rng(0), FEWEST[kind]
        size = np.repeat(np.linspace(0.4, 1.6, count), span)  # blocks of unequal leverage
        Q = np.linalg.qr(np.column_stack([np.ones(span * count), size * rng.normal(size=span * count)]))[0]
        inside[kind] = []
        for _ in range(300):
            e = rng.normal(size=span * count) + (np.repeat(rng.normal(size=count), span) if correlated else 0.0)
            shift = Q.T @ e
            blocks = _Blocks.of([(e - Q @ shift, Q)], span)
            matrix, factor = blocks.sandwich(np.eye(2)) if kind == "sandwich" else blocks.bootstrap(np.eye(2), 200, 1)
            inside[kind].append(np.abs(shift) < factor * np.sqrt(np.diag(matrix)))
    for kind, rows in inside.items():  # 99.9 % of 300 records about 95 %, on the side of errors that are too small
        assert np.mean(rows, axis=0).min() > 0.911, kind


def test_standard_errors_stand_side_by_side(fitted):
    found = hf.standard_errors(fitted, block=20)
    assert list(found.errors) == ["fit", "iid", "sandwich", "bootstrap"]
    np.testing.assert_array_equal(found.errors["sandwich"], covariance(fitted, "sandwich", block=20).stderr)
    content = found.to_dict()["parameters"]["c"]
    assert content["ratio"]["bootstrap"] == pytest.approx(content["stderr"]["bootstrap"] / content["stderr"]["iid"])
    row = found.table().to_list()[0]
    assert row["sandwich"] == found.errors["sandwich"][0]
    assert found.block == 20
    assert has(found.notes, Code.BLOCKS)


def test_no_rule_gives_an_error_to_what_is_not_determined(faint):
    found = hf.standard_errors(faint)
    open_ = [k for k, name in enumerate(faint.free_names) if faint[name].stderr is None]
    assert open_
    assert all(np.isnan(error[open_]).all() for error in found.errors.values())
    name = faint.free_names[open_[0]]
    assert set(found.to_dict()["parameters"][name]["stderr"].values()) == {None}
    listed = {row["parameter"] for row in found.table().to_list()}
    assert listed & set(faint.free_names) == {n for n in faint.free_names if faint[n].stderr is not None}
    assert has(found.notes, Code.NOT_DETERMINED)


def test_an_array_of_many_weights_has_one_row_of_errors_until_it_is_chosen():
    result = hf.fit("prandtl-ishlinskii:plays=14", loop(), starts=1, noise="iid")
    found, weights = hf.standard_errors(result), [p for p in result.parameters if p.name.startswith("w[")]
    known = [p for p in weights if p.stderr is not None]
    assert 1 < len(known) <= len(weights) == 14
    row = next(row for row in found.table().to_list() if row["parameter"] == "w[14]")
    assert row["fit"] == f"{min(p.stderr for p in known):.3g} to {max(p.stderr for p in known):.3g}"
    assert row["value"].startswith(f"{min(p.value for p in weights):.3g} to {max(p.value for p in weights):.3g}")
    assert "14 values" in row["remark"]
    assert not any(p.name in found.text() for p in known[-1:])
    every = found.table("w").to_list()[:-1]
    assert [row["parameter"] for row in every] == [p.name for p in weights]
    assert {row["parameter"]: row["fit"] for row in every if row["fit"] is not None} == {
        p.name: p.stderr for p in known
    }
    assert all(row["posterior"] > 0 for row in every)  # also of weights at their bound
    assert [row["parameter"] for row in found.table([known[0].name, "offset"]).to_list()[:-1]] == [
        known[0].name,
        "offset",
    ]
    assert set(found.to_dict()["parameters"]) == set(result.free_names)
    with pytest.raises(ParameterError):
        found.text("v")


def test_too_few_blocks_are_refused_with_a_note():
    loops = [dataclasses.replace(loop(a, T=200, seed=k), name=str(k)) for k, a in enumerate((0.4, 0.7, 1.0))]
    result = hf.fit(TRUTH, loops, starts=1, noise="iid")
    refused = hf.standard_errors(result, block=150)
    assert set(refused.errors) == {"fit", "iid"}
    assert sum(note.code is Code.BLOCKS and note.severity is Severity.WARNING for note in refused.notes) == 2
    found = hf.standard_errors(result, block=100)
    assert set(found.errors) == {"fit", "iid", "sandwich"}
    assert np.all(found.errors["sandwich"][:4] > 0)
    assert found.to_dict()["parameters"]["c"]["factor"]["sandwich"] > 2.1


def test_errors_of_shared_parameters_are_those_about_the_means_of_records_that_are_one_block_each():
    """Bell and McCaffrey (2002) on dense matrices whose columns have zero mean in every record; an offset alone has no error."""
    loops = [
        dataclasses.replace(one := loop(0.3 + 0.08 * k, T=200, seed=k), y=one.y + k, name=str(k)) for k in range(10)
    ]
    result = hf.fit(TRUTH, loops, starts=1, noise="iid")
    own = result.problem.space.per_record
    r, J = (rows[:, :200] for rows in result.problem.linearize(result.x))
    X = np.concatenate(J[..., ~own] - J[..., ~own].mean(axis=1, keepdims=True))
    bread, left = np.linalg.inv(X.T @ X), np.eye(2000) - X @ np.linalg.inv(X.T @ X) @ X.T
    moved = []
    for part in np.split(np.arange(2000), 10):
        root = np.real(scipy.linalg.inv(scipy.linalg.sqrtm(left[np.ix_(part, part)])))
        moved.append(bread @ X[part].T @ root @ r.reshape(-1)[part])
    for kind in ("sandwich", "bootstrap"):
        found = covariance(result, kind, block=200)
        assert found.blocks == 10
        assert np.isnan(found.stderr[own]).all()
        assert np.isnan(found.factor[own]).all()
        size = np.sqrt(np.sum(np.square(moved), axis=0))
        np.testing.assert_allclose(found.stderr[~own], size, rtol=1e-5 if kind == "sandwich" else 0.1)
    assert hf.standard_errors(result, block=200).errors["iid"][own].max() < 0.01


def test_a_design_gives_no_error_to_what_the_fit_leaves_open(faint):
    made = design(faint, samples=300, method="families")
    open_ = [name for name in faint.free_names if faint[name].stderr is None]
    assert open_
    assert all(made.present[name] is None for name in open_)
    assert all(made.present[name] > 0 for name in set(faint.free_names) - set(open_))
    assert has(made.notes, Code.NOT_DETERMINED)
    assert (faint.status, made.status) == ("ok", "ok")  # noise hides the loop, and a faint loop is what a design is for
    poor = design(dataclasses.replace(faint, status=Status.POOR), samples=300, method="families")
    assert poor.status == "ok"
    assert has(poor.notes, Code.FIT_STATUS)
    assert not has(made.notes, Code.FIT_STATUS)


def test_a_design_for_data_without_a_loop_is_not_usable():
    u = np.linspace(0, 1, 200)
    flat = hf.fit(TRUTH, hf.Record(u=u, y=u + 0.01 * np.random.default_rng(0).normal(size=200)), starts=1)
    assert design(flat, samples=300, method="families").status == flat.status == "no-loop"


def test_a_profile_that_ends_elsewhere_than_the_fit_says_so(fitted):
    moved = dataclasses.replace(
        fitted, x=fitted.x * np.array([1.2 if name == "c" else 1.0 for name in fitted.free_names])
    )
    assert not has(profile(fitted, ["c"]).notes, Code.OTHER_OPTIMUM)
    rows = [dataclasses.replace(p, value=1.2 * p.value) if p.name == "c" else p for p in moved.parameters]
    told = profile(dataclasses.replace(moved, parameters=tuple(rows)), ["c"])
    assert has(told.notes, Code.OTHER_OPTIMUM)
    assert told["c"].value == pytest.approx(fitted["c"].value, rel=0.02)


def test_records_too_short_for_blocks_say_so_and_fits_under_a_noise_model_are_refused(fitted):
    short = hf.standard_errors(fitted, block=400)
    assert set(short.errors) == {"fit", "iid"}
    assert short.block is None
    assert sum(note.code is Code.BLOCKS and note.severity is Severity.WARNING for note in short.notes) == 2
    with pytest.raises(ParameterError):
        hf.standard_errors(in_slow_noise("ou"))


def test_correlated_noise_widens_sandwich_and_bootstrap():
    rng = np.random.default_rng(3)
    base = loop(T=600)
    e = np.zeros(600)
    for k in range(1, 600):
        e[k] = 0.9 * e[k - 1] + 0.01 * rng.normal()
    result = hf.fit(TRUTH, base.replace(y=base.y + e), starts=1)
    # Least squares under the dense covariance of the noise that was added.
    inverse = np.linalg.pinv(jacobian(base.u, {name: float(getattr(TRUTH, name)) for name in NAMES}))
    lag = np.abs(np.subtract.outer(np.arange(600), np.arange(600)))
    dense = inverse @ (0.01**2 * np.eye(600) + 0.01**2 / (1 - 0.9**2) * 0.9**lag) @ inverse.T
    for kind in ("sandwich", "bootstrap"):
        found = covariance(result, kind, block=60)  # ten blocks: the errors themselves are known to a quarter
        assert found.names == NAMES
        assert np.abs(np.log(found.stderr / np.sqrt(np.diag(dense)))).max() < 0.5
        assert np.abs(np.log(found.stderr / np.sqrt(np.diag(dense)))).mean() < 0.3
        assert found.ratio.min() > 1.5


@pytest.mark.usefixtures("as_users_run")
def test_bad_questions_are_refused(fitted):
    with pytest.raises(ParameterError):
        profile(fitted, ["nu"])
    with pytest.raises(ParameterError):
        profile(fitted, level=2.0)
    with pytest.raises(ParameterError):
        profile(fitted, noise="student-t")
    with pytest.raises(ParameterError):
        design(fitted, low=1.0, high=0.0)
    with pytest.raises(ParameterError):
        design(fitted, aim=["nu"])
    with pytest.raises(ParameterError):
        covariance(fitted, "bootstrap", block=500)
    with pytest.raises(ParameterError):
        covariance(fitted, "jackknife")


def test_weights_all_alike_change_no_error(fitted):
    record = fitted.data[0]
    heavy = hf.fit(TRUTH, record.replace(weight=np.full(len(record), 4.0)), starts=1, noise="iid")
    plain, same = (profile(result, ["tau"])["tau"] for result in (fitted, heavy))
    np.testing.assert_allclose([same.lower, same.upper], [plain.lower, plain.upper], rtol=1e-3)
    for kind in ("iid", "sandwich"):
        errors = (covariance(result, kind, block=20).stderr for result in (heavy, fitted))
        np.testing.assert_allclose(*errors, rtol=1e-4)


def test_weights_count_in_errors_as_in_the_fit(fitted):
    record = fitted.data[0]
    uneven = hf.fit(
        TRUTH, record.replace(weight=np.where(np.arange(len(record)) < 200, 9.0, 1.0)), starts=1, noise="iid"
    )
    values = {name: uneven[name].value for name in NAMES}
    J, weight = jacobian(record.u, values), uneven.data[0].weight
    residual = np.asarray(hf.simulate(hf.BoucWen(**values), record.u)[0]) - record.y
    variance = np.sum(weight * residual**2) / (len(record) - len(NAMES))
    expected = np.sqrt(variance * np.diag(np.linalg.inv(J.T @ (weight[:, None] * J))))
    np.testing.assert_allclose([uneven[name].stderr for name in NAMES], expected, rtol=1e-4)
    np.testing.assert_allclose(covariance(uneven, "iid").stderr, expected, rtol=1e-3)


def test_a_profile_takes_a_kernel_in_parts_of_the_range_that_it_was_learned_on():
    u = np.concatenate([np.sin(np.arange(300) / 15), 2 * np.sin(np.arange(300) / 15)])
    y = np.asarray(hf.simulate(TRUTH, u)[0]) + 0.01 * np.random.default_rng(0).normal(size=600)
    windowed = hf.fit(TRUTH, hf.Record(u=u, y=y, weight=np.arange(600) < 300), starts=1, noise="iid")
    problem, x = windowed.problem, windowed.x
    whitened = _whitened(windowed, problem, x, np.ones(x.size, bool), "discrepancy")[2]
    place = np.asarray(Setting.of(problem.objective.batch).place)[0, :300]
    np.testing.assert_allclose(np.asarray(whitened.setting.place)[0, :300], place, atol=1e-12)


def test_a_design_starts_from_what_the_fit_knows():
    record = loop(T=600)
    part = hf.fit(TRUTH, record.replace(weight=np.arange(600) < 200), starts=1, noise="iid")
    made = design(part, samples=300, method="families")
    for name in part.free_names:
        assert made.present[name] == pytest.approx(part[name].stderr, rel=0.05)


def test_each_record_of_a_design_has_an_offset_of_its_own():
    first, second = (loop(seed=k).replace(name=name) for k, name in enumerate(("first", "second")))
    both = hf.fit(TRUTH, [first, second.replace(y=second.y + 1.0)], starts=1, noise="iid")
    made = design(both, samples=300, method="families")
    for name in both.free_names:
        assert made.present[name] == pytest.approx(both[name].stderr, rel=0.05)
    offsets = [name for name in both.free_names if name.startswith("offset")]
    assert len(offsets) == 2
    # Another record tells of the offsets of these only through the loop that they share.
    for name in offsets:
        assert made.best.stderr[name] > 0.5 * made.present[name]


@pytest.mark.parametrize("seed", [-1, 2**32])
@pytest.mark.usefixtures("as_users_run")
def test_seeds_that_no_generator_takes_are_refused_at_once(fitted, seed):
    for ask in (
        lambda: hf.fit(TRUTH, fitted.data, seed=seed),
        lambda: hf.sample(fitted, seed=seed),
        lambda: hf.compare(fitted.data, seed=seed),
        lambda: hf.calibrate(TRUTH, fitted.data, seed=seed),
        lambda: covariance(fitted, "bootstrap", seed=seed),
        lambda: design(fitted, seed=seed),
    ):
        with pytest.raises(ParameterError):
            ask()


def test_coefficients_are_no_weights():
    weights = lambda model: hf.ParameterSpace.of(model).weights
    assert not weights(hf.Duhem()).any()
    assert not weights(hf.BoucWen()).any()
    assert weights(hf.PrandtlIshlinskii.of(8)).sum() == 9  # the plays and the slope, both >= 0
    masses = hf.Preisach.of(8)
    assert weights(masses).sum() == masses.w.size + masses.slopes.size
    assert weights(hf.SignedPreisach.of(8)).sum() == masses.w.size


@pytest.mark.parametrize(
    ("lower", "upper", "said"),
    [
        (0.5, 2.0, "n = 1.00 V: 0.50 to 2.00 V"),
        (0.5, None, "n = 1 V: at least 0.5 V, no upper limit (up to +infinity)"),
        (None, 2.0, "n = 1 V: at most 2 V, no lower limit (down to its bound 0)"),
        (None, None, "n = 1 V: not bounded by the data on either side"),
    ],
)
def test_limits_in_words(lower, upper, said):
    below, above = ("its bound 0" if lower is None else None), ("+infinity" if upper is None else None)
    empty = np.zeros(0)
    assert str(Profile("n", "V", 1.0, empty, empty, lower, upper, below, above)) == said
