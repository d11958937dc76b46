"""Ordinary files of public repositories: what the first command reads, chooses and answers, beside what is right.

    python experiments/files/run.py [--quick] [--out FOLDER]

Each file goes to `hystfit fit FILE` without an option. A file is right where its columns, records and quantities are those of
files.toml, its status is one of those listed, and the error on fitted samples is below the limit [% of range]. The quick form reads the
files and their quantities, and fits none. The files lie in the folder "wild" of the one that HYSTFIT_DATA names; their addresses,
revisions and checksums are in files.toml.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from common import Results, arguments, table

import hystfit as hf
from hystfit.data import Dataset
from hystfit.errors import DataError

HERE = Path(__file__).resolve().parent
WITHIN = 0.01  # of a quantity, or two standard errors
HEAD = ["file", "records", "input", "output", "model", "status", "error, %", "quantities (right)", "seconds", "right"]


def read(paths: list[Path], case: dict[str, Any]) -> tuple[bool, str]:
    """Whether the records and their columns are right; for a file that cannot be decided, whether the error asks for the columns."""
    try:
        data = Dataset.of(hf.read([str(path) for path in paths]))
    except DataError as error:
        return case["status"] == ["asked"] and str(error).count("--input") == 2, "asked"
    names = {(record.u_name, record.y_name) for record in data}
    return names == {(case["input"], case["output"])} and len(data) == case["records"], ""


def quantities(paths: list[Path], case: dict[str, Any]) -> tuple[bool, str]:
    """Whether the quantities of the first record are right, and their values beside the right ones."""
    if "quantities" not in case:
        return True, ""
    first = next(iter(hf.quantities(hf.read([str(path) for path in paths])).rows.values()))
    found, shown, right = {one.name: one for one in first}, [], True
    for name, value in case["quantities"].items():
        one = found.get(name)
        right &= one is not None and abs(one.value - value) <= max(WITHIN * abs(value), 2 * (one.stderr or 0.0))
        shown.append(f"{name} {'-' if one is None else f'{one.value:.5g}'} ({value:.5g})")
    return right, ", ".join(shown)


def fit(paths: list[Path], case: dict[str, Any], out: Path) -> tuple[bool, list[Any]]:
    """Whether the bare command answers rightly; its model, status, error and seconds."""
    folder = out / hashlib.sha256(str(paths).encode()).hexdigest()[:12]
    command = [sys.executable, "-m", "hystfit", "fit", *map(str, paths), "--out", str(folder), "--force"]
    started = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    seconds = time.perf_counter() - started
    if case["status"] == ["asked"]:
        return done.returncode == 2 and "--input" in done.stderr, ["", "asked", None, seconds]
    content = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    error = content["metrics"]["train"]["nrmse_percent"]
    right = content["status"] in case["status"] and (error <= case["error"] if "error" in case else True)
    return right and "Warning" not in done.stderr, [content["model"], content["status"], error, seconds]


def main() -> None:
    """Run, check and write the page."""
    options = arguments((__doc__ or "").partition("\n")[0])
    hf.enable_x64()
    results = Results(HERE, options.quick, options.out)
    cases = tomllib.loads((HERE / "files.toml").read_text(encoding="utf-8"))["file"]
    folder = results.measured_path("files", "wild")
    if folder is None:
        return results.finish()
    rows, count, good = [], 0, 0
    for case in cases:
        paths = [folder / name for name in case["names"]]
        for path, digest in zip(paths, case["sha256"], strict=True):
            if hashlib.sha256(path.read_bytes()).hexdigest() != digest:
                raise DataError(f"{path} is not the file of {case['source']}: its checksum differs")
        columns, _ = read(paths, case)
        values, shown = quantities(paths, case) if columns and case["status"] != ["asked"] else (columns, "")
        answered, answer = (True, ["", "", None, 0.0]) if options.quick else fit(paths, case, results.out)
        right = columns and values and answered
        count, good = count + len(paths), good + len(paths) * right
        model, status, error, seconds = answer
        rows.append(
            [
                " + ".join(case["names"]),
                case["records"],
                case["input"],
                case["output"],
                model,
                status,
                error,
                shown,
                seconds,
                "yes" if right else "no",
            ]
        )
        print(f"  {'right' if right else 'WRONG'} {rows[-1]}", flush=True)
    results.add("files", count)
    read_right, answered_right = (
        "files that are read with the right columns and quantities",
        "files that the first command answers rightly",
    )
    results.add(read_right if options.quick else answered_right, good)
    if not (options.quick or options.out):
        about = (__doc__ or "").partition("\n")[0]
        (HERE / "RESULTS.md").write_text(
            f"# Ordinary files\n\n{about} Written by `run.py`.\n\n{table(HEAD, rows)}", encoding="utf-8"
        )
    results.finish()


if __name__ == "__main__":
    main()
