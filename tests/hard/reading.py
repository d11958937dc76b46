"""Hard use of the file reader: a read is right, refused, or says what it left out.

    python -m tests.hard.reading --files 0:100000 --mutations 0:100000 [--out results.json]
    python -m tests.hard.reading --layouts 0:20000 [--keep DIR]

Every seed makes one file. Its outcome is `right` (the numbers that were written), `refused` (HystfitError), `noted` (other numbers,
and a note on missing or left-out values, or a warning), `wrong` (other numbers, in silence), `crashed` (any other exception) or
`slow`. Mutated files have no known numbers: there, `read` stands for a valid record. With --out, seeds that were done are skipped.
Layouts are files as instruments write them, read without options; `tests.hard.layouts.scorer` has their outcomes.
"""

from __future__ import annotations

import argparse
import collections
import faulthandler
import json
import sys
import tempfile
import time
import traceback
import warnings
from pathlib import Path

import numpy as np

from hystfit.data import Dataset
from hystfit.errors import HystfitError
from hystfit.outcome import Code, Severity
from hystfit.reading import read

from .dialects import Case, case_of
from .layouts import SILENT, survey
from .mutations import mutation_of

SLOWEST = 5.0  # s
BAD = ("wrong", "crashed", "slow")
_TELLING = (Code.LEFT_OUT, Code.MISSING_VALUES, Code.COARSE_CLOCK)
_NOT_USED = "not used"


def outcome_of_file(seed: int, folder: Path) -> tuple[str, str]:
    """Outcome of the generated file of a seed, and details."""
    case = case_of(seed)
    path = folder / f"file{case.suffix}"
    path.write_bytes(case.content)
    started = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            data = Dataset.of(read(path, **case.arguments))
    except HystfitError as error:
        return "refused", str(error).replace(str(path), "FILE")
    except Exception:
        return "crashed", traceback.format_exc()
    finally:
        path.unlink()
    if time.perf_counter() - started > SLOWEST:
        return "slow", f"{time.perf_counter() - started:.1f} s"
    wrong = _difference(case, data)
    if not wrong:
        return "right", ""
    told = [
        note.text
        for record in data
        for note in record.notes
        if (note.code in _TELLING and not note.text.startswith("columns not used"))
        or note.severity is not Severity.INFO
    ]
    return ("noted" if told else "wrong"), wrong + "; " + "; ".join(dict.fromkeys(told))


def _difference(case: Case, data: Dataset) -> str:
    """What differs from the truth; "" for nothing."""
    if len(data) != 1:
        return f"{len(data)} records"
    record = data[0]
    for role, true in (("u", case.u), ("y", case.y), ("t", case.t)):
        values = getattr(record, role)
        if (true is None) != (values is None):
            return f"{role} is {'missing' if values is None else 'there'}"
        if true is None:
            continue
        if values.shape != true.shape:
            return f"{role} has {values.size} of {true.size} samples"
        close = 1e-9 * max(1.0, float(np.abs(true).max())) if role == "t" else 0.0
        shift = true[0] - values[0] if role == "t" and abs(values[0]) < 1e-12 else 0.0
        if not np.allclose(values + shift, true, rtol=0, atol=close, equal_nan=True):
            return f"{role} differs: {values[:4]} for {true[:4]}"
    return ""


def outcome_of_mutation(seed: int, folder: Path) -> tuple[str, str]:
    """Outcome of the mutated file of a seed, and details."""
    raw, kind = mutation_of(seed)
    path = folder / f"file{kind}"
    path.write_bytes(raw)
    started = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            for record in Dataset.of(read(path)):
                assert np.isfinite(record.u).all()
                assert len(record) > 1
        result = "read", ""
    except HystfitError as error:
        result = "refused", str(error).replace(str(path), "FILE")
    except Exception:
        result = "crashed", traceback.format_exc()
    if time.perf_counter() - started > SLOWEST:
        return "slow", f"{time.perf_counter() - started:.1f} s"
    return result


RUNS = {"files": outcome_of_file, "mutations": outcome_of_mutation}


def run(part: str, seeds: range, out: Path | None = None) -> tuple[collections.Counter[str], list[str]]:
    """Counts of the outcomes of some seeds, and lines on the bad ones.

    Args:
        part: "files" or "mutations".
        seeds: to run.
        out: file of the counts and bad seeds, continued after its last seed.
    """
    stored = json.loads(out.read_text()) if out and out.exists() else {}
    state = stored.setdefault(f"{part} {seeds.start}:{seeds.stop}", {"next": seeds.start, "counts": {}, "bad": []})
    counts = collections.Counter(state["counts"])
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(state["next"], seeds.stop):
            outcome, details = RUNS[part](seed, Path(folder))
            counts[outcome] += 1
            if outcome in BAD:
                state["bad"].append(f"{part} {seed}: {outcome}: {details}")
            if out and (seed % 500 == 499 or seed == seeds.stop - 1):
                state |= {"next": seed + 1, "counts": dict(counts)}
                out.write_text(json.dumps(stored, indent=1))
    return counts, state["bad"]


def seeds_of(text: str) -> range:
    """The range that \"0:1000\" stands for."""
    start, _, stop = text.partition(":")
    return range(int(start), int(stop))


def main() -> int:
    """Run the seeds of the command line; 1 where a file was read wrong in silence, crashed the reader or took too long."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--files", type=seeds_of)
    parser.add_argument("--mutations", type=seeds_of)
    parser.add_argument("--layouts", type=seeds_of)
    parser.add_argument("--keep", type=Path, help="folder for the layouts that are not read right")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--show", type=int, default=10, help="number of bad files that are shown")
    options = parser.parse_args()
    faulthandler.enable()
    status = 0
    for part in RUNS:
        if (seeds := getattr(options, part)) is None:
            continue
        counts, bad = run(part, seeds, options.out)
        for line in bad[: options.show]:
            print(line)
        total = sum(counts.values())
        print(f"{part}: {total} in all, " + ", ".join(f"{counts[key]} {key}" for key in sorted(counts)))
        status |= bool(bad)
    if options.layouts is not None:
        status |= _layouts(options.layouts, options.keep, options.show)
    return status


def _layouts(seeds: range, keep: Path | None, show: int) -> bool:
    """Print the outcomes of the layouts of some seeds; whether one was wrong in silence."""
    found = survey(seeds, keep)
    for kind, seed, outcome, details in found.failures[:show]:
        print(f"layout {seed}, {kind}: {outcome}: {details}")
    print(found.table())
    return found.total[SILENT] > 0


if __name__ == "__main__":
    sys.exit(main())
