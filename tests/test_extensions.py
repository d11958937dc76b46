"""A noise model and a sampler, each in one file outside the package: used by Python and at the shell like those of the library."""

import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import hystfit as hf
from hystfit.data.batch import Batch
from hystfit.errors import ParameterError
from hystfit.inference.noise import Setting
from hystfit.registry import class_from_file
from hystfit.sampling.sample import _make

from .conftest import ROOT

NOISE = '''
"""Noise of a sensor that averages two neighboring samples."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import hystfit as hf
from hystfit.inference.noise import AbstractNoise
from hystfit.outcome import Code


class MovingAverage(AbstractNoise):
    """n_k = e_k + echo e_(k-1), e independent Gaussian: first-order moving average. Weights only switch samples off."""

    name: ClassVar[str] = "ma1"
    covers: ClassVar[frozenset[Code]] = frozenset({Code.CORRELATED_RESIDUALS})
    noise_white: Float[Array, ""] = hf.param(1.0, bounds=(0.0, np.inf), unit="y", scale=0.01, doc="standard deviation of e")
    noise_echo: Float[Array, ""] = hf.param(0.5, bounds=(-1.0, 1.0), doc="part of e that returns in the next sample")

    def init(self):
        """State: estimate of the last e, and its variance in units of noise_white^2."""
        return jnp.array([0.0, 1.0])

    def step(self, state, r, gap, weight):
        """One sample of a Kalman filter."""
        last, variance = state
        spread = 1.0 + self.noise_echo**2 * variance
        innovation = r - self.noise_echo * last
        learned = jnp.stack([innovation / spread, 1.0 - 1.0 / spread])
        e = innovation / (self.noise_white * jnp.sqrt(spread))
        return jnp.where(weight > 0, learned, self.init()), e, jnp.log(self.noise_white**2 * spread)

    def whiten(self, setting, rows):
        """The filter over k signals of each record."""

        def signal(row, gap, weight):
            def sample(state, at):
                state, e, logs = self.step(state, *at)
                return state, (jnp.where(at[2] > 0, e, 0.0), jnp.where(at[2] > 0, logs, 0.0))

            return jax.lax.scan(sample, self.init(), (row, gap, weight))[1]

        gap = jnp.broadcast_to(setting.gap, setting.weight.shape)
        signals = jax.vmap(signal, in_axes=(1, None, None), out_axes=(1, 1))
        e, logs = jax.vmap(signals)(rows, gap, setting.weight)
        return e, logs[..., 0]

    def draw(self, setting, key):
        """A realization."""
        records, samples = setting.weight.shape
        e = self.noise_white * jax.random.normal(key, (records, samples + 1))
        return jnp.where(setting.weight > 0, e[:, 1:] + self.noise_echo * e[:, :-1], 0.0)

    @classmethod
    def start(cls, scales):
        """From the variance and the lag-one correlation of the residuals, which is echo / (1 + echo^2)."""
        correlation = float(np.clip(1 - (scales.white / scales.total) ** 2, 0.02, 0.45))
        echo = (1 - np.sqrt(1 - 4 * correlation**2)) / (2 * correlation)
        return cls(noise_white=scales.total / np.sqrt(1 + echo**2), noise_echo=echo)

    @classmethod
    def of_size(cls, size):
        """Half of e returns."""
        return cls(noise_white=size / np.sqrt(1.25), noise_echo=0.5)

    @classmethod
    def default_priors(cls, longest, curve_size):
        """An echo is positive in this sensor."""
        return {"noise_echo": hf.priors.Uniform(0.0, 1.0)}
'''

SAMPLER = '''
"""Random-walk Metropolis."""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hystfit.sampling.base import AbstractSampler, Raw


@dataclasses.dataclass(frozen=True)
class RandomWalk(AbstractSampler):
    """Metropolis steps in whitened coordinates.

    Attributes:
        chains, draws: how many, and how many each.
        warmup: steps of each chain before its draws.
    """

    name: ClassVar[str] = "random-walk"
    chains: int = 4
    draws: int = 4000
    warmup: int = 200

    def __post_init__(self):
        self.check_counts({"chains": 1, "draws": 4, "warmup": 0})

    def run(self, setup, seed, folder, report):
        """All chains at once; `folder` is not used."""
        d = setup.target.center.shape[0]

        @eqx.filter_jit
        def chains(target, keys):
            def step(carry, key):
                q, log = carry
                move, toss = jax.random.split(key)
                proposed = q + 2.38 / jnp.sqrt(d) * jax.random.normal(move, (d,))
                there = target(proposed)
                accept = jnp.log(jax.random.uniform(toss)) < there - log
                q, log = jnp.where(accept, proposed, q), jnp.where(accept, there, log)
                return (q, log), (q, log, accept)

            begin = jnp.zeros(d)
            run = lambda key: jax.lax.scan(step, (begin, target(begin)), jax.random.split(key, self.warmup + self.draws))[1]
            return jax.lax.map(run, keys)

        q, log_density, accepted = chains(setup.target, jax.random.split(jax.random.key(seed), self.chains))
        report(f"{self.chains * self.draws} draws", 1.0)
        q, log_density, accepted = (np.asarray(v)[:, self.warmup :] for v in (q, log_density, accepted))
        z = np.asarray(setup.target.unwhitened(q))
        return Raw(z, log_density, {"acceptance": accepted.astype(float)})
'''

