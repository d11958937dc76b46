"""Provenance of a result: versions, seed, checksums of the data, date; and how much of a call JAX spent compiling."""

from __future__ import annotations

import datetime
import platform
import threading
import time
from collections.abc import Iterable
from typing import Any

import jax.monitoring

from hystfit.data.record import Record
from hystfit.outcome import Code
from hystfit.version import version_of

_CHANGES = (Code.PREPARED, Code.UNITS, Code.WEIGHTED, Code.COARSE_CLOCK)  # of a record after it was measured


def provenance(data: Iterable[Record], seed: int | None, **more: Any) -> dict[str, Any]:
    """Versions, seed, checksums of the data, date; a record for people, never read back."""
    packages = ("hystfit", "jax", "equinox", "optimistix", "numpy", "scipy")
    return {
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "versions": {name: version_of(name) for name in packages},
        "seed": seed,
        "records": [
            {
                "name": r.name,
                "source": r.source,
                "file_sha256": r.sha256,
                "data_sha256": r.digest(),
                "samples": len(r),
                "units": {"u": r.u_unit or None, "y": r.y_unit or None, "t": None if r.t is None else r.t_unit},
                "metadata": dict(r.metadata),
                "changes": [note.text for note in r.notes if note.code in _CHANGES],
            }
            for r in data
        ],
        **more,
    }


_COMPILING = (
    "/jax/core/compile/jaxpr_trace_duration",
    "/jax/core/compile/jaxpr_to_mlir_module_duration",
    "/jax/core/compile/backend_compile_duration",
)
_of_thread = threading.local()  # fits may run side by side
_listening = False


def _listen(event: str, seconds: float, **_: object) -> None:
    if event in _COMPILING:
        _of_thread.spent = _spent() + seconds


def _spent() -> float:
    return getattr(_of_thread, "spent", 0.0)


class Stopwatch:
    """Wall time since it was made, split into compiling, in this thread, and running."""

    def __init__(self) -> None:
        global _listening
        if not _listening:
            jax.monitoring.register_event_duration_secs_listener(_listen)
            _listening = True
        self._compiled, self._started = _spent(), time.perf_counter()

    def read(self) -> tuple[float, float]:
        """(seconds compiling, seconds running)."""
        total, compiled = time.perf_counter() - self._started, _spent() - self._compiled
        return min(compiled, total), max(total - compiled, 0.0)
