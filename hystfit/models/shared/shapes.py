"""Annotations of arrays that models share; jaxtyping checks the shapes in tests."""

from jaxtyping import Array, Float

Scalar = Float[Array, ""]
State = Float[Array, " state"]
Signal = Float[Array, " T"]
