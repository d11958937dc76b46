"""Double precision and fast loops, enabled by the user in one line and required by every verb that needs them."""

import os

import jax
import numpy as np

from hystfit.errors import ParameterError, PrecisionError

# XLA compiles a scan on a CPU into one native loop only while its body is below a threshold of about 1 kB, and dispatches every
# operation of every step otherwise: 3 to 10 times slower for the larger models, measured on their fits.
_WHOLE_LOOPS = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000"


def enable_x64(*, whole_loops: bool = True) -> None:
    """Switch JAX to double precision for this process; call it before any computation.

    Args:
        whole_loops: also let XLA compile scan loops with large bodies as a whole, unless XLA_FLAGS is already set. This has an
            effect only before JAX computes for the first time.
    """
    jax.config.update("jax_enable_x64", True)
    if whole_loops and not os.environ.get("XLA_FLAGS"):
        os.environ["XLA_FLAGS"] = _WHOLE_LOOPS


def require_x64() -> None:
    """Refuse single precision.

    Raises:
        PrecisionError: double precision is off.
    """
    if not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        raise PrecisionError("hystfit fits in double precision; call hystfit.enable_x64() before anything else")


def require_seed(seed: int) -> int:
    """Check a seed of random numbers.

    Raises:
        ParameterError: not a whole number from 0 to 2^32 - 1.
    """
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or not 0 <= seed < 2**32:
        raise ParameterError(f"a seed is a whole number from 0 to {2**32 - 1}, got {seed!r}")
    return int(seed)
