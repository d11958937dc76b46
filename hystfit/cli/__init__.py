"""The command line: `hystfit fit loop.csv` and the other verbs.

Enters: words of the shell, which cyclopts turns into the arguments of a function for each verb.
Leaves: text on standard output, a folder of results, and an exit status.
Open first: `fit.py`; `verbs.py` lists the verbs, `options.py` has what they share.
"""

from __future__ import annotations

import atexit
import gc
import logging
import os
import platform
import signal
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path

import platformdirs
from cyclopts import App, CycloptsError, Parameter, UnknownOptionError, UnusedCliTokensError

from hystfit.cli.interrupts import INTERRUPTED, interruptible
from hystfit.cli.verbs import VERBS, WrappedHelp, as_options, examples, place, verb_options
from hystfit.config import PROGRAM_FOLDER, keep_freed_memory, set_compiler_flags
from hystfit.errors import HystfitError
from hystfit.version import __version__

_HELP = """Fit hysteresis models to measured loops, report what the data determine, and use the fitted model.

LOOP is a file (csv, txt, dat, mat, npz, xlsx, h5), a pattern ('loops/*.csv') or the name of a data set (see hystfit datasets).
u.csv+y.csv is one record with its input in the first file and its output in the second.

Start with: hystfit check LOOP, then hystfit fit LOOP --out fit
Options and examples of a verb: hystfit fit --help
Exit status: 0 usable, 1 finished but not usable, 2 bad input or usage, 130 interrupted.
"""
_COLLECTION = 500_000  # new objects between garbage collections; imports and traces make 400 000 that stay
_COMPILED = "JAX_COMPILATION_CACHE_DIR"  # variable with the folder of compiled programs
_TRACED = "traced"  # folder in it of traced ones
_CACHE_BYTES = 2**28  # of compiled programs; those unused for longest are removed first


app = App(
    name="hystfit",
    help=_HELP,
    help_format="plaintext",
    help_formatter=WrappedHelp(),
    version=__version__,
    default_parameter=Parameter(negative=""),
    result_action="return_value",
    suppress_keyboard_interrupt=False,
)
for _place, (_verb, (_, _help)) in enumerate(VERBS.items()):
    app.command(place(_verb), name=_verb, help=_help, sort_key=_place, help_epilogue=examples(_verb))


def run(arguments: Sequence[str]) -> int:
    """Run one verb and return its exit status; an error that the user can correct is one message on stderr."""
    try:
        with interruptible():
            status = app(list(arguments), exit_on_error=False, print_error=False)
        return status if isinstance(status, int) else 0
    except UnusedCliTokensError as error:
        extra = " ".join(error.unused_tokens or ())
        return _refuse(
            f"unexpected argument {extra!r}: repeat an option to give it several values (--parameter rho --parameter mu)"
        )
    except UnknownOptionError as error:
        message, verb = str(error), arguments[0]
        if verb in VERBS and "Did you mean" not in message:
            message += f" The options of {verb} are --{', --'.join(verb_options(verb)).replace('_', '-')}."
        return _refuse(message)
    except CycloptsError as error:
        return _refuse(str(error))
    except HystfitError as error:
        return _refuse(as_options(str(error)))
    except KeyboardInterrupt as error:
        print(f"hystfit: interrupted; {str(error) or 'nothing was written'}", file=sys.stderr)
        return INTERRUPTED
    except MemoryError:
        return _refuse("not enough memory: fit a window, or a record with fewer samples")
    except OSError as error:
        return _refuse(f"{error.filename or 'file system'}: {error.strerror or error}")


def _refuse(message: str) -> int:
    print(f"hystfit: {message}", file=sys.stderr)
    return 2


def keep_programs() -> None:
    """Keep compiled and traced programs in the user's cache folder, so that the next command need not make them again.

    Most of the time of a first fit is compilation, and half of the rest tracing. A folder that the user has
    chosen (JAX_COMPILATION_CACHE_DIR) is used as it is, with a folder of traced programs in it.
    """
    if chosen := os.environ.get(_COMPILED):
        if "://" not in chosen:  # JAX keeps programs in buckets too
            os.environ.setdefault(PROGRAM_FOLDER, str(Path(chosen) / _TRACED))
        return
    # Programs are compiled for one processor, and several machines may share a home folder.
    folder = platformdirs.user_cache_path("hystfit") / "programs" / (platform.node() or "here")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _remove_halves(folder)
    except OSError:
        return
    os.environ[_COMPILED] = str(folder)
    os.environ[PROGRAM_FOLDER] = str(folder / _TRACED)
    os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
    os.environ.setdefault("JAX_COMPILATION_CACHE_MAX_SIZE", str(_CACHE_BYTES))


def _remove_halves(folder: Path) -> None:
    """Remove programs that a killed command left without their time of use: at one of them JAX keeps no more, with a warning each."""
    names = set(os.listdir(folder))
    for name in names:
        if name.endswith("-cache") and name.removesuffix("-cache") + "-atime" not in names:
            (folder / name).unlink(missing_ok=True)


class _Exit:
    """Last exit handler of the command: leaves without taking down JAX and its programs, which takes 0.3 to 0.9 s.

    Threads have been joined and the handlers of what the command imported have run by then. Handlers registered before the command
    began would run later: none but that of a coverage measurement does more than flush.
    """

    status: int | None = None  # of the verb; None: it ended by an error of hystfit itself

    def __call__(self) -> None:
        if self.status is None or "coverage" in sys.modules:
            return
        try:
            sys.stdout.flush()
            sys.stderr.flush()
        except (OSError, ValueError, AttributeError):  # Python reports what cannot be written
            return
        os._exit(self.status)


def main() -> None:
    """Entry point of the `hystfit` command, which ends the process; `run` does not."""
    leave = _Exit()
    atexit.register(leave)  # before JAX and the engines register theirs: the last to be called
    gc.set_threshold(_COLLECTION, *gc.get_threshold()[1:])
    keep_freed_memory()
    keep_programs()
    set_compiler_flags()
    os.environ["JAX_ENABLE_X64"] = "1"  # read by JAX when a verb imports it
    os.environ.setdefault("JAX_PLATFORMS", "cpu")  # scans over samples are faster there
    logging.getLogger("jax._src.xla_bridge").setLevel(logging.ERROR)
    warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation cache")  # compiled anew
    warnings.filterwarnings("ignore", category=FutureWarning, module="arviz")  # announces its next version at import
    if "jax" in sys.modules:
        from hystfit.config import enable_x64

        enable_x64()
    status = run(sys.argv[1:])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the result is either complete or absent
    if status == INTERRUPTED:
        sys.stdout.flush()
        os._exit(status)  # XLA may crash when Python shuts down an interrupted computation
    leave.status = status
    sys.exit(status)
