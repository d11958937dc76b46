"""The command line: `hystfit fit loop.csv` and the other verbs."""

from __future__ import annotations

import logging
import os
import platform
import re
import signal
import sys
from collections.abc import Sequence

import platformdirs
from cyclopts import App, CycloptsError, Parameter, UnusedCliTokensError

from hystfit.cli.interrupts import INTERRUPTED, interruptible

_HELP = """Fit hysteresis models to measured loops, say what the data determine, and use what was fitted.

LOOP is a file (csv, txt, dat, mat, npz, xlsx, h5) or the name of a data set (hystfit datasets).
Start with: hystfit fit LOOP --out fit
Exit status: 0 usable, 1 finished but not usable, 2 bad input or usage, 130 interrupted.
"""
_VERBS = {
    "fit": ("hystfit.cli.fit:fit", "Fit a model to a measured loop and say what the data determine."),
    "compare": ("hystfit.cli.fit:compare", "Fit several models and rank them by their error on data left out."),
    "check": ("hystfit.cli.using:check", "Say what a record holds and which models it can determine."),
    "predict": ("hystfit.cli.using:predict", "Run a fitted model over another record."),
    "invert": ("hystfit.cli.control:invert", "Find the input that makes a fitted model follow a reference."),
    "export": ("hystfit.cli.control:export", "Write a fitted model and its inverse as C code."),
    "sample": ("hystfit.cli.uncertainty:sample", "Draw from the posterior of a fit, with a verdict on convergence."),
    "profile": (
        "hystfit.cli.uncertainty:profile",
        "Limits of each parameter by profile likelihood, or where there are none.",
    ),
    "errors": (
        "hystfit.cli.uncertainty:errors",
        "Standard errors by every rule: independent residuals, sandwich, block bootstrap.",
    ),
    "calibrate": ("hystfit.cli.uncertainty:calibrate", "Check by simulation that the error bars of a set-up hold."),
    "design": ("hystfit.cli.uncertainty:design", "Propose the input that shrinks the errors most."),
    "report": ("hystfit.cli.using:report", "Print and draw the report of a saved fit anew."),
    "simulate": ("hystfit.cli.simulate:simulate", "Make a record with the simulated stage, a model or a fit."),
    "models": ("hystfit.cli.listing:models", "List the models, or the parameters of one."),
    "datasets": ("hystfit.cli.listing:datasets", "List the data sets known by name, or write one."),
}


_KEPT = 2**28  # bytes of compiled programs; the longest unused go first


def _version() -> str:
    import importlib.metadata

    return importlib.metadata.version("hystfit")


app = App(
    name="hystfit",
    help=_HELP,
    help_format="plaintext",
    version=_version,
    default_parameter=Parameter(negative=""),
    result_action="return_value",
    suppress_keyboard_interrupt=False,
)
for _name, (_place, _about) in _VERBS.items():
    app.command(_place, name=_name, help=_about)


def run(arguments: Sequence[str]) -> int:
    """Run one verb and return its exit status; what a user can put right goes to stderr in one message."""
    from hystfit.errors import HystfitError

    try:
        with interruptible():
            status = app(list(arguments), exit_on_error=False, print_error=False)
        return status if isinstance(status, int) else 0
    except UnusedCliTokensError as error:
        extra = " ".join(error.unused_tokens or ())
        return _refuse(
            f"{extra!r} belongs to no option: to give several values, repeat the option (--fix rho --fix mu)"
        )
    except CycloptsError as error:
        return _refuse(str(error))
    except HystfitError as error:
        return _refuse(as_options(str(error)))
    except KeyboardInterrupt:
        print("hystfit: interrupted; nothing was written", file=sys.stderr)
        return INTERRUPTED
    except MemoryError:
        return _refuse("not enough memory: fit a window, or a record of fewer samples")
    except OSError as error:
        return _refuse(f"{error.filename or 'file system'}: {error.strerror or error}")


_ARGUMENT = re.compile(
    r"\b(time|input|output|by|only|where|gaps|sheet|delimiter|decimal|encoding|fix|free|method|starts|loss|sampler|noise|draws|walkers|warmup|level|low|high|replicates|spread|left_out|scheduler)=(?:'([^']*)'|(False)\b)?"
)


def as_options(message: str) -> str:
    """A message of the library in the words of the shell: gaps='split' is --gaps split, and time=False --time none."""

    def option(found: re.Match[str]) -> str:
        value = "none" if found[3] else found[2]
        return f"--{found[1].replace('_', '-')}" + (f" {value}" if value else "")

    return _ARGUMENT.sub(option, message)


def _refuse(message: str) -> int:
    print(f"hystfit: {message}", file=sys.stderr)
    return 2


def keep_programs() -> None:
    """Have JAX keep what it compiles in the user's cache folder, so that the next command need not compile it again.

    Most of a first fit is compilation. A folder of the user's own choice (JAX_COMPILATION_CACHE_DIR) is left as it is.
    """
    if "JAX_COMPILATION_CACHE_DIR" in os.environ:
        return
    # Programs suit one processor, and home folders are shared by machines.
    folder = platformdirs.user_cache_path("hystfit") / "programs" / (platform.node() or "here")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder)
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.05")
    os.environ.setdefault("JAX_COMPILATION_CACHE_MAX_SIZE", str(_KEPT))


def main() -> None:
    """Entry point of the `hystfit` command."""
    keep_programs()
    os.environ["JAX_ENABLE_X64"] = "1"  # read by JAX when a verb imports it
    os.environ.setdefault("JAX_PLATFORMS", "cpu")  # scans over samples are faster there
    logging.getLogger("jax._src.xla_bridge").setLevel(logging.ERROR)
    if "jax" in sys.modules:
        from hystfit.config import enable_x64

        enable_x64()
    status = run(sys.argv[1:])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # all is written, or nothing
    if status == INTERRUPTED:
        sys.stdout.flush()
        os._exit(status)  # XLA may crash when Python takes down what was interrupted
    sys.exit(status)
