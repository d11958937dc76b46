"""Every model finds its parameters again from noisy records, started far from the truth, within the errors it states.

For each model: replicates with seeds of their own, starts far from the truth. Every identifiable parameter in the interior
must lie within three standard errors in at least 95 % of them, and the pulls (error over standard error) must look standard
normal. With N pulls their mean has standard deviation 1/sqrt(N) and their variance about sqrt(2/N): the limits of five such
standard deviations raise a false alarm in fewer than 1 of 10^5 runs (seeds are constant besides).
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import hystfit as hf
from hystfit.fitting.judgment.covariance import uncertainty
from hystfit.fitting.solvers.registry import ESTIMATORS

REPLICATES = 100
T = np.linspace(0.0, 5.0, 500)
SWEEP = (0.15 + 0.85 * np.abs(np.sin(np.pi * T / 5))) * np.sin(2 * np.pi * 1.4 * T)
RANDOM = np.interp(T, np.linspace(0, 5, 26), np.random.default_rng(7).uniform(-1, 1, 26))
FORCE = np.interp(T, np.linspace(0, 5, 40), np.random.default_rng(8).uniform(-1, 1, 40))


def started(model, u):
    """Ranges and thresholds from the record, as a fit would set them."""
    return model.start([hf.Record(u=u, y=u, t=T)])


def plays():
    model = started(hf.PrandtlIshlinskii.of(4), RANDOM)
    return eqx.tree_at(
        lambda m: (m.w, m.rise, m.offset),
        model,
        (jnp.asarray([[0.4, 0.3, 0.5, 0.6]]), jnp.asarray([1.6]), jnp.asarray(0.2)),
    )


def relays():
    model = started(hf.Preisach.of(3, degree=1, reversible=False, spacing="uniform"), RANDOM)
    return eqx.tree_at(lambda m: (m.w, m.offset), model, (jnp.linspace(0.1, 0.4, model.w.size), jnp.asarray(0.2)))


DAMAGE = {"dnu": 0.01, "deta": 0.03, "zs": 0.85, "p": 0.15, "q": 0.1, "psi": 0.3}
CASES = {
    "duhem": (hf.Duhem(alpha=2.0, f=[0.1, 1.0, 0.1, -0.05], g=[0.5, 0.05, 0.02], w0=0.1), SWEEP),
    "bouc-wen": (hf.BoucWen(c=1.0, mu=0.45, tau=1.5, rho=0.5, offset=0.3), SWEEP),
    "bouc-wen-exact": (hf.BoucWen(c=1.0, mu=0.45, tau=1.5, rho=0.5, offset=0.3, scheme="exact"), RANDOM),
    "bouc-wen-asymmetric": (
        hf.AsymmetricBoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.4, n=1.4, skew=0.2, b=[0.1, -0.05], offset=0.3),
        SWEEP,
    ),
    "bouc-wen-force": (hf.BoucWenForce(kappa_x=0.4, kappa_w=1.0, rho=4.0, sigma=0.9, n=2.0, offset=0.1), SWEEP),
    "jiles-atherton": (hf.JilesAtherton(Ms=1.5, a=0.2, coupling=0.7, k=0.15, c=0.25, offset=0.1), SWEEP),
    "oscillator": (
        hf.BoucWenOscillator(
            m=0.02, c=0.15, K=2.0, a=0.4, r_load=1.0, r_unl=0.2, Z=0.24, offset=0.05, between="linear"
        ),
        FORCE,
    ),
    "log-creep": (
        hf.Series(hf.BoucWen(c=1.0, mu=0.45, tau=1.5, rho=0.5, offset=2.0), hf.LogCreep(gamma=[0.05])),
        SWEEP,
    ),
    "creep and viscous": (
        hf.Sum(
            hf.BoucWen(c=1.0, mu=0.45, tau=1.5, rho=0.5),
            hf.LinearCreep(a=[0.2], low=-1.0, high=1.0),
            hf.Viscous(c=0.02),
        ),
        SWEEP,
    ),
    "saturating rate": (
        hf.Sum(hf.BoucWenForce(kappa_x=0.4, kappa_w=1.0, rho=4.0, sigma=0.9, n=2.0), hf.SaturatingRate(F=0.3, v0=2.0)),
        RANDOM,
    ),
    "second order": (
        hf.Series(hf.BoucWen(c=1.0, mu=0.45, tau=1.5, rho=0.5), hf.SecondOrder(omega=20.0, zeta=0.2)),
        RANDOM,
    ),
    "lag": (hf.Series(hf.Lag(tau=0.04), hf.BoucWen(c=1.0, mu=0.45, tau=1.5, rho=0.5)), SWEEP),
    "delay": (hf.Series(hf.Delay(lag=2.4), hf.BoucWen(c=1.0, mu=0.45, tau=1.5, rho=0.5)), SWEEP),
    "steel-02": (hf.Steel02(fy=1.0, E=4.0, b=0.05, cR1=0.9, cR2=0.2, a1=0.03, a3=0.05), SWEEP),
    # Several backstresses may change places.
    "voce-chaboche": (hf.VoceChaboche(E=5.0, sy0=0.4, Q=0.3, b=0.8, D=0.1, a=20.0, S=(0.3,), g=(8.0,)), SWEEP),
    "bouc-wen-baber-noori": (hf.BoucWenBaberNoori(kappa_x=0.1, kappa_w=1.0, zy=0.15, beta=0.7, n=1.4, **DAMAGE), SWEEP),
    "lugre": (hf.LuGre(sigma0=40.0, sigma1=0.1, sigma2=0.05, Fc=1.0, dFs=0.6, vs=3.0, k=0.3), RANDOM),
    "springpot": (
        hf.Sum(hf.Linear(k=0.4), hf.Springpot(c=0.5, order=0.3, tau=np.geomspace(1e-3, 50.0, 10))),
        RANDOM,
    ),
    "prandtl-ishlinskii": (plays(), RANDOM),
    "preisach": (relays(), RANDOM),
}


# The quick form takes one model of each family; the others take most of the time.
QUICK = ("duhem", "bouc-wen", "prandtl-ishlinskii")


@pytest.mark.parametrize(
    "case", [case if case in QUICK else pytest.param(case, marks=pytest.mark.slow) for case in CASES]
)
def test_parameters_are_recovered_within_their_errors(case):
    truth, u = CASES[case]
    dt = hf.Record(u=u, y=u, t=T).dt
    clean = np.asarray(hf.simulate(truth, u, dt)[0])
    noise = 0.003 * np.ptp(clean)
    pulls = []
    for seed in range(REPLICATES):
        rng = np.random.default_rng([seed, len(case)])
        record = hf.Record(u=u, y=clean + rng.normal(0, noise, u.size), t=T)
        problem = hf.Problem(truth, record)
        x = problem.space.vector(truth)
        if case in ("prandtl-ishlinskii", "preisach"):
            estimate = plain_weights(problem)
        else:
            z = problem.space.unconstrained(x)
            off = rng.choice([-1.0, 1.0], (8, z.size)) * rng.uniform(0.5, 1.0, (8, z.size))
            estimate = ESTIMATORS.make("lm").estimate(problem, z + off)
        errors = uncertainty(problem, estimate, correlated=False)
        inside = np.array([side is None for side in problem.at_bound(estimate.x)]) & errors.determined
        pulls.append(np.where(inside, (estimate.x - x) / np.sqrt(np.diag(errors.covariance)), np.nan))
    check_pulls(problem.space.names, np.array(pulls))


def check_pulls(names, pulls):
    """Errors over standard errors, shape (replicates, parameters), look standard normal; NaN where one was not determined."""
    determined = np.isfinite(pulls)
    assert determined.mean(axis=0).min() > 0.5, f"{names}: seldom determined"
    for name, column, kept in zip(names, pulls.T, determined.T, strict=True):
        values = column[kept]
        assert np.mean(np.abs(values) < 3) >= 0.95, f"{name}: {np.mean(np.abs(values) < 3):.0%} within three errors"
        assert abs(values.mean()) < 5 / np.sqrt(values.size), f"{name}: mean pull {values.mean():.2f}"
        assert abs(values.var() - 1) < 5 * np.sqrt(2 / values.size), f"{name}: variance of pulls {values.var():.2f}"


def plain_weights(problem):
    """Weights by the convex solve without a ridge, which would bias them."""
    from hystfit.fitting.solvers.convex import Convex

    return Convex(strengths=(1e-14,)).estimate(problem, np.zeros((1, len(problem.space))))


@pytest.mark.parametrize("wrong", ["small errors", "large errors", "bias", "seldom determined"])
def test_pulls_of_a_wrong_error_are_noticed(wrong):
    """Errors half or twice as large as they should be, a bias of one standard error, errors that are mostly unknown."""
    right = np.random.default_rng(0).normal(size=(REPLICATES, 2))
    check_pulls(("a", "b"), right)
    column = {
        "small errors": 2 * right[:, 1],
        "large errors": 0.5 * right[:, 1],
        "bias": right[:, 1] + 1,
        "seldom determined": np.where(np.arange(REPLICATES) < 40, right[:, 1], np.nan),
    }[wrong]
    with pytest.raises(AssertionError, match=r"b:|seldom"):
        check_pulls(("a", "b"), np.column_stack([right[:, 0], column]))
