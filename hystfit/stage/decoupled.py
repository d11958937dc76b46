"""Feed-forward and feedback of the three-axis stage for `run_loop`: both act on the actuators, through the inverse Jacobian."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hystfit.control import AbstractController, AbstractRunningInverse, Controller, InverseStep
from hystfit.control.online_inverse import Answer, Limits
from hystfit.errors import ParameterError
from hystfit.models.base import AbstractHysteresis
from hystfit.models.shared.simulation import Resume


class StageInverse(AbstractRunningInverse):
    """Voltages for poses: extensions by the inverse Jacobian, then the inverse of each actuator.

    Attributes:
        inverses: of the actuators, arrays with a leading axis of 3.
        jacobian: pose from extensions, shape (3, 3).
    """

    inverses: InverseStep
    jacobian: Float[Array, "3 3"]

    @classmethod
    def of(cls, actuators: Sequence[AbstractHysteresis], jacobian: Any, *, limits: Limits) -> StageInverse:
        """The inverse of identified actuators behind a Jacobian.

        Args:
            actuators: three models of one structure, voltage [V] to extension [um].
            jacobian: pose from extensions, shape (3, 3), as `identify_jacobian` finds it.
            limits: lowest and highest voltage [V].

        Raises:
            ParameterError: not three actuators, or a Jacobian of another shape.
        """
        jacobian = jnp.asarray(jacobian, dtype=jnp.result_type(float))
        if len(actuators) != 3 or jacobian.shape != (3, 3):
            raise ParameterError(
                f"a stage has three actuators and a Jacobian of shape (3, 3); got {len(actuators)} and {jacobian.shape}"
            )
        inverses = [InverseStep.of(model, limits=limits) for model in actuators]
        return cls(jax.tree.map(lambda *leaves: jnp.stack(leaves), *inverses), jacobian)

    def init(self, u0: Any = 0.0) -> Resume:
        """The actuators in equilibrium at voltages, shape () or (3,)."""
        u0 = jnp.broadcast_to(jnp.asarray(u0, dtype=self.jacobian.dtype), (3,))
        return eqx.filter_vmap(lambda inverse, u: inverse.init(u))(self.inverses, u0)

    def step(self, memory: Resume, target: Any, dt: Any = 0.0) -> tuple[Resume, Answer]:
        """See the base class; target and the answer's y are poses, shape (3,)."""
        lengths = jnp.linalg.solve(self.jacobian, target)
        each = eqx.filter_vmap(lambda inverse, *state_and_length: inverse.step(*state_and_length, dt))
        memory, answer = each(self.inverses, memory, lengths)
        return memory, answer._replace(y=self.jacobian @ answer.y)

    def moved(self, memory: Resume, u: Array, dt: Any = 0.0) -> Resume:
        return eqx.filter_vmap(lambda inverse, *state_and_u: inverse.moved(*state_and_u, dt))(self.inverses, memory, u)


class Decoupled(AbstractController):
    """The same controller for every actuator, fed with the error of its extension: the inverse Jacobian of the error of the pose.

    Attributes:
        controller: of one actuator, extension error [um] to voltage [V].
        jacobian: pose from extensions, shape (3, 3).
    """

    controller: Controller
    jacobian: Float[Array, "3 3"]

    def init(self) -> Array:
        """State of the three controllers at rest, shape (3, n)."""
        return jnp.zeros((3, *self.controller.B.shape), self.controller.B.dtype)

    def ask(self, state: Array, error: Array) -> Array:
        """Voltages for an error of the pose, shape (3,)."""
        return jax.vmap(self.controller.ask)(state, jnp.linalg.solve(self.jacobian, error))

    def step(self, state: Array, error: Array, taken: Any = 0.0) -> Array:
        taken = jnp.broadcast_to(taken, (3,))
        return jax.vmap(self.controller.step)(state, jnp.linalg.solve(self.jacobian, error), taken)