TRUTH = hf.BoucWen(c=1.0, mu=0.5, tau=2.0, rho=0.5)
NAMES = (
    "c",
    "mu",
    "tau",
    "offset",
)  # rho is fixed: with it the posterior bends, and a random walk needs many more steps
ECHO, WHITE, T = 0.8, 0.01, 600


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("mine")
    (folder / "my_noise.py").write_text(NOISE)
    (folder / "my_sampler.py").write_text(SAMPLER)
    np.savetxt(folder / "loop.csv", np.column_stack([record().u, record().y]), delimiter=",", header="u,y", comments="")
    return folder


def record() -> hf.Record:
    """Growing cycles with the noise of the sensor."""
    phase = np.arange(T) / T
    u = np.sin(2 * np.pi * 8 * phase) * (0.4 + 0.6 * phase)
    e = WHITE * np.random.default_rng(0).normal(size=T + 1)
    return hf.Record(u=u, y=np.asarray(hf.simulate(TRUTH, u)[0]) + e[1:] + ECHO * e[:-1])


def covariance(size: int) -> np.ndarray:
    """Dense covariance of the sensor's noise."""
    beside = np.eye(size, k=1) + np.eye(size, k=-1)
    return WHITE**2 * ((1 + ECHO**2) * np.eye(size) + ECHO * beside)


@pytest.fixture(scope="module")
def fitted(folder) -> hf.FitResult:
    return hf.fit(TRUTH, record(), noise=f"{folder / 'my_noise.py'}:MovingAverage", fix=["rho"], starts=1)


def test_the_noise_model_of_this_file_is_right(folder):
    """Its density is the dense Gaussian, with samples missing."""
    kind = class_from_file(str(folder / "my_noise.py"), "MovingAverage", object)
    noise = kind(noise_white=WHITE, noise_echo=ECHO)
    y = record().y[:50].copy()
    y[[7, 8, 30]] = np.nan
    setting = Setting.of(Batch.of(hf.Record(u=record().u[:50], y=y)))
    on = np.asarray(setting.weight)[0] > 0
    r = 0.01 * np.random.default_rng(1).normal(size=on.size)
    seen = np.flatnonzero(on)
    expected = scipy.stats.multivariate_normal(cov=covariance(on.size)[np.ix_(seen, seen)]).logpdf(r[seen])
    assert float(noise.log_density(setting, jnp.asarray(r)[None])) == pytest.approx(expected, rel=1e-9)


def test_a_fit_with_a_noise_model_of_ones_own(fitted):
    """Standard errors are those of generalized least squares with the dense covariance."""
    assert fitted.usable
    assert fitted.noise.parameters["noise_echo"] == pytest.approx(ECHO, abs=0.15)
    assert fitted.noise.parameters["noise_white"] == pytest.approx(WHITE, rel=0.1)
    output = lambda x: hf.simulate(hf.BoucWen(rho=0.5, **dict(zip(NAMES, x, strict=True))), record().u)[0]
    J = np.asarray(jax.jacfwd(output)(jnp.asarray([float(getattr(TRUTH, name)) for name in NAMES])))
    dense = np.linalg.inv(J.T @ np.linalg.solve(covariance(T), J))
    for name, error in zip(NAMES, np.sqrt(np.diag(dense)), strict=True):
        assert fitted[name].stderr == pytest.approx(error, rel=0.25)
        assert abs(fitted[name].value - float(getattr(TRUTH, name))) < 4 * fitted[name].stderr
    white = hf.fit(TRUTH, record(), noise="iid", fix=["rho"], starts=1)
    assert fitted["offset"].stderr > 1.2 * white["offset"].stderr  # the echo nearly doubles slow noise


