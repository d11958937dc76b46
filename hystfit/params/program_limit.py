"""Compiled programs of a process, dropped before they take up the memory maps that Linux allows it.

A program is compiled for one shape of its arguments and takes about ten maps. At the limit LLVM finds no memory, and the process ends with
a segmentation fault: so did one that fitted and simulated many loops of different lengths. JAX drops the programs of all packages together.
"""

from __future__ import annotations

import gc
import itertools
from contextlib import suppress
from pathlib import Path

import jax

_MAPS, _MOST = Path("/proc/self/maps"), Path("/proc/sys/vm/max_map_count")
# Part of the maps that a process may have, at which programs are dropped: those of other packages need some too.
_SHARE = 0.4
# Calls of compiled functions between two counts. Each may compile a program of up to 60 maps, half the limit in all; a count of 26 000 maps
# takes 10 ms, and as many calls 50 ms at the least.
_EVERY = 500
_calls = itertools.count(1)


def keep_below_limit() -> None:
    """Count a call of a compiled function; drop all programs where they are too many, each of which is compiled anew when it is used."""
    if next(_calls) % _EVERY:
        return
    with suppress(OSError, ValueError):  # no Linux
        if _MAPS.read_bytes().count(b"\n") > _SHARE * int(_MOST.read_text()):
            jax.clear_caches()
            gc.collect()
