"""Parts of a run on disk: each is written whole or not at all, so that a kill leaves what a later run can go on from."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hystfit.errors import DataError


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


def claim(folder: Path, label: str, described: dict[str, Any]) -> Path:
    """A folder for the parts of one run, new or of the same one: `described`, which the file `label` keeps, tells runs apart.

    Other versions of hystfit or JAX make another run: what they compute need not go on from the same point.

    Raises:
        DataError: the folder holds another run, a damaged label, or cannot be made.
    """
    versions = {name: importlib.metadata.version(name) for name in ("hystfit", "jax")}
    described = {**described, "versions": versions}
    digest = hashlib.sha256(json.dumps(described, sort_keys=True, default=str).encode()).hexdigest()
    file, what = folder / label, Path(label).stem
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if file.exists() and _digest(file) != digest:
            raise DataError(
                f"{os.fspath(folder)!r} holds another {what} (other data, model, priors, seed, settings or versions): "
                "choose another folder"
            )
        scratch = folder / f".{label}"
        scratch.write_text(json.dumps({"digest": digest, **described}, indent=1, default=str), encoding="utf-8")
        scratch.replace(file)
    except OSError as error:
        raise DataError(f"cannot keep the {what} in {os.fspath(folder)!r}: {error.strerror or error}") from error
    return folder


def _digest(file: Path) -> str:
    """Of the run that a folder holds.

    Raises:
        DataError: the file is damaged.
    """
    try:
        return str(json.loads(file.read_text(encoding="utf-8"))["digest"])
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(f"{os.fspath(file)!r} is damaged: remove its folder to start anew") from error
