"""The part of a problem that is an argument of compiled code: predictions, residuals and their derivatives."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from hystfit.config import shares_programs
from hystfit.data.batch import Batch
from hystfit.inference.blocks import parts
from hystfit.models.shared.shapes import Scalar
from hystfit.models.shared.simulation import run
from hystfit.params.coordinates import Coordinates
from hystfit.params.host_arrays import compiled, to_device
from hystfit.params.plain_module import PlainModule

Loss = Literal["linear", "huber", "soft-l1", "cauchy"]
_STEEPEST = 1e100  # slope beyond which a derivative counts as infinite: its square is still a finite number
BROKEN = 1e3  # value of residuals that are not finite, in half ranges of the output


class Objective(PlainModule):
    """Arrays and structure of a `Problem`, without labels; misfits are divided by `size`, half the range of the output.

    `bend` is the misfit above which a robust loss reduces the influence of a residual; "linear" is plain least squares.
    """

    coordinates: Coordinates
    batch: Batch
    size: Scalar
    bend: Scalar
    loss: Loss = eqx.field(static=True, default="linear")

    def predict(self, x: Float[Array, " p"]) -> Float[Array, "R T"]:
        """Free run of every record at physical parameters x."""
        return by_record(lambda record: self._output(x, record), self.batch.u.shape[0])

    def _output(self, x: Float[Array, " p"], record: Any) -> Float[Array, " T"]:
        """Free run of one record."""
        batch = self.batch
        model = self.coordinates.assemble(x, record)
        return run(model, batch.u[record], batch.dt[record], count=batch.count_of(record))[0]

    def residual(self, x: Float[Array, " p"]) -> Float[Array, "R T"]:
        """Prediction less measurement, output units: 0 where a sample does not count, `BROKEN` half ranges where not finite."""
        return self.counted(self.predict(x) - self.batch.y, self.batch.weight)

    def counted(self, r: Array, weight: Array) -> Array:
        """Residuals of the samples that count, see `residual`."""
        return jnp.where(weight > 0, jnp.where(jnp.isfinite(r), r, BROKEN * self.size), 0.0)

    def linearize(
        self, x: Float[Array, " p"], directions: Float[Array, "k p"] | None = None
    ) -> tuple[Float[Array, "R T"], Float[Array, "R T k"]]:
        """`residual` and its derivatives, with respect to x or along directions, in one forward pass."""
        if directions is None and self.apart:
            r, J = self._all_runs(x)
        else:
            push = lambda t: jax.jvp(self.residual, (x,), (t,))
            r, J = jax.vmap(push, out_axes=(None, 0))(jnp.eye(x.shape[0]) if directions is None else directions)
        return r, jnp.moveaxis(J, 0, -1)

    def linearize_at(self, z: Float[Array, " p"]) -> tuple[Float[Array, " n"], Float[Array, "p n"]]:
        """`misfit_at` and its derivatives, in one forward pass."""
        if not self.apart:
            push = lambda t: jax.jvp(self.misfit_at, (z,), (t,))
            return jax.vmap(push, out_axes=(None, 0))(jnp.eye(z.shape[0]))
        r, J = self._all_runs(self.coordinates.physical(z))
        misfit, J = self._weighed(r, J * self.coordinates.slope(z)[:, None, None])
        return misfit.reshape(-1), J.reshape(len(z), -1)

    def linearize_records_at(self, z: Float[Array, " p"]) -> tuple[Float[Array, "R T"], Float[Array, "R m T"]]:
        """`misfit_at` and its derivatives with respect to each record's own m parameters, see `Coordinates.own`."""
        r, J = self._own_runs(self.coordinates.physical(z))
        misfit, J = self._weighed(r, jnp.moveaxis(J * self.coordinates.slope(z)[self.coordinates.own][..., None], 1, 0))
        return misfit, jnp.moveaxis(J, 0, 1)

    def _weighed(self, r: Float[Array, "R T"], J: Float[Array, "k R T"]) -> tuple[Array, Array]:
        """Residuals and derivatives as they count in the misfit."""
        weigh = lambda r: bend(jnp.sqrt(self.batch.weight) * r / self.size, self.bend, self.loss)
        return jax.vmap(lambda direction: jax.jvp(weigh, (r,), (direction,)), out_axes=(None, 0))(J)

    def with_room(self) -> Objective:
        """In arrays that other records share, see `Batch.with_room`; itself where programs are not to be shared."""
        if not shares_programs():
            return self
        return dataclasses.replace(self, batch=self.batch.with_room())

    @property
    def apart(self) -> bool:
        """Whether each record depends on some of the parameters only, as with an offset for each."""
        return self.coordinates.own_count < len(self.coordinates.kinds)

    def _all_runs(self, x: Array) -> tuple[Float[Array, "R T"], Float[Array, "p R T"]]:
        """`residual` and its derivatives with respect to x."""
        r, own = self._own_runs(x)
        records, samples = r.shape
        spread = (
            jnp.zeros((records, x.shape[0], samples)).at[np.arange(records)[:, None], self.coordinates.own].set(own)
        )
        return r, jnp.moveaxis(spread, 1, 0)

    def _own_runs(self, x: Array) -> tuple[Float[Array, "R T"], Float[Array, "R m T"]]:
        """`residual` and its derivatives with respect to each record's own parameters: all the others are zero."""
        batch, own = self.batch, jnp.asarray(self.coordinates.own)

        def one(record: Any) -> tuple[Array, Array]:
            def residual(x: Array) -> Array:
                return self.counted(self._output(x, record) - batch.y[record], batch.weight[record])

            push = lambda direction: jax.jvp(residual, (x,), (direction,))
            return jax.vmap(push, out_axes=(None, 0))(jax.nn.one_hot(own[record], x.shape[0], dtype=x.dtype))

        return by_record(one, batch.u.shape[0])

    def misfit(self, x: Float[Array, " p"]) -> Float[Array, " n"]:
        """Weighted residuals in half ranges, bent by the loss so that half their sum of squares is the cost: shape (R * T,)."""
        weighted = jnp.sqrt(self.batch.weight) * self.residual(x) / self.size
        return bend(weighted.reshape(-1), self.bend, self.loss)

    def misfit_at(self, z: Float[Array, " p"]) -> Float[Array, " n"]:
        """`misfit` at unconstrained z."""
        return self.misfit(self.coordinates.physical(z))

    def broken(self, r: Float[Array, "R T"]) -> Array:
        """Whether a residual is not finite, or as large as `BROKEN`."""
        return jnp.any(jnp.abs(r) >= BROKEN * self.size)