@pytest.mark.slow
def test_draws_with_a_noise_model_and_a_sampler_of_ones_own(folder, fitted, tmp_path):
    settings = {"noise": f"{folder / 'my_noise.py'}:MovingAverage", "draws": 6000, "seed": 1}
    posterior = hf.sample(fitted, sampler=f"{folder / 'my_sampler.py'}:RandomWalk", **settings)
    assert posterior.usable, str(posterior)
    assert posterior.draws.shape == (4, 6000, 6)
    assert posterior.priors["noise_echo"] == str(hf.priors.Uniform(0.0, 1.0))
    assert posterior["noise_echo"].mean() == pytest.approx(fitted.noise.parameters["noise_echo"], abs=0.05)
    for name in NAMES:
        assert posterior[name].std() == pytest.approx(fitted[name].stderr, rel=0.15)
    loaded = hf.load_posterior(posterior.save(tmp_path / "draws"))
    np.testing.assert_array_equal(loaded.draws, posterior.draws)
    low, _, high = loaded.bands(record(), 0.9)
    assert np.mean((record().y > low) & (record().y < high)) == pytest.approx(0.9, abs=0.05)
    area = next(quantity for quantity in fitted.quantities if quantity.name == "loop_area")
    areas = posterior.derived()["loop_area"]
    assert np.mean(areas) == pytest.approx(area.value, abs=area.stderr)
    assert np.std(areas) == pytest.approx(area.stderr, rel=0.3)  # 200 draws, and the errors of the fit to first order


def test_classes_and_objects_do_as_well_as_files(folder, fitted):
    noise = class_from_file(str(folder / "my_noise.py"), "MovingAverage", object)
    sampler = class_from_file(str(folder / "my_sampler.py"), "RandomWalk", object)
    again = hf.fit(TRUTH, record(), noise=noise, fix=["rho"], starts=1)
    assert [again[name].value for name in NAMES] == [fitted[name].value for name in NAMES]
    short = {"draws": 50, "chains": 2, "seed": 1}
    names = (f"{folder / name}" for name in ("my_sampler.py:RandomWalk", "my_noise.py:MovingAverage"))
    by_file = hf.sample(fitted, next(names), noise=next(names), **short)
    by_object = hf.sample(fitted, sampler(draws=50, chains=2), noise=noise, seed=1)
    assert by_file.draws.shape == (2, 50, 6)
    assert by_file.priors["noise_echo"] == str(hf.priors.Uniform(0.0, 1.0))
    np.testing.assert_array_equal(by_object.draws, by_file.draws)
    assert _make(sampler, {"draws": 50, "chains": 2}) == sampler(draws=50, chains=2)


@pytest.mark.usefixtures("as_users_run")
def test_files_that_do_not_serve_are_refused(folder, fitted):
    with pytest.raises(ParameterError, match="no class 'Pink'"):
        hf.fit(hf.BoucWen(), record(), noise=f"{folder / 'my_noise.py'}:Pink")
    with pytest.raises(ParameterError, match="no class 'MovingAverage'"):
        hf.sample(fitted, sampler=f"{folder / 'my_noise.py'}:MovingAverage")
    with pytest.raises(ParameterError, match="settings of"):
        hf.sample(fitted, sampler=f"{folder / 'my_sampler.py'}:RandomWalk", walkers=10)


def shell(folder: Path, *arguments: str) -> subprocess.CompletedProcess:
    """The command in a process of its own, in a folder."""
    command = [sys.executable, "-c", "from hystfit.cli import main; main()", *arguments]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=500)


@pytest.mark.slow
def test_the_same_at_the_shell(folder, fitted):
    noise = ("--noise", "my_noise.py:MovingAverage")
    ended = shell(folder, "fit", "loop.csv", "--model", "bouc-wen", "--fix", "rho=0.5", *noise, "--out", "fit")
    assert ended.returncode == 0, ended.stdout + ended.stderr
    content = json.loads((folder / "fit" / "result.json").read_text())
    for name in NAMES:
        assert content["parameters"][name]["value"] == pytest.approx(fitted[name].value, abs=0.1 * fitted[name].stderr)
        assert content["parameters"][name]["stderr"] == pytest.approx(fitted[name].stderr, rel=0.02)
    assert content["problem"]["noise"]["parameters"]["noise_echo"] == pytest.approx(ECHO, abs=0.15)
    sampler = ("--sampler", "my_sampler.py:RandomWalk", "--draws", "6000", "--chains", "4", "--warmup", "300")
    ended = shell(folder, "sample", "fit", *noise, *sampler, "--out", "draws")
    assert ended.returncode == 2  # the fit names a file that would be run
    ended = shell(folder, "sample", "fit", "--trust", *noise, *sampler, "--out", "draws")
    assert ended.returncode == 0, ended.stdout + ended.stderr
    content = json.loads((folder / "draws" / "result.json").read_text())
    assert (content["status"], content["sampler"], content["noise"]) == (
        "ok",
        "random-walk",
        str(folder.resolve() / noise[1]),
    )
    ended = shell(folder, "sample", "fit", "--trust", "--sampler", "my_sampler.py:Missing")
    assert ended.returncode == 2
