"""Run a program so that it compiles for little processor time, as the quick forms of tests and notebooks do.

    python -m tests.fast [--optimized] SCRIPT [ARGUMENTS]

With `--optimized` programs are still optimized, which pays where they run longer than they compile.
"""

import runpy
import sys
from pathlib import Path

from . import FAST_TO_COMPILE, ONE_THREAD, compile_fast

if __name__ == "__main__":
    optimized = sys.argv[1] == "--optimized"
    del sys.argv[: 1 + optimized]
    compile_fast(ONE_THREAD if optimized else FAST_TO_COMPILE)
    sys.path[0] = str(Path(sys.argv[0]).resolve().parent)
    runpy.run_path(sys.argv[0], run_name="__main__")
