"""Valid files of every kind with random changes of their bytes."""

from __future__ import annotations

import io
from typing import Any

import numpy as np

from .dialects import case_of

KINDS = (".csv", ".csv", ".xlsx", ".npz", ".npy", ".h5", ".mat")


def _arrays(rng: np.random.Generator) -> dict[str, np.ndarray]:
    n = int(rng.integers(5, 200))
    t = 0.01 * np.arange(n)
    return {"t_s": t, "u_V": np.sin(t * 20), "y_um": np.sin(t * 20 - 0.3)}


def _workbook(arrays: dict[str, np.ndarray]) -> bytes:
    import openpyxl

    book = openpyxl.Workbook()
    sheet: Any = book.active
    sheet.append(list(arrays))
    for row in zip(*[column[:40].tolist() for column in arrays.values()], strict=True):
        sheet.append(row)
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


def valid(kind: str, rng: np.random.Generator) -> bytes:
    """A valid file of a kind."""
    if kind == ".csv":
        return case_of(int(rng.integers(1_000_000))).content
    arrays, stream = _arrays(rng), io.BytesIO()
    if kind == ".xlsx":
        return _workbook(arrays)
    if kind == ".npz":
        (np.savez if rng.random() < 0.5 else np.savez_compressed)(stream, **arrays)
    elif kind == ".npy":
        np.save(stream, np.column_stack([*arrays.values()]))
    elif kind == ".mat":
        from scipy.io import savemat

        tree: dict[str, Any] = {"run": {"t": arrays["t_s"], "x": arrays["u_V"]}, "note": "text", **arrays}
        old = bool(rng.random() < 0.3)
        packed = bool(rng.random() < 0.5) and not old
        savemat(stream, arrays if old else tree, do_compression=packed, format="4" if old else "5")
    else:
        import h5py

        with h5py.File(stream, "w") as file:
            for name, column in arrays.items():
                packed = {"compression": "gzip", "chunks": True} if rng.random() < 0.5 else {}
                file.create_dataset(f"run/{name}", data=column, **packed)
    return stream.getvalue()


def changed(raw: bytes, rng: np.random.Generator) -> bytes:
    """A file with 1 to 8 changes: bytes replaced, removed, inserted or repeated, blocks moved, the end cut off."""
    data = bytearray(raw)
    for _ in range(int(rng.integers(1, 9))):
        if not data:
            break
        place = int(rng.integers(len(data)))
        length = int(min(len(data) - place, rng.choice([1, 1, 2, 4, 8, 64])))
        action = rng.choice(["flip", "set", "digit", "remove", "insert", "repeat", "move", "cut", "ones"], p=_ODDS)
        if action == "flip":
            data[place] ^= 1 << int(rng.integers(8))
        elif action == "set":
            data[place : place + length] = rng.bytes(length)
        elif action == "digit":
            data[place] = int(rng.choice(list(b'0123456789.,;-+eE"\n\t ()#:/')))
        elif action == "remove":
            del data[place : place + length]
        elif action == "insert":
            data[place:place] = rng.bytes(length)
        elif action == "repeat":
            data[place:place] = data[place : place + length] * int(rng.integers(1, 40))
        elif action == "move":
            target = int(rng.integers(len(data)))
            block = data[place : place + length]
            data[target:target] = block
        elif action == "cut":
            del data[place:]
        else:
            data[place : place + length] = b"\xff" * length
    return bytes(data)


_ODDS = [0.2, 0.15, 0.2, 0.1, 0.1, 0.08, 0.07, 0.03, 0.07]


def mutation_of(seed: int) -> tuple[bytes, str]:
    """The file of a seed and its kind."""
    rng = np.random.default_rng([11, seed])
    kind = KINDS[seed % len(KINDS)]
    return changed(valid(kind, rng), rng), kind
