"""Process-wide settings of JAX: double precision and whole scan loops. Importing this module imports no numerical library."""

import numbers
import os

from hystfit.errors import ParameterError, PrecisionError

# XLA compiles a scan on a CPU into one native loop only while its body is below a threshold of about 1 kB, and dispatches every
# operation of every step otherwise: 3 to 10 times slower for the larger models, measured on their fits.
_whole_loops_wanted = True
PROGRAM_FOLDER = "HYSTFIT_PROGRAM_FOLDER"  # variable with the folder of traced programs; the command sets it
_WHOLE_LOOPS = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000"


def compile_whole_loops() -> None:
    """Have XLA compile scan loops whole, however large their body, unless the user has set XLA_FLAGS.

    XLA reads the flag when JAX computes for the first time in a process; it has no effect after that. The first model that is imported
    sets it, so that it is there for those who switch JAX to double precision themselves.
    """
    if _whole_loops_wanted and not os.environ.get("XLA_FLAGS"):
        os.environ["XLA_FLAGS"] = _WHOLE_LOOPS


def enable_x64(*, whole_loops: bool = True) -> None:
    """Switch JAX to double precision for this process; call it before any computation.

    Args:
        whole_loops: also compile scan loops whole, see `compile_whole_loops`; False, before the first model is imported, leaves the
            choice to XLA.
    """
    global _whole_loops_wanted
    import jax

    jax.config.update("jax_enable_x64", True)
    _whole_loops_wanted = whole_loops
    compile_whole_loops()


def require_x64() -> None:
    """Refuse single precision.

    Raises:
        PrecisionError: double precision is off.
    """
    import jax

    if not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        raise PrecisionError("hystfit computes in double precision: call hystfit.enable_x64() before anything else")


def require_seed(seed: int) -> int:
    """Refuse what some random number generators do not accept as a seed, before any work.

    Raises:
        ParameterError: not a whole number from 0 to 2^32 - 1.
    """
    if isinstance(seed, bool) or not isinstance(seed, numbers.Integral) or not 0 <= seed < 2**32:
        raise ParameterError(f"a seed is a whole number from 0 to {2**32 - 1}, got {seed!r}")
    return int(seed)
