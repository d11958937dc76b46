"""Double precision and fast loops: switched on by the user in one line, asked for by every verb that needs it."""

import os

import jax

from hystfit.errors import PrecisionError

# XLA compiles a scan on a CPU into one native loop only while its body is below a threshold of about 1 kB, and dispatches every
# operation of every step otherwise: 3 to 10 times slower for the larger models, measured on their fits.
_WHOLE_LOOPS = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000"


def enable_x64(*, whole_loops: bool = True) -> None:
    """Switch JAX to double precision for this process; call it before any computation.

    Args:
        whole_loops: also have XLA compile scan loops whole, however large their body, unless XLA_FLAGS is already set. It is read
            when JAX computes for the first time, and does nothing after that.
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