def by_record(function: Callable[[Any], Any], count: int) -> Any:
    """A function of each record's number, one after another; a single record needs no loop."""
    if count == 1:
        return jax.tree_util.tree_map(lambda value: value[None], function(0))
    return jax.lax.map(function, jnp.arange(count))


def bend(r: Array, at: Array, loss: Loss) -> Array:
    """sign(r) sqrt(rho(r^2)) for the loss rho: any least-squares solver then minimizes the robust cost."""
    if loss == "linear":
        return r
    square = (r / at) ** 2
    if loss == "soft-l1":
        ratio = 2.0 / (1.0 + jnp.sqrt(1.0 + square))
    elif loss == "cauchy":
        ratio = jnp.where(square > 1e-12, jnp.log1p(square) / jnp.where(square > 1e-12, square, 1.0), 1.0)
    else:
        outer = jnp.maximum(square, 1.0)
        ratio = jnp.where(square > 1.0, (2.0 * jnp.sqrt(outer) - 1.0) / outer, 1.0)
    return r * jnp.sqrt(ratio)


_linearize = compiled(Objective.linearize)
_linearize_own = compiled(Objective._own_runs)
_predict = compiled(Objective.predict)


def predicted(objective: Objective, x: Any, counts: Int[np.ndarray, " R"]) -> Float[np.ndarray, "R T"]:
    """`Objective.predict` on the host, of the first samples of each record, as far as the arrays of the objective go."""
    counts = np.minimum(counts, objective.batch.u.shape[1])
    wide = dataclasses.replace(objective, batch=objective.batch.with_room(counts))
    return np.asarray(_predict(wide, to_device(x)))


