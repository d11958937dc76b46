"""Associative scans and the kernel over lanes against the scan, which stays their oracle. No GPU is needed: Pallas interprets."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hystfit as hf
from hystfit import testing
from hystfit.batch import bucketed
from hystfit.inference.noise.ornstein_uhlenbeck import OrnsteinUhlenbeck
from hystfit.inference.noise.setting import Setting
from hystfit.inference.problem import Problem
from hystfit.models.base import AbstractHysteresis
from hystfit.models.parallel import kernel
from hystfit.models.parallel import route as routes
from hystfit.models.parallel.associative import StateMap
from hystfit.models.parallel.route import Route, route

SAMPLES, LANES = 13, 33  # neither a power of two nor whole blocks
PLAYS = hf.PrandtlIshlinskii.of(2, 2, operator="stop", hardening=2)
U = jnp.asarray(np.sin(0.9 * np.arange(SAMPLES)) * (0.3 + 0.1 * np.arange(SAMPLES)))
DT = jnp.asarray(np.where(np.arange(SAMPLES) % 5 == 3, 0.0, 0.01 + 0.005 * np.sin(np.arange(SAMPLES))))


def on_a_gpu(monkeypatch: pytest.MonkeyPatch, longest: int = 4096) -> list[bool]:
    """Choose as on a GPU, and record for each batch whether it ran in a kernel."""
    monkeypatch.setattr(routes, "platform", lambda: "gpu")
    monkeypatch.setattr(routes, "_LONG", longest)
    ran, in_kernel = [], kernel.in_kernel

    def watched(*arguments: object) -> object:
        ran.append(False)
        result = in_kernel(*arguments)
        ran[-1] = True
        return result

    monkeypatch.setattr(kernel, "in_kernel", watched)
    return ran


def agree(found: object, wanted: object) -> None:
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-10 * (1 + np.max(np.abs(b), initial=0.0)))


@pytest.mark.parametrize(
    ("where", "samples", "lanes", "associative", "chosen"),
    [
        ("cpu", 10**6, 10**4, True, Route.SCAN),
        ("tpu", 10**6, 10**4, True, Route.SCAN),
        ("gpu", 10**6, 1, True, Route.ASSOCIATIVE),
        ("gpu", 10**6, 1, False, Route.SCAN),
        ("gpu", 100, 1, True, Route.SCAN),
        ("cuda", 100, 64, False, Route.KERNEL),
    ],
)
def test_the_route_follows_from_device_and_size(
    where: str, samples: int, lanes: int, associative: bool, chosen: Route, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(routes, "platform", lambda: where)
    assert route(samples, lanes, associative=associative) is chosen


@pytest.mark.parametrize(
    "model",
    [PLAYS, hf.SecondOrder(omega=60.0), hf.Sum(hf.Duhem(alpha=2.0), hf.Series(hf.Lag(tau=0.02), hf.LogCreep()))],
    ids=lambda model: type(model).__name__,
)
def test_an_associative_scan_gives_output_state_and_derivatives_of_the_scan(model: AbstractHysteresis) -> None:
    assert model.associative
    leaves, treedef = jax.tree.flatten(model)
    along = [0.1 * (1 + k) * jnp.ones_like(leaf) for k, leaf in enumerate(leaves)]

    def derivatives(way: str) -> object:
        def run(leaves: list[jax.Array]) -> object:
            model = treedef.unflatten(leaves)
            return getattr(model, way)(model.init(U[0]), U[0], U, DT)

        return jax.jit(lambda leaves: jax.jvp(run, (leaves,), (along,)))(leaves)

    agree(derivatives("sweep_at_once"), derivatives("sweep"))


def test_a_model_that_declares_the_wrong_map_is_found() -> None:
    """Plays are no affine map of their positions."""

    class Affine(hf.PrandtlIshlinskii):
        state_map = StateMap.AFFINE

    model, probe = Affine.of(2), testing._probe(0, 1.0, 0.5, 0.01, 24)
    y = np.asarray(hf.simulate(hf.PrandtlIshlinskii.of(2), probe.u)[0])
    with pytest.raises(AssertionError, match="state_map"):
        testing._check_state_map(model, probe, y, "Affine")


def test_long_records_of_associative_models_take_that_form_on_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """The halves of a run, joined, equal one run."""
    model = hf.Sum(hf.Duhem(alpha=2.0), hf.Delay(lag=1.5))
    wanted = hf.simulate(model, U)[0]
    on_a_gpu(monkeypatch, longest=2)
    monkeypatch.setattr(hf.Duhem, "sweep", None)
    first, at = hf.simulate(model, U[:5])
    agree(jnp.concatenate([first, hf.simulate(model, U[5:], resume=at)[0]]), wanted)


@pytest.mark.parametrize("even", [True, False])
def test_slow_noise_is_whitened_alike_by_both_forms(monkeypatch: pytest.MonkeyPatch, even: bool) -> None:
    rng = np.random.default_rng(1)
    weight = jnp.asarray(np.where(np.arange(SAMPLES) % 4 == 2, 0.0, 1.5))[None]
    gap = jnp.asarray(1.0 if even else rng.uniform(0.2, 3.0, (1, SAMPLES)))
    setting = Setting(gap, weight, weight, weight > 0, jnp.sum(weight > 0).astype(float), jnp.zeros(()))
    noise, rows = OrnsteinUhlenbeck(0.3, 0.8, 6.0), jnp.asarray(rng.normal(size=(1, SAMPLES, 2)))
    along = OrnsteinUhlenbeck(0.1, 0.2, 0.5)

    def whitened() -> object:
        return jax.jit(lambda n: jax.jvp(lambda n: n.whiten(setting, rows), (n,), (along,)))(noise)

    wanted = whitened()
    on_a_gpu(monkeypatch, longest=2)
    agree(whitened(), wanted)


def batch_of(model: AbstractHysteresis) -> tuple[list[jax.Array], object]:
    """Leaves of as many devices as there are lanes, and how they make a model."""
    rng = np.random.default_rng(0)
    leaves, treedef = jax.tree.flatten(model)
    spread = [jnp.asarray(leaf * (1 + 0.05 * rng.random((LANES, *np.shape(leaf))))) for leaf in leaves]
    return spread, treedef


def swept(treedef: object, leaves: list[jax.Array]) -> jax.Array:
    """Output by a scan of the step."""
    model = treedef.unflatten(leaves)  # type: ignore[attr-defined]
    return AbstractHysteresis.sweep(model, model.init(U[0]), U[0], U, DT)[1]


@pytest.mark.parametrize(
    "model",
    [hf.BoucWen(scheme="exact"), PLAYS, hf.Delay(lag=2.3)],
    ids=lambda model: type(model).__name__,
)
def test_the_kernel_gives_the_output_of_the_scan_and_lowers_for_a_gpu(
    monkeypatch: pytest.MonkeyPatch, model: AbstractHysteresis
) -> None:
    leaves, treedef = batch_of(model)
    wanted = jax.jit(jax.vmap(lambda leaves: swept(treedef, leaves)))(leaves)
    ran = on_a_gpu(monkeypatch)
    agree(jax.jit(jax.vmap(lambda leaves: swept(treedef, leaves)))(leaves), wanted)
    assert ran == [True]
    # As on a machine with a GPU, whose compiler is missing here.
    monkeypatch.setattr(kernel, "interpreted", lambda: False)
    monkeypatch.setattr(kernel, "compiles", lambda *_: True)
    traced = jax.jit(jax.vmap(lambda leaves: swept(treedef, leaves))).trace(leaves)
    assert "xla.gpu.triton" in traced.lower(lowering_platforms=("cuda",)).as_text()
    agree(traced.lower().compile()(leaves), wanted)  # arrays on the CPU of that machine


def test_a_step_without_a_kernel_and_derivatives_take_the_scan(monkeypatch: pytest.MonkeyPatch) -> None:
    """A step that looks up a table by its state; the gradient of a scan by both modes; a compiler that fails."""
    table = jnp.asarray(np.cos(np.arange(8.0)))

    def looked_up(scale: jax.Array) -> jax.Array:
        body = lambda s, u: (s + scale * u, table[jnp.clip(s * 3, 0, 7).astype(int)] * scale)
        return kernel.scan(body, jnp.zeros(()), U)[1]

    added = lambda scale: kernel.scan(lambda s, u: (s + jnp.sin(scale * u), s), jnp.zeros(()), U)[1]
    scales = jnp.linspace(0.5, 1.0, LANES)
    wanted = jax.vmap(looked_up)(scales), jax.vmap(jax.grad(lambda s: jnp.sum(added(s) ** 2)))(scales)
    summed = jax.vmap(added)(scales)
    ran = on_a_gpu(monkeypatch)
    agree(jax.vmap(looked_up)(scales), wanted[0])
    assert ran == [False]
    agree(jax.vmap(jax.grad(lambda s: jnp.sum(added(s) ** 2)))(scales), wanted[1])
    monkeypatch.setattr(kernel, "interpreted", lambda: False)
    with pytest.warns(RuntimeWarning, match="ValueError"):  # kernels do not compile on a CPU
        agree(jax.vmap(added)(scales), summed)
    agree(jax.vmap(added)(scales), summed)  # known by now


def problem(records: int) -> Problem:
    t = np.arange(40) * 0.05
    u = np.sin(4 * t) * (0.5 + t / 2)
    y = np.asarray(hf.simulate(hf.BoucWen(mu=0.5, tau=2.0), u)[0])
    y = y + 0.01 * np.random.default_rng(0).normal(size=t.size)
    fix = {"c": 1.0, "mu": 0.5, "rho": 0.5}  # two free parameters: small programs
    return Problem(hf.BoucWen(), [hf.Record(u=u, y=y, t=t), hf.Record(u=-u, y=-y, t=t, name="down")][:records], fix=fix)


def test_jacobians_of_many_starts_come_out_of_the_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two records with an offset each, and a robust loss."""
    objective = eqx.tree_at(lambda o: o.bend, problem(2).objective, jnp.asarray(0.1))
    objective = type(objective)(objective.coordinates, objective.batch, objective.size, objective.bend, "soft-l1")
    p = objective.coordinates.lower.size
    z = jnp.asarray(np.random.default_rng(2).normal(0, 0.3, (LANES, p)))
    wanted = jax.jit(jax.vmap(objective.linearize_at))(z)
    ran = on_a_gpu(monkeypatch)
    agree(jax.jit(jax.vmap(objective.linearize_at))(z), wanted)
    assert ran
    assert all(ran)


