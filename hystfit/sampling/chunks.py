"""Parts of a run on disk: each is written whole or not at all, so that a kill leaves what a later run can go on from."""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np


def stored(folder: Path | None, name: str, make: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Arrays from a file of a folder, or made and written there whole or not at all; a damaged file is made anew."""
    if folder is None:
        return make()
    file = folder / name
    try:
        with file.open("rb") as handle, np.load(handle) as kept:
            return {k: kept[k] for k in kept.files}
    except FileNotFoundError:
        pass
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        pass  # what made it makes the same again
    arrays = make()
    scratch = folder / f".{name}"
    with scratch.open("wb") as handle:
        np.savez(handle, **arrays)  # type: ignore[arg-type]
    scratch.replace(file)
    return arrays
