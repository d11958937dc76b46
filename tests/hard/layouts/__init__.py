"""Files as instruments and people write them, with what is right for each: `layout_of(seed)`."""

from . import (  # noqa: F401 - they register their kinds
    branches,
    channels,
    containers,
    documents,
    electrics,
    ferroelectrics,
    frames,
    groups,
    headers,
    logs,
    magnetometers,
    micromag,
    nameless,
    notations,
    offices,
    piezo,
    programs,
    reports,
    robots,
    sensors,
    slow,
    sorption,
    structures,
)
from .registry import KINDS, layout_of
from .scorer import ASKED, HALF, RIGHT, SILENT, USELESS, score
from .survey import survey
from .truth import Layout

__all__ = ["ASKED", "HALF", "KINDS", "RIGHT", "SILENT", "USELESS", "Layout", "layout_of", "score", "survey"]
