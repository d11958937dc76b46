"""Constant-Jacobian kinematics of a 3-RRR stage with three-fold symmetry, and identification of the Jacobian from a drive in turn."""

from __future__ import annotations

import dataclasses
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hystfit.errors import DataError, ParameterError
from hystfit.models.shared.shapes import Scalar
from hystfit.params.param import param

AXES = ("x", "y", "theta")
UNITS = {"x": "um", "y": "um", "theta": "mrad"}


class Kinematics(eqx.Module):
    """Small motion of the platform: actuator i pushes along psi_i = direction + 120 deg i, with an arm about the center (eq. (20)).

        extension_i = (x cos psi_i + y sin psi_i + arm theta) / amplification

    Lengths in um, theta in mrad, so that the arm is in um per mrad (its length in mm).
    """

    amplification: Scalar = param(6.44, bounds=(0.0, np.inf), doc="lever ratio, platform over actuator")
    arm: Scalar = param(40.0, bounds=(0.0, np.inf), doc="moment arm about the center [um/mrad]")
    direction: Scalar = param(0.0, doc="direction of the first actuator [rad]")

    def jacobian(self) -> Float[Array, "3 3"]:
        """(x, y, theta) [um, um, mrad] from extensions [um], in closed form."""
        psi = self.direction + 2 * jnp.pi / 3 * jnp.arange(3)
        turn = jnp.broadcast_to(0.5 / self.arm, psi.shape)
        return (2 * self.amplification / 3) * jnp.stack([jnp.cos(psi), jnp.sin(psi), turn])

    def pose(self, extensions: Float[Array, "*T 3"]) -> Float[Array, "*T 3"]:
        """Poses of extensions [um], shape (..., 3), without dynamics."""
        return extensions @ self.jacobian().T


@dataclasses.dataclass(frozen=True)
class JacobianEstimate:
    """An identified Jacobian.

    Attributes:
        jacobian: (x, y, theta) from extensions, shape (3, 3).
        stderr: standard errors of its entries for independent residuals, shape (3, 3).
        offset: pose at zero extension, shape (3,).
        residual: RMS residual of each axis, shape (3,).
    """

    jacobian: np.ndarray
    stderr: np.ndarray
    offset: np.ndarray
    residual: np.ndarray


def identify_jacobian(extensions: Any, poses: Any) -> JacobianEstimate:
    """Least-squares Jacobian from actuator extensions (strain gauges) and poses (probes), both of shape (T, 3).

    Drive the actuators one after another, or each at its own frequency, over their range.

    Raises:
        DataError: shapes that differ, too few samples, values that are not finite.
        ParameterError: the actuators do not move independently, so that the Jacobian is not determined.
    """
    extensions, poses = np.asarray(extensions, dtype=float), np.asarray(poses, dtype=float)
    if extensions.shape != poses.shape or extensions.ndim != 2 or extensions.shape[1] != 3 or len(poses) < 5:
        raise DataError(
            f"need extensions and poses of one shape (T, 3), T > 4; got {extensions.shape} and {poses.shape}"
        )
    if not (np.isfinite(extensions).all() and np.isfinite(poses).all()):
        raise DataError("extensions and poses must be finite: remove rows with missing values")
    columns = np.column_stack([extensions, np.ones(len(extensions))])
    centered = extensions - extensions.mean(axis=0)
    singular = np.linalg.svd(centered, compute_uv=False)
    if singular[-1] < 1e-6 * max(singular[0], 1e-300):
        raise ParameterError(
            "the three actuators do not move independently: drive each by itself, or at its own frequency"
        )
    solution, *_ = np.linalg.lstsq(columns, poses, rcond=None)
    residuals = poses - columns @ solution
    variance = np.sum(residuals**2, axis=0) / (len(poses) - 4)
    spread = np.diag(np.linalg.inv(columns.T @ columns))[:3]
    return JacobianEstimate(
        jacobian=solution[:3].T,
        stderr=np.sqrt(np.outer(variance, spread)),
        offset=solution[3],
        residual=np.sqrt(np.mean(residuals**2, axis=0)),
    )


def drive_in_turn(t: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One signal for each actuator in turn, for `identify_jacobian`.

    Args:
        t: times of the signal [s], shape (T,).
        u: the signal [V], shape (T,). Each actuator rests at its first value before its turn and at its last value after it.

    Returns:
        Times, shape (3 T,), and voltages, shape (3 T, 3).
    """
    length, step = t.size, float(np.median(np.diff(t)))
    volts = np.concatenate([np.full((3 * length, 1), u[0])] * 3, axis=1)
    for k in range(3):
        volts[k * length : (k + 1) * length, k] = u
        volts[(k + 1) * length :, k] = u[-1]
    return np.concatenate([t + k * (t[-1] - t[0] + step) for k in range(3)]), volts
