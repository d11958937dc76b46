"""A Preisach model whose masses may have either sign."""

from __future__ import annotations

from typing import ClassVar

from jaxtyping import Array, Float

from hystfit.models.preisach.model import Preisach
from hystfit.params.param import param


class SignedPreisach(Preisach):
    """`Preisach` with masses and slopes of either sign: closer to reversal curves that cross or are not congruent, without an inverse.

    The output need not rise with the input, because cells of negative mass switch against it.
    """

    has_inverse: ClassVar[bool] = False
    either_way: ClassVar[bool] = True
    no_inverse: ClassVar[str] = (
        "Preisach masses of either sign have no inverse, because the output need not rise with the input: fit the model with "
        "weights >= 0 (preisach-forc)"
    )
    needs: ClassVar[None] = None  # as `Preisach`, which `check` judges

    w: Float[Array, " cells"] = param(
        unit="y", scale=0.01, linear=True, doc="weights of the cells or relays, (i, j) row by row, j <= i"
    )
    slopes: Float[Array, " intervals"] = param(
        (), unit="y", scale=0.1, linear=True, doc="rises of the piecewise linear reversible part"
    )