def linearized(
    objective: Objective, x: Any, at: np.ndarray | None = None
) -> tuple[Float[np.ndarray, "R T"], Float[np.ndarray, "R T k"]]:
    """`Objective.linearize` on the host, by one compiled program for all uses; derivatives too large to be squared are set to 0.

    `at` are numbers of the parameters to differentiate by, in rising order; None for all. On long records, derivatives are computed in
    groups that fit into a block, by one program.
    """
    x = np.asarray(x, float)
    samples, wide = objective.batch.u.shape[1], objective.with_room()
    if objective.apart:
        residual, jacobian = _linearized_apart(wide, x, np.arange(x.size) if at is None else at)
        return residual[:, :samples], jacobian[:, :samples]
    every = at is None or len(at) == x.size
    directions = np.eye(x.size) if at is None else np.eye(x.size)[at]
    groups = list(parts(len(directions), objective.batch.u.size))
    if len(groups) <= 1:
        residual, jacobian = (np.asarray(values) for values in _linearize(wide, x, None if every else directions))
        return residual[:, :samples], flat(jacobian[:, :samples])
    out = np.empty((*objective.batch.u.shape, len(directions)))
    for group in groups:
        some = np.zeros((groups[0].stop, x.size))
        some[: group.stop - group.start] = directions[group]
        residual, jacobian = (np.asarray(values) for values in _linearize(wide, x, some))
        out[..., group] = flat(jacobian[:, :samples, : group.stop - group.start])
    return residual[:, :samples], out


def linearized_runs(
    objective: Objective, x: Float[np.ndarray, " p"]
) -> tuple[Float[np.ndarray, "R T"], Float[np.ndarray, "R m T"]]:
    """`Objective.residual` on the host and its derivatives with respect to each record's own m parameters, by the same program."""
    samples, wide = objective.batch.u.shape[1], objective.with_room()
    if objective.apart:
        residual, own = _linearize_own(wide, x)
        return np.asarray(residual)[:, :samples], np.asarray(own)[..., :samples]
    residual, jacobian = _linearize(wide, x, None)
    return np.asarray(residual)[:, :samples], np.moveaxis(np.asarray(jacobian)[:, :samples], -1, 1)


def _linearized_apart(
    objective: Objective, x: Float[np.ndarray, " p"], at: np.ndarray
) -> tuple[Float[np.ndarray, "R T"], Float[np.ndarray, "R T k"]]:
    """`linearized` by the derivatives of each record with respect to its own parameters."""
    residual, own = (np.asarray(values) for values in _linearize_own(objective, x))
    place = np.full(x.size, -1)
    place[at] = np.arange(len(at))
    out = np.zeros((*residual.shape, len(at)))
    for rows, derivatives, positions in zip(out, own, objective.coordinates.own, strict=True):
        wanted = place[positions] >= 0
        rows[:, place[positions[wanted]]] = derivatives[wanted].T
    return residual, flat(out)


def flat(jacobian: np.ndarray) -> np.ndarray:
    """A Jacobian whose infinite entries (a root at zero, an unstable simulation) are set to 0."""
    if jacobian.max(initial=0.0) < _STEEPEST and jacobian.min(initial=0.0) > -_STEEPEST:
        return jacobian
    return np.where(np.abs(jacobian) < _STEEPEST, jacobian, 0.0)


def misfit_of(objective: Objective, residual: np.ndarray, jacobian: np.ndarray | None = None) -> Any:
    """`Objective.misfit` on the host from residuals, shape (n,), and its derivatives, shape (n, p), where these are given.

    The residuals have shape (R, T), their derivatives (R, T, p); the derivatives are overwritten where they may be.
    """
    misfit, slope = misfit_slope(objective, residual)
    if jacobian is None:
        return misfit
    own = jacobian if jacobian.flags.writeable else jacobian.copy()
    return misfit, np.multiply(own, slope.reshape(residual.shape)[..., None], out=own).reshape(-1, jacobian.shape[-1])


def misfit_slope(
    objective: Objective, residual: Float[np.ndarray, "R T"]
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """`Objective.misfit` on the host of residuals in output units, and its derivative with respect to each."""
    root = np.sqrt(np.asarray(objective.batch.weight)) / float(objective.size)
    misfit, slope = (root * residual).reshape(-1), root.reshape(-1)
    if objective.loss == "linear":
        return misfit, slope
    bent, bending = (np.asarray(v) for v in bend_slope(to_device(misfit), objective.bend, objective.loss))
    return bent, bending * slope


@compiled
def bend_slope(r: Array, at: Array, loss: Loss) -> tuple[Array, Array]:
    """`bend` and its derivative with respect to r."""
    return jax.jvp(lambda r: bend(r, at, loss), (r,), (jnp.ones_like(r),))
