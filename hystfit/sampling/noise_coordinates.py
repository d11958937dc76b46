"""Coordinates of white and slow noise in which the posterior is nearly normal whatever the data say about them.

Slow noise cannot be told from white noise where it is small: in the logarithms z of both standard deviations the posterior then is flat,
as far as the prior goes, up to a wall that is the steeper the more samples there are, and whose place depends on the correlation time.
No step size suits both. The same holds for white noise below a slow part that dominates. With s, w and tau the standard deviations
of slow and white noise and the correlation time in samples, the coordinates are

    a    log of the standard deviation of the innovations, which the data determine to one part in the root of twice the number of
         samples whatever the shape of the spectrum (Kolmogorov and Szego: its logarithm is the mean of that of the spectrum),
    c    b + g(b, tau), where b = log(s / w), and g is the distance of the spectrum from that of white noise in standard errors,

and that of tau stays. Where the data say nothing c is b, so that it ranges over the prior; beyond, it grows by one with each
standard error.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.inference.density import Density
from hystfit.params.host_arrays import to_device
from hystfit.params.param import leaves_of


class NoiseCoordinates(eqx.Module):
    """The map between z and coordinates w that have (a, c) in the places of the logarithms of (w, s)."""

    places: tuple[int, int, int] = eqx.field(static=True)  # of w, s and tau in z
    ratio: Float[Array, ""]  # b where both z are 0
    time: tuple[Array, Array]  # logarithms of the least tau and of the scale of its excess over that
    count: Float[Array, ""]  # of the samples

    @classmethod
    def of(cls, density: Density) -> NoiseCoordinates | None:
        """Those of the noise of a density; None where it has no white and slow parts."""
        coordinates = density.noise
        noise = coordinates.assemble(coordinates.physical(np.zeros(len(coordinates.kinds)), np), place=np.asarray)
        if noise.parts is None:
            return None
        names = [leaf.path[-1] for leaf in leaves_of(noise)]
        white, slow, time = (names.index(name) for name in noise.parts)
        scale, least = np.log(np.asarray(coordinates.scale)), np.log(np.asarray(coordinates.lower)[time])
        places = (density.p + white, density.p + slow, density.p + time)
        ends = (to_device(least), to_device(scale[time]))
        return cls(places, to_device(scale[slow] - scale[white]), ends, to_device(density.setting.count))

    def of_z(self, z: Float[Array, "... d"]) -> Float[Array, "... d"]:
        """w from z."""
        i, j, _ = self.places
        b, t = z[..., j] - z[..., i] + self.ratio, self._log_time(z)
        return z.at[..., i].add(_innovation(b, t)).at[..., j].set(b + _distance(b, t, self.count))

    def z_of(self, w: Float[Array, "... d"]) -> Float[Array, "... d"]:
        """z from w."""
        return self._z_of(w, *self._of_spectrum(w))

    def z_and_slope(self, w: Float[Array, " d"]) -> tuple[Float[Array, " d"], Float[Array, ""]]:
        """z from w, and log |det dz/dw|."""
        b, t = self._of_spectrum(w)
        return self._z_of(w, b, t), -jnp.log1p(_by_ratio(b, t, self.count))

    def _of_spectrum(self, w: Float[Array, "... d"]) -> tuple[Array, Array]:
        """b, and the logarithm of tau."""
        t = self._log_time(w)
        return _ratio(w[..., self.places[1]], t, self.count), t

    def _z_of(self, w: Float[Array, "... d"], b: Array, t: Array) -> Float[Array, "... d"]:
        i, j, _ = self.places
        white = w[..., i] - _innovation(b, t)
        return w.at[..., i].set(white).at[..., j].set(white + b - self.ratio)

    def _log_time(self, z: Float[Array, "... d"]) -> Array:
        return jnp.logaddexp(self.time[0], z[..., self.places[2]] + self.time[1])


def _innovation(b: Array, t: Array) -> Array:
    """log of the standard deviation of innovations over that of the white noise, after many samples."""
    ratio, lost = jnp.exp(2 * b), -jnp.expm1(-2 * jnp.exp(-t))
    bend = lost * (1 - ratio)
    root = 0.5 * (jnp.abs(bend) + jnp.sqrt(bend**2 + 4 * lost * ratio))
    return 0.5 * jnp.log1p(jnp.where(bend > 0, lost * ratio / root, root))


def _distance(b: Array, t: Array, count: Array) -> Array:
    """Distance of the spectrum from that of white noise, in standard errors; rises with b.

    Of the first term, the slow part's share f of the variance gives autocorrelations f exp(-k / tau), each known to 1 / sqrt(count);
    beyond f tau = 1 only frequencies below that at which the slow part meets the white one tell more. The second term is the
    autocorrelation at one sample that the white part gives to the innovations of the slow one, where that one dominates.
    """
    x = 2 * jnp.exp(-t)
    share, decay, lost = jax.nn.sigmoid(2 * b), jnp.exp(-0.5 * x), -jnp.expm1(-x)
    root = decay / jnp.sqrt(lost)  # of the sum of exp(-2 k / tau) over the lags k
    slow = share * root * (1 + 2 * share * root**2) ** -0.75
    most = 1 + decay**2
    ratio = 2 * b + jnp.log(lost)  # log of the variance of the slow part's innovations over that of the white one
    return jnp.sqrt(count) * (slow + share * decay / most * jax.nn.sigmoid(ratio - jnp.log(most)))


def _by_ratio(b: Array, t: Array, count: Array) -> Array:
    """Derivative of `_distance` with respect to b."""
    return jax.jvp(lambda b: _distance(b, t, count), (b,), (jnp.ones_like(b),))[1]


@jax.custom_jvp
def _ratio(c: Array, t: Array, count: Array) -> Array:
    """b from c."""
    low, high = c - _distance(jnp.full_like(c, jnp.inf), t, count), c

    def halve(_: int, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        middle = 0.5 * (ends[0] + ends[1])
        above = middle + _distance(middle, t, count) > c
        return jnp.where(above, ends[0], middle), jnp.where(above, middle, ends[1])

    improve = lambda _, b: b - (b + _distance(b, t, count) - c) / (1 + _by_ratio(b, t, count))
    low, high = jax.lax.fori_loop(0, 16, halve, (low, high))  # until b is known to a hundredth
    return jax.lax.fori_loop(0, 4, improve, 0.5 * (low + high))  # to all digits


@_ratio.defjvp
def _ratio_slope(primals: tuple[Array, ...], tangents: tuple[Any, ...]) -> tuple[Array, Array]:
    (c, t, count), (dc, dt, _) = primals, tangents
    b = _ratio(c, t, count)
    by_time = jax.jvp(lambda t: _distance(b, t, count), (t,), (jnp.ones_like(t),))[1]
    return b, (dc - by_time * dt) / (1 + _by_ratio(b, t, count))
