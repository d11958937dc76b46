"""Words that name the two branches of a loop, in columns and in their values."""

from __future__ import annotations

import re

RISING = frozenset(
    "up rising rise ascending asc increasing inc loading load heating upward upscale charging charge "
    "adsorption adsorbed forward fwd positive pos".split()
)
FALLING = frozenset(
    "down falling fall descending desc decreasing dec unloading unload cooling downward downscale discharging discharge "
    "desorption desorbed backward bwd reverse rev return negative neg".split()
)
BRANCHES = RISING | FALLING


def words_of(name: str) -> set[str]:
    """Words of a name in lower case: those between underscores and signs, and those of CamelCase; a number at the end is a word."""
    return set(re.findall(r"[^\W\d_]+|\d+", re.sub(r"([a-z])([A-Z])", r"\1 \2", str(name)).lower()))
