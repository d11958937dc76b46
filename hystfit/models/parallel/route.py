"""The one choice of how a simulation runs: by device, number of samples and number of lanes."""

from __future__ import annotations

import enum
from collections.abc import Callable
from typing import Any

import jax

_LONG = 4096  # samples from which log2(T) passes over the record take less time on a GPU than T small steps
_MANY = 32  # lanes that fill a warp


class Route(enum.Enum):
    """How a simulation runs."""

    SCAN = "scan"  # sample after sample, one operation of XLA after another
    ASSOCIATIVE = "associative"  # all samples of one record at once, in log2(T) passes
    KERNEL = "kernel"  # many lanes at once (parameter vectors, records), the loop over the samples inside one kernel


def platform() -> str:
    """Where programs run: "cpu", "gpu", "tpu"; the default device of JAX, where one is set."""
    device = jax.config.jax_default_device  # type: ignore[attr-defined]
    return jax.default_backend() if device is None else str(getattr(device, "platform", device))


def on_gpu() -> bool:
    """Whether programs run on a GPU."""
    return platform() in ("gpu", "cuda", "rocm")


def route(samples: int, lanes: int = 1, *, associative: bool = False) -> Route:
    """How to run a simulation. On a CPU it is always the scan, which is several times faster there than either other form."""
    if not on_gpu():
        return Route.SCAN
    if lanes >= _MANY:
        return Route.KERNEL
    return Route.ASSOCIATIVE if associative and samples >= _LONG else Route.SCAN


def each(function: Callable[[Any], Any], rows: Any) -> Any:
    """The function of every row: together on a GPU, one after another elsewhere, where a batch would be slower."""
    return jax.vmap(function)(rows) if on_gpu() else jax.lax.map(function, rows)
