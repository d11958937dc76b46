"""All benchmarks in one process, as one table of ratios: `python benchmarks/run.py [--quick | --record] [PART ...]`.

A ratio is the peer's time over that of hystfit. The run fails where a ratio is below its floor in `floors.json`. `--quick` proves that
everything runs, on little work, and judges nothing; `--record` rewrites the floors, at `MARGIN` of the ratios found.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.metadata
import json
import os
import platform
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rows import Row, markdown

import hystfit as hf

PARTS = ("steps", "calls", "compositions", "fit", "preisach", "sampling", "ukf", "reading")
PACKAGES = ("jax", "numba", "numpy", "scipy", "optimistix", "lmfit", "jaxopt", "emcee", "filterpy", "pandas")
MARGIN = 0.7  # of a recorded ratio: other work on the machine moves ratios by up to a third
HERE = Path(__file__).parent
FLOORS = HERE / "floors.json"
OUT = HERE.parent / "build" / "benchmarks"


def machine() -> dict[str, Any]:
    """Processor and versions."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    versions: dict[str, str | None] = {}
    for package in PACKAGES:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            versions[package] = None
    cpu = names[0] if names else platform.processor()
    return {"cpu": cpu, "cores": os.cpu_count(), "python": platform.python_version(), **versions}


def below(rows: Sequence[Row], floors: dict[str, dict[str, float]]) -> list[str]:
    """Rows whose ratio is below the floor, in words."""
    return [
        f"{row.name}: {row.ratio:.2f} is below its floor {floors[row.name]['floor']:.2f} (recorded {floors[row.name]['value']:.2f})"
        for row in rows
        if row.ratio is not None and row.name in floors and row.ratio < floors[row.name]["floor"]
    ]


def unguarded(rows: Sequence[Row], floors: dict[str, dict[str, float]]) -> list[str]:
    """Names of rows that have a ratio and no floor."""
    return [row.name for row in rows if row.ratio is not None and row.name not in floors]


def measured(parts: Sequence[str], quick: bool) -> list[Row]:
    """Rows of the named parts."""
    rows: list[Row] = []
    for part in parts:
        begin = time.perf_counter()
        rows += importlib.import_module(part).measure(quick)
        print(f"{part}: {time.perf_counter() - begin:.0f} s", file=sys.stderr, flush=True)
    return rows


def alone(part: str) -> None:
    """The command line of one part."""
    sys.argv.append(part)
    main()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="little work; no floors are judged")
    parser.add_argument("--record", action="store_true", help="write the floors anew")
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}; all by default")
    chosen = parser.parse_args()
    parts = chosen.parts or PARTS
    if unknown := set(parts) - set(PARTS):
        parser.error(f"unknown part {min(unknown)}; the parts are {', '.join(PARTS)}")
    hf.enable_x64()
    rows = measured(parts, chosen.quick)
    floors = json.loads(FLOORS.read_text()) if FLOORS.is_file() else {}
    if chosen.record and not chosen.quick:
        found = {row.name: row.ratio for row in rows if row.ratio is not None}
        floors |= {name: {"value": round(r, 3), "floor": round(MARGIN * r, 3)} for name, r in found.items()}
        FLOORS.write_text(json.dumps(floors, indent=2) + "\n")
    table = markdown(rows, floors)
    print(table)
    OUT.mkdir(parents=True, exist_ok=True)
    described = {"schema": "hystfit.benchmarks/1", "quick": chosen.quick, "machine": machine()}
    described["rows"] = [row.to_dict() for row in rows]
    (OUT / "benchmarks.json").write_text(json.dumps(described, indent=2) + "\n")
    (OUT / "benchmarks.md").write_text(table)
    short = [] if chosen.quick else below(rows, floors)
    for line in short:
        print("BELOW", line)
    if not chosen.quick and (names := unguarded(rows, floors)):
        print("without a floor (record them with --record):", "; ".join(names))
    raise SystemExit(int(bool(short)))


if __name__ == "__main__":
    main()
