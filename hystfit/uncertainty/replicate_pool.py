"""Chunks of replicates, kept in a folder as they are computed, so that a later run resumes from them."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from hystfit.models.storage import to_json
from hystfit.runs.chunks import claim, keep, load
from hystfit.runs.pool import computed
from hystfit.uncertainty.replicates import CHUNK, Study, broken_chunk, run_chunk

Chunk = dict[str, np.ndarray]


def collect(
    study: Study,
    count: int,
    folder: str | Path | None,
    workers: int,
    scheduler: str | None,
    progress: Callable[[str], None] | None,
) -> tuple[list[Chunk], list[str]]:
    """`count` chunks in order, and a sentence on each that broke; a chunk that broke is not kept, so that the same call tries it again.

    Raises:
        DataError: the folder holds another study.
        HystfitError: settings that cannot be used, or a missing extra.
    """
    place = None if folder is None else _claim(Path(folder), study)
    done = {} if place is None else {k: chunk for k in range(count) if (chunk := _load(_file(place, k))) is not None}
    missing = [k for k in range(count) if k not in done]
    broken = []
    for number, outcome in computed(partial(run_chunk, study), missing, workers, scheduler):
        k = missing[number]
        if isinstance(outcome, Exception):
            broken.append(f"chunk {k} broke: {type(outcome).__name__}: {outcome}")
            done[k] = broken_chunk(study)
        else:
            done[k] = outcome
            if place is not None:
                keep(_file(place, k), outcome)
        if progress:
            progress(f"{len(done)} of {count} chunks of {CHUNK} replicates")
    return [done[k] for k in sorted(done)], broken


def _file(place: Path, k: int) -> Path:
    return place / f"chunk-{k:05d}.npz"


def _load(file: Path) -> Chunk | None:
    """A stored chunk; None where there is none, or a damaged one."""
    outcome = load(file)
    return outcome if outcome is not None and set(outcome) == {"ranks", "errors", "reason"} else None


def _claim(folder: Path, study: Study) -> Path:
    """The folder of a study, new or of the same one."""
    values = {k: np.asarray(v).tolist() for k, v in vars(study.truth).items() if hasattr(v, "shape")}
    described = {k: getattr(study, k) for k in ("assumed", "method", "spread", "fix", "free", "seed")}
    priors = {k: v.exact() for k, v in study.priors.items()}
    described = {"model": to_json(study.model), "truth": [study.truth.name, values], "priors": priors, **described}
    return claim(folder, "study.json", described | {"inputs": [record.digest() for record in study.data]})
