"""Parts of a run on disk, each written whole or not at all, so that a later run resumes after an interruption."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
import os
import zipfile
import zlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from hystfit.errors import DataError
from hystfit.version import version_of


def load(file: Path) -> dict[str, np.ndarray] | None:
    """Arrays that `keep` wrote; None where there are none, or a damaged file."""
    try:
        with file.open("rb") as handle, np.load(handle) as kept:
            return {name: kept[name] for name in kept.files}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error):
        return None


def keep(file: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write under another name, then rename: an interruption leaves a whole file or none."""
    scratch = file.with_name(f".{file.name}")
    try:
        with scratch.open("wb") as handle:
            np.savez(handle, **arrays)  # type: ignore[arg-type]
        scratch.replace(file)
    except OSError:
        scratch.unlink(missing_ok=True)  # a full disk has no room for a part that is no use
        raise


def stored(folder: Path | None, name: str, make: Callable[[], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Arrays from a file of a folder (None keeps nothing), or made and kept there; a damaged file is made again."""
    kept = None if folder is None else load(folder / name)
    if kept is not None:
        return kept
    arrays = make()
    if folder is not None:
        keep(folder / name, arrays)
    return arrays


@dataclasses.dataclass(frozen=True)
class Chunks:
    """Numbered parts of one chain, in memory and in the files `label`-00000.npz of a folder; where that is None, in memory alone."""

    folder: Path | None
    label: str
    parts: list[dict[str, np.ndarray]] = dataclasses.field(default_factory=list)

    def part(self, number: int, make: Callable[[int], dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        """A part after those before it; `make` is called with its number where neither memory nor folder has it."""
        if number == len(self.parts):
            name = f"{self.label}-{number:05d}.npz"
            self.parts.append(stored(self.folder, name, functools.partial(make, number)))
        return self.parts[number]

    def joined(self, names: Iterable[str], count: int) -> dict[str, np.ndarray]:
        """The first `count` rows of these arrays over all parts."""
        return {name: np.concatenate([part[name] for part in self.parts])[:count] for name in names}


def claim(folder: Path, label: str, described: dict[str, Any]) -> Path:
    """A folder for the parts of one run: a new one, or that of the same run, which is identified by the file `label`.

    Runs of other versions of hystfit or JAX are other runs: they need not continue from the same point.
    """
    versions = {name: version_of(name) for name in ("hystfit", "jax")}
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
    """Of the run that a folder holds."""
    try:
        return str(json.loads(file.read_text(encoding="utf-8"))["digest"])
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(f"{os.fspath(file)!r} is damaged: remove its folder to start again") from error