def test_likelihoods_of_many_walkers_come_out_of_the_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    density = problem(1).with_noise(OrnsteinUhlenbeck(0.01, 0.01, 5.0)).density
    z = jnp.asarray(np.random.default_rng(2).normal(0, 0.3, (LANES, density.p + len(density.noise.kinds))))
    lean = lambda: jax.jit(jax.vmap(lambda z: density.log_likelihood_lean(z)))(z)
    wanted = lean()
    ran = on_a_gpu(monkeypatch)
    agree(lean(), wanted)
    assert ran == [True]


@pytest.mark.slow  # a descent in interpreted kernels; its linearizations are tested above
def test_many_loops_are_solved_together_on_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    posed = problem(1)
    starts = np.asarray(posed.objective.coordinates.unconstrained(np.array([1.5, 0.0]), xp=np))
    tasks = [bucketed.Task.of(posed, np.stack([starts, starts + 0.2]))] * 2
    wanted = bucketed.solve_together(tasks)
    ran = on_a_gpu(monkeypatch)
    anew = bucketed._solve.__wrapped__  # type: ignore[attr-defined]
    monkeypatch.setattr(bucketed, "_solve", eqx.filter_jit(lambda *arguments: anew(*arguments)))
    found = bucketed.solve_together(tasks)
    assert ran
    assert all(ran)
    for a, b in zip(found, wanted, strict=True):
        assert a is not None
        assert b is not None
        np.testing.assert_allclose(a.x, b.x, rtol=1e-7, atol=1e-9)
