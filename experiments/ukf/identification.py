"""M1 to M4: loops and creep of the actuator, and its identification from records."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import jax.numpy as jnp
import numpy as np
from common import Results, table
from plants import FAR, bare, hysteresis_record, modulated, off

from hystfit import Duhem, LogCreep, Record, Series, datasets, simulate
from hystfit.fitting.fit import fit
from hystfit.identify import Phase, Ukf, identify, identify_in_stages, identify_online
from hystfit.outcome import Status
from hystfit.stage import axis_plant, piezo

TRUE = np.array([0.1542, 0.45, 0.01086, 0.00956])
AMPLITUDES = (20.0, 40.0, 60.0, 80.0, 100.0)  # V
FREQUENCIES = (0.1, 1.0, 10.0, 100.0)  # Hz
FACTORS = (
    (3.0, 0.5, 0.3, 0.3),
    (0.3, 1.5, 3.0, 2.0),
    (0.3, 0.5, 3.0, 0.5),
    (3.0, 1.5, 0.3, 0.3),
)  # of c, mu, tau, delta
RING_DOWN = 0.15  # s, twelve time constants of the 630 Hz mode


def loop(
    model: Any, frequency: float = 1.0, low: float = -20.0, high: float = 100.0, *, periods: int = 3, count: int = 1000
) -> tuple[np.ndarray, np.ndarray]:
    """Voltage [V] and displacement [um] of the last of a number of periods of a sine.

    Args:
        model: voltage to displacement.
        frequency: of the sine [Hz].
        low, high: its range [V].
        periods: their number.
        count: samples of one period.
    """
    k = np.arange(periods * count + 1)
    start = np.arcsin(np.clip(-(high + low) / (high - low), -1, 1))
    u = 0.5 * (high + low) + 0.5 * (high - low) * np.sin(2 * np.pi * k / count + start)
    y = simulate(model, jnp.asarray(u), jnp.full(u.size, 1 / (frequency * count)).at[0].set(0.0))[0]
    return u[-count - 1 :], np.asarray(y)[-count - 1 :]


def width(u: np.ndarray, y: np.ndarray) -> float:
    """Width of a loop at the center of its input range, of the unit of y. Args as `loop` returns them."""
    rising = np.gradient(u) > 0
    center = 0.5 * (u.max() + u.min())
    branches = [np.interp(center, *(v[side][np.argsort(u[side])] for v in (u, y))) for side in (rising, ~rising)]
    return float(branches[1] - branches[0])


def loops_and_creep(results: Results) -> tuple[str, dict[float, Any]]:
    """M1, M2, M3; the table, and the loops of the whole axis by frequency."""
    results.add("M1: hysteresis at 40 V, um", width(*loop(bare())))
    widths = {high: width(*loop(bare(), high=high, low=0.0)) for high in AMPLITUDES}
    for high in (20.0, 60.0):
        results.add(f"M2: width at 0..{high:g} V over that at 0..100 V", widths[high] / widths[100.0])
    rung_down = lambda f: max(3, round(RING_DOWN * f))
    loops = {f: loop(axis_plant(gain=1.0), f, periods=rung_down(f)) for f in FREQUENCIES}
    rows = [[f, width(*loop(piezo(), f)), width(*loops[f])] for f in FREQUENCIES]
    results.add("M2: width at 10 Hz over that at 0.1 Hz", rows[2][2] / rows[0][2])
    results.add("M2: width at 100 Hz over that at 10 Hz", rows[3][2] / rows[2][2])
    t = np.concatenate([[0.0, 10.0], 10.0 + np.geomspace(0.1, 1000.0, 400)])
    u = np.where(t > 10.0, 100.0, 0.0)
    y = np.asarray(simulate(piezo(), jnp.asarray(u), jnp.diff(jnp.asarray(t), prepend=0.0))[0])
    results.add("M3: creep from 0.1 to 1000 s after 100 V, um", y[-1] - y[2])
    families = table(["amplitude / V", "width / um"], [list(row) for row in widths.items()])
    head = ["frequency / Hz", "hysteresis and creep, width / um", "with the 630 Hz mode / um"]
    return families + "\n" + table(head, rows), loops


def _judge(model: Any, record: Any) -> tuple[float, float]:
    """Largest parameter error and largest simulation error against the noise-free truth, both in percent."""
    x = np.array([model.c, model.mu, model.tau, model.tau * model.rho])
    clean = np.asarray(simulate(bare(), jnp.asarray(record.u))[0])
    run = np.asarray(simulate(model, jnp.asarray(record.u))[0])
    return float(100 * np.max(np.abs(x / TRUE - 1))), float(100 * np.max(np.abs(run - clean)) / np.ptp(clean))


def filter_and_least_squares(results: Results, seeds: int) -> tuple[str, Any]:
    """M4: the filter from a start far from the truth, and least squares on the same records."""
    rows, kept, ratios = [], None, []
    for noise in (0.005, 0.02):
        for seed in range(seeds if noise == 0.005 else max(1, seeds // 4)):
            record = hysteresis_record(seed, noise)
            identified = Ukf.of(off(bare(), FAR), record, start="model").fit(record)
            fitted = fit(identified.model, record, start="model", starts=1)
            errors, others = _judge(identified.model, record), _judge(fitted.model, record)
            ratios.append(others[1] / errors[1])
            rows.append([noise, seed, *errors, float(identified.state.tally[5]), *others])
            kept = kept or (record, identified)
    near = [row for row in rows if row[0] == 0.005]
    results.add("M4: worst parameter %, 5 nm", max(row[2] for row in near))
    results.add("M4: free-run maximum %, 5 nm", max(row[3] for row in near))
    results.add("M4: lowest mean NIS, 5 nm", min(row[4] for row in near))
    results.add("M4: highest mean NIS, 5 nm", max(row[4] for row in near))
    results.add("M4: least squares / filter, free-run maximum against the truth, worst", max(ratios))
    far = [row for row in rows if row[0] == 0.02]
    results.add("M4: worst parameter %, 20 nm", max(row[2] for row in far))
    head = [
        "noise / um",
        "seed",
        "filter: worst parameter %",
        "free run max %",
        "mean NIS",
        "least squares: worst parameter %",
        "free run max %",
    ]
    return table(head, rows), kept


def far_starts(results: Results) -> str:
    """The filter from starts off by factors of 0.3 to 3, with a prior as wide."""
    record, rows = hysteresis_record(0), []
    for factors in FACTORS:
        start = off(bare(), dict(zip(FAR, factors, strict=True)))
        result = Ukf.of(start, record, start="model", prior=1.0).fit(record)
        rows.append([*factors, result.status.value, *_judge(result.model, record)])
    good = [row for row in rows if row[4] == Status.OK]
    results.add("M4: starts off by factors of 0.3 to 3 that converge, of 4", len(good))
    results.add("M4: starts off by factors of 0.3 to 3, free-run maximum % of those", max(row[6] for row in good))
    results.add("M4: starts off by factors of 0.3 to 3, free-run maximum % of all", max(row[6] for row in rows))
    return table(["c", "mu", "tau", "delta", "status", "worst parameter %", "free run max %"], rows)


def methods(results: Results, starts: int) -> str:
    """The filter, least squares and the sequential regressions on one record: errors, times, and sensitivity to the start."""
    record = hysteresis_record(0, signal=lambda: modulated(10.0, 500.0))
    rng = np.random.default_rng(3)
    factors = [dict(zip(FAR, np.exp(rng.uniform(np.log(0.4), np.log(2.0), 4)), strict=True)) for _ in range(starts)]
    factors = [{**f, "mu": min(f["mu"], 2.0), "delta": min(f["delta"], 1.1 * f["tau"])} for f in factors]
    estimators: dict[str, Any] = {
        "filter": lambda model: Ukf.of(model, record, start="model").fit(record).model,
        "least squares": lambda model: fit(model, record, start="model", starts=1).model,
        "least squares, start from the record": lambda model: fit(model, record, starts=1).model,
    }
    rows = []
    for name, run in estimators.items():
        run(off(bare(), factors[0]))  # compile
        started = time.perf_counter()
        errors = [_judge(run(off(bare(), f)), record)[1] for f in factors]
        seconds = (time.perf_counter() - started) / len(factors)
        rows.append(
            [
                f"Bouc-Wen, {name}",
                float(np.median(errors)),
                max(errors),
                float(np.mean(np.array(errors) < 0.2)),
                seconds,
            ]
        )
        results.add(f"methods: share of starts within 0.2 %, {name}", rows[-1][3])
    clean = np.asarray(simulate(bare(), jnp.asarray(record.u))[0])
    for name in ("rls", "gradient-correction"):
        identify(record, name, Duhem())
        started = time.perf_counter()
        model = identify(record, name, Duhem()).model
        seconds = time.perf_counter() - started
        error = (
            np.inf if model is None else np.max(np.abs(np.asarray(simulate(model, jnp.asarray(record.u))[0]) - clean))
        )
        rows.append([f"Duhem, {name} (needs no start)", 100 * float(error / np.ptp(clean)), None, None, seconds])
    head = ["method", "free run max %, median", "worst", "share within 0.2 %", "s a run, report included"]
    return table(head, rows)


def identify_actuator(fast: Record, slow: Record) -> tuple[Series, list[Any]]:
    """Hysteresis from one record, creep from the other, then both from both: the model for control, and the stages.

    The offsets are zeros of the sensor in each record; the model for control has none.

    Args:
        fast: several amplitudes at 1 Hz.
        slow: a staircase, or a step and a hold, of 100 s or more.
    """
    start = Series(off(bare(), {"c": 1.1, "mu": 0.9, "tau": 1.2, "delta": 1.0}), LogCreep(gamma=(0.01,)))
    phases = [
        Phase(fast, ("c", "mu", "bouc_wen.tau", "rho", "offset")),
        Phase(slow, ("gamma", "offset"), {"hold": "none"}),
        Phase([fast, slow], settings={"prior": 0.05, "hold": "none"}),
    ]
    model, stages = identify_in_stages(start, phases)
    hysteresis, creep = model.parts
    return Series(dataclasses.replace(hysteresis, offset=0.0), creep), stages


def in_stages(results: Results) -> tuple[str, Series]:
    """Hysteresis, creep, then both, from the bundled records: the table, and the model that M5 to M8 invert."""
    fast, slow = datasets.load("stage-sweep"), datasets.load("stage-step")
    model, stages = identify_actuator(fast, slow)
    hysteresis, creep = model.parts
    x = np.array([hysteresis.c, hysteresis.mu, hysteresis.tau, hysteresis.tau * hysteresis.rho])
    results.add("M4: staged, gamma off by %", 100 * abs(float(creep.gamma[0]) / 0.0175 - 1))
    results.add("M4: staged, worst hysteresis parameter %", 100 * np.max(np.abs(x / TRUE - 1)))
    second = stages[1].model.parts[1].gamma[0]
    results.add("M4: staged, gamma off by % after the second stage", 100 * abs(float(second) / 0.0175 - 1))
    errors = [result.free_run.nrmse_percent for result in stages]
    results.add("M4: staged, free-run RMS %", errors[-1])
    rows = [[k + 1, ", ".join(r.names), error] for k, (r, error) in enumerate(zip(stages, errors, strict=True))]
    if not results.quick:
        both = fit(model, [fast, slow], start="model", starts=1)
        gamma = float(both.model.parts[1].gamma[0])
        results.add("M4: hysteresis and creep by least squares, gamma off by %", 100 * abs(gamma / 0.0175 - 1))
        rows.append(["least squares", "all", both.train.nrmse_percent])
    return table(["stage", "free", "free run RMS % of range"], rows), model


def online(results: Results) -> str:
    """The filter is fed every 2 s and stops by itself; the worst of three seeds."""
    rows = []
    for seed in range(3):
        record = hysteresis_record(seed)
        result = identify_online(Ukf.of(off(bare(), FAR), record, start="model"), record, block=1000)
        used = result.counts["total"] / len(record) * 20.0
        rows.append([seed, used, result.status.value, *_judge(result.model, record)])
    results.add("M4: on-line, seeds that stop by themselves, of 3", sum(row[2] == Status.OK for row in rows))
    results.add("M4: on-line, latest stop, s of 20", max(row[1] for row in rows))
    results.add("M4: on-line, free-run maximum % after the stop", max(row[4] for row in rows))
    return table(["seed", "stopped after / s", "status", "worst parameter %", "free run max % of all 20 s"], rows)


def one_amplitude(results: Results) -> None:
    """A sine of one amplitude: the model follows it, though the record does not determine the parameters."""

    def sine() -> tuple[np.ndarray, np.ndarray]:
        t = np.arange(10_000) / 1000.0
        return t, 40 + 60 * np.sin(2 * np.pi * t + np.arcsin(-2 / 3))

    record = hysteresis_record(0, signal=sine)
    model = Ukf.of(off(bare(), FAR), record, start="model").fit(record).model
    results.add("M4: one amplitude, free-run maximum %", _judge(model, record)[1])
