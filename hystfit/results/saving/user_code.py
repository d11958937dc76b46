"""Files of the user's that opening a fit would run: models and noise models of their own. They are run only on request."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from hystfit.errors import ModelError
from hystfit.inference.noise.registry import NOISES
from hystfit.models.base import AbstractHysteresis
from hystfit.models.storage import user_classes
from hystfit.outcome import Code, Note
from hystfit.outcome.note import warn
from hystfit.registry import code_digest, file_digest, file_of, in_process


def checksums(models: Iterable[AbstractHysteresis], noise: str) -> dict[str, str | None]:
    """SHA-256 of every file of the user's behind models and a noise model, by path; null where the file cannot be read."""
    kinds = {kind for model in models for kind in user_classes(model)}
    found = {str(Path(file_of(kind)).resolve()): code_digest(kind) for kind in kinds if file_of(kind).endswith(".py")}
    if file := noise_file(noise):
        _, _, name = noise.rpartition(":")
        module = in_process(Path(file))
        kind = getattr(module, name, None)
        found[file] = code_digest(kind) if isinstance(kind, type) else file_digest(Path(file))
    return found


def noise_file(noise: str) -> str | None:
    """The file of a noise model of the user's own; None for one of hystfit's."""
    path, _, _ = noise.rpartition(":")
    return path if path.endswith(".py") and noise not in NOISES else None


def allow(files: Iterable[str], stored: Mapping[str, str | None], trust: bool) -> tuple[frozenset[str], list[Note]]:
    """Files that may be run to open a fit, with a note on each whose SHA-256 has changed since it was saved.

    A file that this process has run already needs no request.
    """
    notes = []
    for file in sorted(files):
        present, before = file_digest(Path(file)), stored.get(file)
        if not (trust or in_process(Path(file))):
            raise ModelError(_refusal(file, present, before))
        if present != before:
            text = f"{file} has changed since the fit was saved: its SHA-256 was {before}, and is {present}"
            notes.append(warn(Code.CHANGED_FILES, text))
    return frozenset(files), notes


def _refusal(file: str, present: str | None, before: str | None) -> str:
    if present is None:
        return f"opening this fit needs {file!r} (SHA-256 {before}), which is not there: restore the file"
    if present == before:
        state = f"SHA-256 {present}, as when the fit was saved"
    else:
        state = f"which has CHANGED since the fit was saved: SHA-256 {present}, then {before}"
    return (
        f"opening this fit runs the Python file {file!r} ({state}), which may contain any code: if you trust it, open the fit "
        "with trust=True"
    )
