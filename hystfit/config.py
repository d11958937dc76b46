"""Process-wide settings of JAX: double precision and flags of its compiler. Importing this module imports no numerical library."""

import numbers
import os

from hystfit.errors import ParameterError, PrecisionError

# XLA compiles a scan on a CPU into one native loop only while its body is below a threshold of about 1 kB, and dispatches every
# operation of every step otherwise: 3 to 10 times slower for the larger models, measured on their fits.
_whole_loops_wanted = True
PROGRAM_FOLDER = "HYSTFIT_PROGRAM_FOLDER"  # variable with the folder of traced programs; the command sets it
_WHOLE_LOOPS = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000"
# The emitters of jaxlib 0.10 that use MLIR take 30 % longer to compile our programs, which are no faster with them. XLA ends a process
# at a flag that it does not know, and jaxlib 0.12 does not know this one.
_LLVM_EMITTERS = "--xla_cpu_use_fusion_emitters=false"
_HAS_LLVM_EMITTERS = "0.10."


def set_compiler_flags() -> None:
    """Have XLA compile scan loops whole, however large their body, and sooner, unless the user has set XLA_FLAGS.

    XLA reads the flags when JAX computes for the first time in a process; they have no effect after that. The first model that is
    imported sets them, so that they are there for those who switch JAX to double precision themselves.
    """
    if os.environ.get("XLA_FLAGS") or not _whole_loops_wanted:
        return
    from jaxlib.version import __version__

    flags = [_WHOLE_LOOPS, *([_LLVM_EMITTERS] if __version__.startswith(_HAS_LLVM_EMITTERS) else [])]
    os.environ["XLA_FLAGS"] = " ".join(flags)


def enable_x64(*, whole_loops: bool = True) -> None:
    """Switch JAX to double precision for this process; call it before any computation.

    Args:
        whole_loops: also compile scan loops whole, see `set_compiler_flags`; False, before the first model is imported, leaves all
            flags to XLA.
    """
    global _whole_loops_wanted
    import jax

    jax.config.update("jax_enable_x64", True)
    _whole_loops_wanted = whole_loops
    set_compiler_flags()


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
