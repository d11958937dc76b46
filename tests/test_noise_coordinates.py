"""Coordinates of white and slow noise beside differences, spectra and the distance between two normal distributions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

import hystfit as hf
from hystfit.inference.density import Density
from hystfit.inference.noise import OrnsteinUhlenbeck
from hystfit.inference.problem import Problem
from hystfit.sampling.noise_coordinates import NoiseCoordinates

COUNT = 300
PLACES = slice(-3, None)


@pytest.fixture(scope="module")
def density() -> Density:
    hf.enable_x64()
    u = np.sin(np.arange(COUNT) / 5)
    record = hf.Record(u=u, y=u + 0.1 * np.cos(np.arange(COUNT) / 3))
    return Problem(hf.BoucWen(), record).with_noise(OrnsteinUhlenbeck.of_size(0.1)).density


@pytest.fixture(scope="module")
def coordinates(density) -> NoiseCoordinates:
    made = NoiseCoordinates.of(density)
    assert made is not None
    return made


def of_noise(density: Density, white: float, slow: float, time: float) -> jax.Array:
    """z of a noise, with zeros for the model."""
    values = density.noise.unconstrained(jnp.asarray([white, slow, time]))
    return jnp.concatenate([jnp.zeros(density.p), values])


def change(density: Density, coordinates: NoiseCoordinates, slow: float, time: float) -> float:
    """c less b."""
    z = of_noise(density, 1.0, slow, time)
    return float(coordinates.of_z(z)[-2]) - np.log(slow)


def test_the_map_is_invertible_and_its_volume_that_of_differences(density, coordinates):
    rng = np.random.default_rng(0)
    z = jnp.asarray(rng.normal(size=(50, density.p + 3)) * [*[1.0] * density.p, 4.0, 4.0, 3.0])
    w, back = coordinates.of_z(z), jax.jit(lambda w: coordinates.z_of(w))
    np.testing.assert_allclose(back(w), z, atol=1e-12)
    np.testing.assert_array_equal(w[:, : density.p], z[:, : density.p])
    steps = 1e-5 * np.eye(z.shape[1])
    slopes = np.stack([back(w + e) - back(w - e) for e in steps], axis=-1) / 2e-5
    np.testing.assert_allclose(jax.jit(jax.vmap(jax.jacrev(lambda w: coordinates.z_of(w))))(w), slopes, atol=1e-6)
    volumes = jax.jit(jax.vmap(lambda w: coordinates.z_and_slope(w)[1]))(w)
    np.testing.assert_allclose(volumes, np.linalg.slogdet(slopes)[1], atol=1e-6)


@pytest.mark.parametrize("slow", [0.01, 1.0, 100.0])
@pytest.mark.parametrize("time", [1.01, 3.0, 50.0])
def test_the_scale_is_that_of_the_innovations(density, coordinates, slow, time):
    """By the theorem of Szego, from the spectrum of white noise and an autoregression."""
    decay, frequency = np.exp(-1 / time), np.linspace(0, np.pi, 200_001)
    spectrum = 1 + slow**2 * (1 - decay**2) / np.abs(1 - decay * np.exp(-1j * frequency)) ** 2
    want = 0.5 * np.trapezoid(np.log(spectrum), frequency) / np.pi
    scale = np.log(np.asarray(density.noise.scale)[0])
    assert float(coordinates.of_z(of_noise(density, 1.0, slow, time))[-3]) == pytest.approx(want - scale, abs=1e-4)


def test_noises_that_cannot_be_told_apart_keep_the_ratio_of_their_parts(density, coordinates):
    for time in (1.01, 30.0):
        assert abs(change(density, coordinates, 1e-6, time)) < 1e-6
        both = [change(density, coordinates, slow, time) for slow in (1e6, 1e8)]
        assert both[0] == pytest.approx(both[1], rel=1e-6)  # white noise below it that no data show


@pytest.mark.parametrize("time", [1.01, 5.0])
def test_the_distance_from_white_noise_is_in_standard_errors(density, coordinates, time):
    """Half its square is the expected log likelihood ratio of two normal distributions, at a distance of about one."""
    slow = 0.2 if time > 2 else 0.4
    correlated = np.eye(COUNT) + slow**2 * scipy.linalg.toeplitz(np.exp(-np.arange(COUNT) / time))
    white = np.trace(correlated) / COUNT
    ratio = 0.5 * (COUNT * np.log(white) - np.linalg.slogdet(correlated)[1])
    assert change(density, coordinates, slow, time) == pytest.approx(np.sqrt(2 * ratio), rel=0.2)
