"""Execute every notebook of this folder and write it with its outputs to notebooks/out/.

    python notebooks/run.py [--quick] [01_first_fit ...]

The notebooks are Python files in jupytext's percent format. Each runs in a fresh kernel of this interpreter; no kernel has to be
registered, and the user's IPython configuration is ignored. `--quick` sets HYSTFIT_QUICK=1, which the notebooks read. Exit status 1
if a cell fails, after the other notebooks have run, or at once after an interrupt.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
# How a kernel starts; in the quick form it compiles as the quick tests do.
START = "from ipykernel.kernelapp import launch_new_instance; launch_new_instance()"
QUICK_START = f"import sys; sys.path[0] = {str(HERE.parent)!r}; import tests; tests.compile_fast(); del sys.path[0]; {START}"
# Use Unix sockets instead of TCP ports where possible; their path must be shorter than about 100 characters.
SOCKETS = sys.platform != "win32" and len(tempfile.gettempdir()) < 60


def execute(source: Path, target: Path, limit: float) -> str | None:
    """Run one notebook and write it; returns the failing cell and its error as text, or None.

    Args:
        source: a percent-format notebook (.py).
        target: where the executed notebook (.ipynb) goes; one that failed or was interrupted goes beside it (.partial.ipynb), since
            the documentation shows what is at `target`.
        limit: time for one cell [s].
    """
    import jupytext
    import nbformat
    from jupyter_client.kernelspec import KernelSpec
    from jupyter_client.manager import AsyncKernelManager
    from nbclient import NotebookClient
    from nbclient.exceptions import CellExecutionError, CellTimeoutError

    class ThisInterpreter(AsyncKernelManager):
        """Starts the interpreter that runs this script, whatever kernels the user has registered."""

        def _transport_default(self) -> str:
            return "ipc" if SOCKETS else "tcp"

        def _ip_default(self) -> str:
            return f"{os.environ['JUPYTER_RUNTIME_DIR']}/kernel" if SOCKETS else "127.0.0.1"

        @property
        def kernel_spec(self) -> KernelSpec:
            start = QUICK_START if os.environ.get("HYSTFIT_QUICK") == "1" else START
            command = [sys.executable, "-c", start, "-f", "{connection_file}"]
            return KernelSpec(argv=command, display_name="Python 3", language="python")

    notebook = jupytext.read(source)
    client = NotebookClient(
        notebook,
        timeout=limit,
        startup_timeout=300,
        coalesce_streams=True,
        kernel_manager_class=ThisInterpreter,
        resources={"metadata": {"path": str(source.parent)}},
    )
    partial = target.with_suffix(".partial.ipynb")
    complete = False
    try:
        client.execute()
        complete = True
        return None
    except CellExecutionError as error:
        return re.sub(r"\x1b\[[0-9;]*m", "", str(error))  # without color codes
    except (CellTimeoutError, RuntimeError, AssertionError) as error:  # a time-out, or the kernel died or did not start
        if hasattr(client, "_async_cleanup_kernel_future"):  # nbclient ends the kernel at a signal, and then fails in several ways
            raise KeyboardInterrupt from error
        started = [
            cell.source for cell in notebook.cells if "iopub.execute_input" in cell.metadata.get("execution", {})
        ]
        return f"{started[-1] if started else 'before the first cell'}\n{type(error).__name__}: {error}"
    finally:
        nbformat.write(notebook, partial)
        if complete:
            partial.replace(target)


def main(arguments: list[str] | None = None) -> int:
    """Run the notebooks named on the command line, or all; returns the exit status."""
    parser = argparse.ArgumentParser(description="Execute the notebooks of this folder.")
    parser.add_argument("names", nargs="*", help="such as 01_first_fit; all by default")
    parser.add_argument("--quick", action="store_true", help="short form, on less data")
    parser.add_argument("--limit", type=float, default=1800.0, help="seconds for one cell (default 1800)")
    chosen = parser.parse_args(arguments)
    found = {path.stem: path for path in sorted(HERE.glob("*.py")) if path != Path(__file__).resolve()}
    names = [Path(name).stem for name in chosen.names] or list(found)
    if unknown := [name for name in names if name not in found]:
        parser.error(f"no notebook {', '.join(unknown)}; there are {', '.join(found)}")
    os.environ["HYSTFIT_QUICK"] = "1" if chosen.quick else "0"
    (HERE / "out").mkdir(exist_ok=True)
    failed = 0
    with tempfile.TemporaryDirectory(prefix="hystfit-") as scratch:
        # Read by jupyter_client on import and by the kernel, so that neither reads nor writes the user's home.
        os.environ |= {"IPYTHONDIR": f"{scratch}/ipython", "JUPYTER_RUNTIME_DIR": scratch}
        for name in names:
            started = time.perf_counter()
            error = execute(found[name], HERE / "out" / f"{name}.ipynb", chosen.limit)
            print(f"{name:<32} {time.perf_counter() - started:6.1f} s  {'failed' if error else 'ok'}", flush=True)
            if error:
                failed += 1
                print(error, file=sys.stderr, flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit("interrupted: what was run is in notebooks/out/NAME.partial.ipynb")
