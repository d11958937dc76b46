"""One small amplitude does not determine a Bouc-Wen model: notes, profiles and a designed input."""

from __future__ import annotations

import numpy as np
from common import Results, table
from noises import NAMES, TRUTH

import hystfit as hf
from hystfit.outcome import Code

SIGMA = 0.01


def measured(u: np.ndarray, seed: int, name: str = "") -> hf.Record:
    """Measured output of the true device."""
    y = np.asarray(hf.simulate(TRUTH, u)[0])
    return hf.Record(u=u, y=y + SIGMA * np.random.default_rng(seed).normal(size=u.size), name=name or "one amplitude")


def sine(amplitude: float, samples: int = 600) -> np.ndarray:
    """Three cycles."""
    return amplitude * np.sin(2 * np.pi * 3 * np.arange(samples) / samples)


def run(results: Results) -> dict[str, str]:
    """Notes, number of finite standard errors for parameters without limits, and profiles with the designed input."""
    result = hf.fit(TRUTH, measured(sine(0.1), 0), starts=4, noise="iid")
    undetermined = [note for note in result.notes if note.code is Code.NOT_DETERMINED]
    found = hf.profile(result)
    opened = [name for name, p in found.profiles.items() if not p.closed]
    results.add("one amplitude: rank", float(result.rank or 0))
    results.add("one amplitude: undetermined directions named", len(undetermined))
    results.add("one amplitude: open profiles", len(opened))
    results.add("one amplitude: finite errors beside open profiles", contradictions(result, found))
    made = hf.design(result, low=-1.0, high=1.0, samples=600, steps=20 if results.quick else 150)
    results.add("design: directions that it promises to close", len(made.closes))
    again = hf.fit(TRUTH, [result.data[0], measured(made.best.u, 1, "designed")], starts=4, noise="iid")
    closed = hf.profile(again, NAMES)
    results.add("design: profiles still open", sum(not p.closed for p in closed.profiles.values()))
    rows = [[n, result[n].value, result[n].stderr, _limits(found[n]), again[n].value, again[n].stderr, _limits(closed[n])]
            for n in NAMES]  # fmt: skip
    head = ["", "one amplitude", "error", "profile", f"with the designed input ({made.best.name})", "error", "profile"]
    tables = {
        "profiles": table(head, rows),
        "verdict": "\n".join(f"- {note}" for note in (*undetermined, *made.notes)) + "\n",
    }
    if not results.quick:
        tables["sweep"] = sweep(results)
    return tables


def _limits(profile: object) -> str:
    return str(profile).partition(": ")[2]


def contradictions(result: hf.FitResult, found: object) -> int:
    """Number of parameters with a finite standard error but without a confidence limit."""
    profiles = found.profiles  # type: ignore[attr-defined]
    return sum(not p.closed and result[name].stderr is not None for name, p in profiles.items())


def sweep(results: Results) -> str:
    """The same over amplitudes and seeds."""
    rows, total = [], 0
    for amplitude in (0.05, 0.1, 0.2, 0.3, 0.5, 1.0):
        counts = np.zeros(4, int)
        for seed in range(10):
            result = hf.fit(TRUTH, measured(sine(amplitude), seed), starts=4, noise="iid")
            found = hf.profile(result)
            opened = sum(not p.closed for p in found.profiles.values())
            finite = sum(result[name].stderr is not None for name in found.profiles)
            counts += [opened, finite, contradictions(result, found), bool(result.rank == len(result.free_names))]
        total += counts[2]
        rows.append([amplitude, counts[0] / 10, counts[1] / 10, int(counts[2]), int(counts[3])])
    results.add("one amplitude, sixty records: finite errors beside open profiles", total)
    return table(
        [
            "amplitude",
            "profiles without limits per record",
            "finite errors per record",
            "both at once, of 50",
            "full rank, of 10",
        ],
        rows,
    )
