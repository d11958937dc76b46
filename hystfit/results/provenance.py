"""Provenance of a result: versions, seed, checksums of the data, date."""

from __future__ import annotations

import datetime
import platform
from collections.abc import Iterable
from typing import Any

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
