"""Process-wide settings: precision, device and compiler of JAX, threads of linear algebra. Importing it loads no numerical library."""

import contextlib
import contextvars
import ctypes
import functools
import numbers
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any, Literal, ParamSpec, TypeVar

from hystfit.errors import ParameterError, PrecisionError

_P = ParamSpec("_P")
_R = TypeVar("_R")

# On a CPU, XLA compiles a scan into one native loop only if its body is below a threshold of about 1 kB. Otherwise it dispatches every
# operation of every step, which made fits of the larger models 3 to 10 times slower.
_whole_loops_wanted = True
PROGRAM_FOLDER = (
    "HYSTFIT_PROGRAM_FOLDER"  # environment variable with the folder of traced programs; the command line sets it
)
_WHOLE_LOOPS = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000"
# Use the full width of the vector registers; the default of XLA is half of it. A pass of Bouc-Wen over 16 lanes took 0.6 of the time, over
# one lane 0.85 to 1.
_WIDE_VECTORS = "--xla_cpu_prefer_vector_width=512"
# The MLIR emitters of jaxlib 0.10 take 30 % longer to compile our programs, which are no faster with them. XLA ends the process at an
# unknown flag, and jaxlib 0.12 no longer has this one.
_LLVM_EMITTERS = "--xla_cpu_use_fusion_emitters=false"
_HAS_LLVM_EMITTERS = "0.10."


def set_compiler_flags() -> None:
    """Set XLA_FLAGS for scans compiled as whole loops, wide vectors and fast compilation, unless the user has set XLA_FLAGS.

    XLA reads the flags at the first computation of a process. Importing the first model sets them too, for users who switch JAX to double
    precision without `enable_x64`.
    """
    if os.environ.get("XLA_FLAGS") or not _whole_loops_wanted:
        return
    from jaxlib.version import __version__

    flags = [_WHOLE_LOOPS, _WIDE_VECTORS, *([_LLVM_EMITTERS] if __version__.startswith(_HAS_LLVM_EMITTERS) else [])]
    os.environ["XLA_FLAGS"] = " ".join(flags)


# Compiling without optimization takes 0.3 to 0.4 of the time, and the program 1.5 to 2.2 times as long (normal equations of four models).
# With the widest vectors LLVM then gave a Preisach inverse a wrong sign; the tests run in this form.
_UNOPTIMIZED = {"xla_backend_optimization_level": 0, "xla_cpu_prefer_vector_width": 256}
_runs: contextvars.ContextVar[Literal["many", "few", "few long"]] = contextvars.ContextVar("runs", default="many")


@contextlib.contextmanager
def expect_few_runs(*, long: bool = False) -> Iterator[None]:
    """Context in which each program runs a few hundred times at most: fewer are compiled, and small ones quickly unless runs are `long`."""
    token = _runs.set("few long" if long else "few")
    try:
        yield
    finally:
        _runs.reset(token)


def few_runs() -> bool:
    """Whether fewer programs are worth longer runs, see `expect_few_runs`."""
    return _runs.get() != "many"


def shares_programs() -> bool:
    """Whether programs are to serve records of any length: where few runs are expected, and at the command line, which keeps them."""
    return few_runs() or PROGRAM_FOLDER in os.environ


def compiles_quickly() -> bool:
    """Whether small programs are compiled without optimization, see `expect_few_runs`."""
    return _runs.get() == "few" and platform() == "cpu"


def program_options(unoptimized: bool) -> dict[str, int] | None:
    """Options of XLA for one program: None for those of the process."""
    return _UNOPTIMIZED if unoptimized else None


# Settings of `mallopt` by number: bytes from which an array gets pages of its own (M_MMAP_THRESHOLD), free bytes above which memory is
# returned to the system (M_TRIM_THRESHOLD), and number of heaps (M_ARENA_MAX). In a fit of 1891 weights, with a normal matrix of 29 MB per
# group of samples, they reduced the system time from 5.9 to 2.2 s; memory rose from 892 to 924 MB.
_MEMORY = {-3: 2**26, -1: 2**28, -8: 1}


def keep_freed_memory() -> None:
    """Make glibc keep freed memory for later arrays, instead of returning it to the system and fetching it again page by page."""
    set_option = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if set_option is not None:
        for number, value in _MEMORY.items():
            set_option(number, value)


