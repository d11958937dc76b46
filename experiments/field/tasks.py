"""The tasks of the benchmark: measured records, the outputs that are given, the score of a prediction."""

from __future__ import annotations

import csv
import dataclasses
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import hystfit as hf

HERE = Path(__file__).resolve().parent
DEFINITION = tomllib.loads((HERE / "tasks.toml").read_text(encoding="utf-8"))
VERSION = DEFINITION["version"]
COLUMNS = ("record", "t", "u", "y")


@dataclasses.dataclass(frozen=True)
class Task:
    """Records of which some outputs are given; the others are predicted.

    Attributes:
        records: as measured, with the outputs that are asked.
        given: the outputs that a program may use, one mask of shape (T,) a record.
        asked: the outputs that are predicted and scored, one mask a record.
        offset_free: the mean error of each predicted record does not count.
    """

    name: str
    about: str
    records: tuple[hf.Record, ...]
    given: tuple[np.ndarray, ...]
    asked: tuple[np.ndarray, ...]
    offset_free: bool
    model: str

    @property
    def training(self) -> tuple[hf.Record, ...]:
        """The records with given outputs; the others in them have no weight."""
        pairs = zip(self.records, self.given, strict=True)
        return tuple(record.replace(weight=record.weight * given) for record, given in pairs if given.any())

    def score(self, predicted: Sequence[np.ndarray]) -> float:
        """Root mean square error of the asked outputs, in percent of their range.

        Args:
            predicted: outputs of every record, each of shape (T,); those that are not asked are ignored.
        """
        misses, outputs = [], []
        for record, asked, y in zip(self.records, self.asked, predicted, strict=True):
            if asked.any():
                miss = np.asarray(y)[asked] - record.y[asked]
                misses.append(miss - miss.mean() if self.offset_free else miss)
                outputs.append(record.y[asked])
        return 100 * float(np.sqrt(np.mean(np.concatenate(misses) ** 2)) / np.ptp(np.concatenate(outputs)))

    def write(self, path: Path) -> None:
        """The task as CSV for any program: record, time (empty without), input, output (empty where it is asked)."""
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(COLUMNS)
            for record, given in zip(self.records, self.given, strict=True):
                t = [""] * len(record) if record.t is None else record.t.tolist()
                y = [
                    value if known else "" for value, known in zip(record.y.tolist(), given & record.used, strict=True)
                ]
                writer.writerows(zip([record.name] * len(record), t, record.u.tolist(), y, strict=True))

    def read(self, path: Path) -> list[np.ndarray]:
        """Predictions in the rows of the written task, with a number in the column y of every row that is asked.

        Raises:
            ValueError: other rows than those of the task, or an asked output without a number.
        """
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        if len(rows) != (total := sum(map(len, self.records))):
            raise ValueError(f"{path} has {len(rows)} rows; task {self.name} has {total}")
        y = np.array([float(row["y"] or "nan") for row in rows])
        parts = np.split(y, np.cumsum([len(record) for record in self.records])[:-1])
        if not all(np.isfinite(part[asked]).all() for part, asked in zip(parts, self.asked, strict=True)):
            raise ValueError(f"{path}: column y lacks numbers in rows that are asked")
        return parts


def _mask(record: hf.Record, number: int, definition: Mapping[str, Any]) -> np.ndarray:
    """The given outputs of a record."""
    if "window" in definition:
        low, high = (limit * len(record) if 0 < limit < 1 else limit for limit in definition["window"])
        return record.window(low, high).weight > 0
    if "every" in definition:
        chosen = number % definition["every"] == 0
    elif "records" in definition:
        chosen = record.name in definition["records"]
    else:
        chosen = record.name not in definition["without"]
    return record.used & chosen


def of_name(name: str, *, download: bool = True) -> Task:
    """A task with its data.

    Raises:
        KeyError: no such task.
        DataError: its data cannot be found, downloaded or verified.
    """
    definition = DEFINITION["tasks"][name]
    records = tuple(
        record for data in definition["data"] for record in hf.Dataset.of(hf.datasets.load(data, download=download))
    )
    given = tuple(_mask(record, k, definition) for k, record in enumerate(records))
    low, high = definition.get("asked", (None, None))
    rest = (record.window(low, high).used & ~mask for record, mask in zip(records, given, strict=True))
    return Task(
        name, definition["about"], records, given, tuple(rest), definition.get("offset") == "free", definition["model"]
    )
