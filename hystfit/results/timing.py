"""How much of a call was compilation, as JAX itself reports it."""

from __future__ import annotations

import threading
import time

import jax.monitoring

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