def enable_x64(*, whole_loops: bool = True) -> None:
    """Switch JAX to double precision for this process; call it before any computation.

    Args:
        whole_loops: compile scans as whole loops, see `set_compiler_flags`. False leaves all flags to XLA, if no model has been imported
            before.
    """
    global _whole_loops_wanted
    import jax

    jax.config.update("jax_enable_x64", True)
    _whole_loops_wanted = whole_loops
    set_compiler_flags()


def require_x64() -> None:
    """Refuse single precision."""
    import jax

    if not jax.config.jax_enable_x64:  # type: ignore[attr-defined]
        raise PrecisionError("hystfit computes in double precision: call hystfit.enable_x64() before anything else")


# "auto" uses a GPU for large batches only. A fit consists of hundreds of small sequential programs: on an H100 it took 6 times as long as
# on the CPU of its host, `sample` and small batches 3 to 4 times.
_platform = "auto"


def use_device(platform: str) -> None:
    """Choose the device on which hystfit computes in this process, whatever the default device of JAX is.

    Args:
        platform: "auto" (default): a GPU for 1024 or more loops that are solved together, and the CPU, which is faster for single fits, for
            everything else; "cpu", "gpu" or "tpu" for everything; "jax": the default device of JAX.

    Raises:
        ParameterError: JAX finds no such device.
    """
    global _platform
    if platform not in ("auto", "jax") and first_device(platform) is None:
        raise ParameterError(f"JAX finds no device of the platform {platform!r}")
    _platform = platform


def device_of_many() -> Any:
    """The device for many loops that are solved together: the one chosen, by default a GPU; None for the CPU."""
    if _platform == "jax":
        device = _default_device()
        return None if device.platform == "cpu" else device
    chosen = "gpu" if _platform == "auto" else _platform
    return None if chosen == "cpu" else first_device(chosen)


@functools.cache
def first_device(platform: str) -> Any:
    """The first device of a platform ("cpu", "gpu", "tpu") that belongs to this process; None where JAX finds none."""
    import jax

    try:
        return jax.local_devices(backend=platform)[0]
    except RuntimeError:
        return None


def on_device() -> AbstractContextManager[Any]:
    """Context in which JAX computes on the device chosen by `use_device`."""
    import jax

    device = None if _platform == "jax" else first_device("cpu" if _platform == "auto" else _platform)
    if device is None or device == (jax.config.jax_default_device or _default_device()):  # type: ignore[attr-defined]
        return contextlib.nullcontext()
    return jax.default_device(device)


def platform() -> str:
    """Where hystfit computes: "cpu", "gpu", "tpu"."""
    import jax

    with on_device():
        device = jax.config.jax_default_device or _default_device()  # type: ignore[attr-defined]
    return str(getattr(device, "platform", device))


@functools.cache
def _default_device() -> Any:
    import jax

    return jax.local_devices()[0]


def verb(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """A public function that computes: in double precision, on the device of hystfit, with one thread of linear algebra."""

    @functools.wraps(function)
    def call(*arguments: _P.args, **options: _P.kwargs) -> _R:
        require_x64()
        with on_device(), one_blas_thread():
            return function(*arguments, **options)

    return call


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Context in which the linear algebra of this process runs in one thread, until the last of overlapping contexts ends.

    On small matrices the thread pools of NumPy and SciPy waste time: on two busy cores a structure search on 3000 samples took 17 to 24 s
    of processor time with them and 2.7 s without, a fit of Bouc-Wen 2.8 and 1.8 s. The number of threads also changes the last digit of
    sums.
    """
    global _one_thread_users, _limits
    with _one_thread:
        if not _one_thread_users:
            _limits = _blas().limit(limits=1, user_api="blas")
        _one_thread_users += 1
    try:
        yield
    finally:
        with _one_thread:
            _one_thread_users -= 1
            if not _one_thread_users:
                _limits.restore_original_limits()


_one_thread, _one_thread_users = threading.Lock(), 0
_limits: Any = None


@functools.cache
def _blas() -> Any:
    import scipy.linalg  # noqa: F401  # the libraries must be loaded to be found
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def require_seed(seed: int) -> int:
    """Refuse what some random number generators do not accept as a seed, before any work."""
    if isinstance(seed, bool) or not isinstance(seed, numbers.Integral) or not 0 <= seed < 2**32:
        raise ParameterError(f"a seed is a whole number from 0 to {2**32 - 1}, got {seed!r}")
    return int(seed)
