"""Saved fits and posteriors in hard use: thousands of changed files, and saves that are killed.

    python -m tests.hard.fits            # 10 000 changed files and 200 kills, some minutes
    python -m tests.hard.fits --quick    # 400 and 20

A changed file without a changed manifest must be refused or open as the same result. With a manifest that fits the change (an intended
edit), it must be refused in words, or open; "differs" counts those that open and say something else than result.json. Anything else is
a failure: a traceback, or another result under an old manifest. Exit status 1 after any failure.
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import hashlib
import io
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

import hystfit as hf
from hystfit.errors import HystfitError
from hystfit.outcome import Status
from hystfit.sampling.diagnostics import Convergence
from hystfit.sampling.posterior import Posterior

ODD = (
    None,
    True,
    False,
    0,
    -1,
    1,
    10**400,
    1e308,
    -1e-308,
    0.5,
    "",
    "x",
    "nan",
    "ok",
    "\x00",
    [],
    [[]],
    [None],
    [1.0],
    {},
    {"a": 1},
)


def example(offset: float = 0.0, model: str = "bouc-wen") -> hf.FitResult:
    """A fit of two simulated cycles; another offset makes another fit."""
    t = np.arange(160) / 80
    u = 20 * (1 - np.cos(2 * np.pi * t))
    y = np.asarray(hf.simulate(hf.BoucWen(c=0.2, mu=0.5, tau=0.05, rho=0.4, offset=offset), u)[0])
    y = y + 0.01 * np.random.default_rng(1).normal(size=u.size)
    return hf.fit(model, hf.Record(u=u, y=y, t=t, u_unit="V", y_unit="um", name="loop"), starts=1)


def draws_of(result: hf.FitResult) -> Posterior:
    """Draws about a fit, not from a sampler."""
    names = (*result.free_names, "noise_white")
    draws = np.append(result.x, 0.01) + 1e-4 * np.random.default_rng(2).normal(size=(2, 40, len(names)))
    return Posterior(
        result=result, sampler="nuts", noise="iid", names=names, units=tuple("" for _ in names), draws=draws,
        log_density=np.zeros((2, 40)), stats={"diverging": np.zeros((2, 40))}, convergence=Convergence.of(draws), status=Status.OK,
        notes=(), priors=dict.fromkeys(names, "flat"), seconds=1.0, seed=0, provenance={"date": "2026-01-01"},
    )  # fmt: skip


# -- changes -------------------------------------------------------------------------------------------------------------


def places(value: Any, path: tuple = ()) -> Iterator[tuple]:
    """Paths of all members of a JSON value."""
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, item in items:
        yield (*path, key)
        yield from places(item, (*path, key))


def changed_json(content: bytes, rng: random.Random) -> bytes:
    """One member replaced, removed, added, exchanged with another one, or renamed."""
    stored = json.loads(content)
    known = list(places(stored))
    path = rng.choice(known)
    holder = stored
    for key in path[:-1]:
        holder = holder[key]
    act = rng.choice(("replace", "replace", "remove", "nudge", "exchange", "rename", "add"))
    if act == "remove":
        del holder[path[-1]]
    elif act == "rename" and isinstance(holder, dict):
        holder[f"{path[-1]}x"] = holder.pop(path[-1])
    elif act == "add" and isinstance(holder, list):
        holder.insert(path[-1], copy.deepcopy(rng.choice(ODD)))
    elif act == "exchange":
        other = stored
        for key in rng.choice(known):
            other = other[key]
        holder[path[-1]] = copy.deepcopy(other)
    elif act == "nudge" and type(holder[path[-1]]) in (int, float):
        holder[path[-1]] *= rng.choice((0, -1, 2, 1e-9, 1e300))
    else:
        holder[path[-1]] = copy.deepcopy(rng.choice(ODD))
    return json.dumps(stored).encode()


def changed_bytes(content: bytes, rng: random.Random) -> bytes:
    """Bytes flipped, cut off, repeated, or zeroed."""
    data, act, at = bytearray(content), rng.choice(("flip", "cut", "repeat", "zero")), rng.randrange(len(content))
    if act == "flip":
        for _ in range(rng.choice((1, 1, 4, 64))):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    elif act == "cut":
        del data[at:]
    elif act == "repeat":
        data[at:at] = data[at : at + rng.randrange(1, 200)]
    else:
        data[at : at + 32] = bytes(len(data[at : at + 32]))
    return bytes(data)


def changed_labels(content: bytes, rng: random.Random) -> bytes:
    """An .npz file with labels or arrays of other types and shapes."""
    with np.load(io.BytesIO(content)) as stored:
        arrays = {name: stored[name] for name in stored.files}
    name = rng.choice(list(arrays))
    if name == "labels":
        arrays[name] = np.array(changed_json(str(arrays[name]).encode(), rng).decode())
    else:
        a = arrays[name]
        odd = (
            a[:-1],
            a[:, None],
            a.astype(complex),
            a.astype(str),
            a * np.nan,
            a[:0],
            a.astype(int),
            a[::-1],
            np.float64(1.0),
            a * 1e300,
        )
        arrays[name] = odd[rng.randrange(len(odd))]
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def changed_header(content: bytes, rng: random.Random) -> bytes:
    """A posterior file whose header was changed."""
    import h5py

    buffer = io.BytesIO(content)
    with h5py.File(buffer, "r+") as file:
        attributes = file["posterior"].attrs
        attributes["hystfit"] = changed_json(attributes["hystfit"].encode(), rng).decode()
    return buffer.getvalue()


def reseal(folder: Path) -> None:
    """A manifest that fits the files."""
    file = folder / "manifest.json"
    stored = json.loads(file.read_text())
    stored["files"] = {name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in stored["files"]}
    file.write_text(json.dumps(stored))


# -- what must hold ------------------------------------------------------------------------------------------------------


def same(one: Any, other: Any) -> bool:
    """Whether two JSON values are equal, types included."""
    return json.dumps(one, sort_keys=True) == json.dumps(other, sort_keys=True)


def outcome(open_it: Callable[[], Any], whole: dict[str, Any], stored: Callable[[], Any] | None) -> str:
    """refused, same, as stored, differs, another result, or traceback.

    Args:
        open_it: opens a folder and returns what its result.json should be.
        whole: that of the result before the change.
        stored: result.json of the folder, where it may differ from `whole`; None where it may not.
    """
    try:
        opened = open_it()
    except HystfitError:
        return "refused"
    except Exception:
        return "traceback\n" + "".join(traceback.format_exc(limit=-4))
    if same(opened, whole):
        return "same"
    if stored is None:
        return "another result"
    return "as stored" if agrees(opened, stored()) else "differs"


def agrees(opened: Any, stored: Any) -> bool:
    """Whether an opened result says what result.json says; advice, names and derived quantities are computed from the rest."""
    computed = (
        "model",
        "advice",
        "derived",
        "divergences",
        "acceptance",
        "draws",
        "chains",
        "notes",
        "parameters",
        "evidence",
        "quantities",
    )
    keys = [key for key in stored if key in opened and key not in computed]
    return all(same(opened[key], stored[key]) for key in keys if key not in ("verdict", "identifiability"))


def open_fit(folder: Path, trust: bool) -> Callable[[], Any]:
    """Opens a fit and uses it."""

    def act() -> Any:
        result = hf.load_fit(folder, trust=trust)
        str(result)
        result.predict(result.data[0])
        return result.to_dict()

    return act


def open_posterior(folder: Path, trust: bool) -> Callable[[], Any]:
    """Opens a posterior and uses it."""

    def act() -> Any:
        posterior = hf.load_posterior(folder, trust=trust)
        str(posterior)
        return posterior.to_dict()

    return act


def run_changes(results: list[Any], count: int, scratch: Path, rng: random.Random) -> tuple[Counter, list[str]]:
    """Counts by (file, manifest, outcome), and what failed."""
    table: Counter = Counter()
    failures: list[str] = []
    kinds: list[tuple[str, Callable[[bytes, random.Random], bytes]]] = [
        ("result.json", changed_json), ("result.json", changed_bytes), ("model.json", changed_json), ("model.json", changed_bytes),
        ("records.npz", changed_labels), ("records.npz", changed_bytes), ("manifest.json", changed_json),
    ]  # fmt: skip
    for number in range(count):
        made = results[number % len(results)]
        is_fit = isinstance(made, hf.FitResult)
        whole, source = made.to_dict(), scratch / f"whole-{number % len(results)}"
        if not source.exists():
            made.save(source, report=False) if is_fit else made.save(source)
        folder = scratch / "changed"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(source, folder)
        chosen = (
            kinds
            if is_fit
            else [("posterior.nc", changed_header), ("posterior.nc", changed_bytes), ("result.json", changed_bytes)]
        )
        name, change = rng.choice(chosen)
        (folder / name).write_bytes(change((folder / name).read_bytes(), rng))
        # Damage within HDF5 is kept from its library by the manifest; with a forged one, the library itself may fail (SECURITY.md).
        sealed = rng.random() < 0.75 and name != "manifest.json" and (name, change) != ("posterior.nc", changed_bytes)
        if sealed:
            reseal(folder)
        stored = lambda folder=folder: json.loads((folder / "result.json").read_bytes())
        said = outcome((open_fit if is_fit else open_posterior)(folder, sealed), whole, stored if sealed else None)
        label = said.partition("\n")[0]
        table["fit" if is_fit else "posterior", name, "fits" if sealed else "old", label] += 1
        if label in ("traceback", "another result"):
            failures.append(f"{name}, {change.__name__}, number {number}: {said}")
    return table, failures


def run_kills(
    first: hf.FitResult, second: hf.FitResult, count: int, scratch: Path, rng: random.Random
) -> tuple[Counter, list[str]]:
    """Processes that save two fits in turn are killed at random moments; the folder must hold one of the two."""
    folder, table, failures = scratch / "killed", Counter(), []
    known = {"first": first.to_dict(), "second": second.to_dict()}
    first.save(folder, report=False)
    for number in range(count):
        child = os.fork()
        if child == 0:
            while True:
                for result in (second, first):
                    result.save(folder, report=False)
        time.sleep(rng.uniform(0.0, 0.15))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        try:
            opened = hf.load_fit(folder).to_dict()
            label = next((name for name, content in known.items() if same(opened, content)), "a mixture")
        except Exception as error:
            label = f"{type(error).__name__}: {error}"
        table["fit", "killed while saving", "", label] += 1
        if label not in known:
            failures.append(f"kill {number}: {label}")
    first.save(folder, report=False)
    if litter := {path.name for path in folder.iterdir()} - {
        "result.json",
        "model.json",
        "records.npz",
        "manifest.json",
    }:
        failures.append(f"left after the kills: {litter}")
    return table, failures


def main(quick: bool = False, seed: int = 0) -> int:
    """Print the counts; 1 after any failure."""
    hf.enable_x64()
    rng = random.Random(seed)
    fits = [example(), example(model="prandtl-ishlinskii:plays=4")]
    results = [*fits, fits[0], draws_of(fits[0])]
    begun = time.perf_counter()
    with tempfile.TemporaryDirectory() as name, warnings.catch_warnings(), contextlib.redirect_stderr(io.StringIO()):
        warnings.simplefilter("ignore")
        changes, failures = run_changes(results, 400 if quick else 10_000, Path(name), rng)
        kills, more = run_kills(fits[0], example(offset=3.0), 20 if quick else 200, Path(name), rng)
    for (kind, file, manifest, said), count in sorted((changes + kills).items()):
        print(f"{kind:<10} {file:<20} {'manifest ' + manifest if manifest else '':<14} {said:<16} {count:>6}")
    failures += more
    total = sum(changes.values()) + sum(kills.values())
    print(f"{total} cases, {len(failures)} failures, {time.perf_counter() - begun:.0f} s")
    for failure in failures[:20]:
        print(failure)
    return 1 if failures else 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    sys.exit(main(options.quick, options.seed))
