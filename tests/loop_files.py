"""Files of a loop of 60 samples, written and read back by tests of readers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hystfit.data import Record
from hystfit.reading import read

N = 60
U = np.round(40 + 8 * np.sin(np.linspace(0, 4 * np.pi, N)), 3)
Y = np.round(30 + 7 * np.sin(np.linspace(-0.4, 4 * np.pi - 0.4, N)), 3)


def written(folder: Path, content: str | bytes, name: str) -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def one(folder: Path, content: str | bytes, name: str = "loop.csv") -> Record:
    data = read(written(folder, content, name))
    assert isinstance(data, Record), [record.name for record in data]
    return data


def is_pair(record: Record, u: np.ndarray = U, y: np.ndarray = Y) -> None:
    np.testing.assert_allclose(record.u, u, rtol=1e-12)
    np.testing.assert_allclose(record.y, y, rtol=1e-12)


def rows(mark: str, *columns: np.ndarray) -> str:
    return "".join(mark.join(map(str, row)) + "\n" for row in zip(*columns, strict=True))
