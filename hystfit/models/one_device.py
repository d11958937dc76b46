"""Refuse a model that holds several devices, where one is needed."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hystfit.errors import ParameterError


def check_one_device(model: Any) -> None:
    """Refuse a model whose parameters have a leading axis, one element a device.

    Raises:
        ParameterError: it is not one device.
    """
    if any(np.ndim(leaf) == 0 for leaf in jax.tree.leaves(model)):
        return
    zero = jnp.zeros(())
    try:
        shape = jax.eval_shape(lambda m: m.step(m.init(zero), zero, zero, zero)[1], model).shape
    except (TypeError, ValueError):
        shape = None
    if shape != ():
        raise ParameterError(
            f"{type(model).__name__} holds several devices: take one by jax.tree.map(lambda leaf: leaf[0], model), or make them "
            "by Actuator.population or Stage.population"
        )
