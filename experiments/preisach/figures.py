"""Figures like those of the paper."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from common import times
from measured import Measured

import hystfit as hf
from hystfit.control import LoopResult
from hystfit.results.preisach_plots import plot_curves, plot_forc_diagram

INK = {"FF": "C0", "table FF": "C4", "FB": "C1", "line+FB": "C3", "FF+FB": "C2", "table FF+FB": "C5"}


def _save(figure: Any, out: Path, name: str) -> None:
    for axis in figure.axes:
        axis.grid(alpha=0.3)
    figure.savefig(out / f"{name}.png", dpi=110)
    plt.close(figure)


def identification(out: Path, curves: hf.Record, model: hf.Preisach, fast: hf.Record) -> None:
    """Reversal curves, the fitted density, and the loop at 1 Hz (paper's Figs. 5 and 6)."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(15, 4.5), layout="constrained")
    left.plot(curves.u, curves.y, lw=0.7)
    left.set(xlabel="voltage [V]", ylabel="displacement [um]", title="S1: reversal curves, 0.01 Hz")
    n = model.n
    density = np.full((n, n), np.nan)
    levels = np.asarray(model.levels)
    area = np.outer(np.diff(levels), np.diff(levels))
    density[np.tril_indices(n)] = np.asarray(model.masses())
    density = density / (area * np.where(np.eye(n) > 0, 0.5, 1.0))
    image = middle.pcolormesh(levels, levels, 1e3 * density, cmap="viridis")
    middle.set(xlabel="beta [V]", ylabel="alpha [V]", title="density of the cells [nm/V$^2$]", aspect="equal")
    figure.colorbar(image, ax=middle)
    right.plot(fast.u, fast.y, label="device at 1 Hz")
    right.plot(fast.u, np.asarray(hf.simulate(model, fast.u)[0]), "--", label="static model")
    right.set(xlabel="voltage [V]", ylabel="displacement [um]", title="S2: 1 Hz")
    right.legend()
    _save(figure, out, "identification")


def properties(out: Path, wiped: list[hf.Record], loops: hf.Record) -> None:
    """Wiping-out and congruency (paper's Figs. 7 to 12)."""
    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(15, 4.5), layout="constrained")
    for record, label in zip(wiped, ("0, 150, 100, 180, 120 V", "0, 180, 120 V"), strict=True):
        left.plot(times(record) - times(record)[-501], record.y, label=label)
        middle.plot(record.u, record.y, label=label)
    left.set(xlabel="time since 180 V [s]", ylabel="displacement [um]", title="S3: wiping-out")
    middle.set(xlabel="voltage [V]", ylabel="displacement [um]", title="S4: wiping-out")
    left.legend()
    right.plot(loops.u, loops.y)
    right.set(xlabel="voltage [V]", ylabel="displacement [um]", title="S5: minor loops of 80 to 120 V", xlim=(70, 130))
    _save(figure, out, "properties")


def predictions(out: Path, pairs: list[tuple[hf.Record, dict[str, np.ndarray]]]) -> None:
    """Predicted and measured outputs, and their difference (paper's Figs. 13 to 15)."""
    figure, axes = plt.subplots(2, len(pairs), figsize=(6 * len(pairs), 6), layout="constrained")
    for (record, outputs), (top, bottom) in zip(pairs, axes.T, strict=True):
        top.plot(record.u, record.y, label="device")
        for name, y in outputs.items():
            top.plot(record.u, y, "--", label=f"Preisach, {name}")
            bottom.plot(record.t, y - record.y, label=name)
        top.set(xlabel="voltage [V]", ylabel="displacement [um]", title=record.name)
        bottom.set(xlabel="time [s]", ylabel="error [um]")
        for axis in (top, bottom):
            axis.legend()
    _save(figure, out, "predictions")


def tracked(out: Path, runs: dict[str, dict[str, LoopResult]]) -> None:
    """References, errors and inputs (paper's Figs. 17 to 24), one column for each trajectory and plant."""
    figure, axes = plt.subplots(3, len(runs), figsize=(5 * len(runs), 9), layout="constrained", sharex="col")
    thin = slice(None, None, 200)
    for (name, arms), column in zip(runs.items(), axes.T, strict=True):
        first = next(iter(arms.values()))
        column[0].plot(first.t[thin], first.reference[thin], "k", lw=2, label="reference")
        for arm, run in arms.items():
            ink = INK[arm]
            column[0].plot(run.t[thin], run.y[thin], "--", color=ink, label=arm)
            column[1].plot(
                run.t[thin], run.error[thin], lw=0.8, color=ink, label=f"{arm}: max {run.max_error():.2f} um"
            )
            if arm in ("FF+FB", "FB", "FF"):
                column[2].plot(run.t[thin], run.u[thin], lw=0.6, color=ink, label=arm)
        column[0].set(title=name, ylabel="displacement [um]")
        column[1].set(ylabel="error [um]")
        column[2].set(ylabel="voltage [V]", xlabel="time [s]")
        for axis in column:
            axis.legend(fontsize=7)
    _save(figure, out, "tracking")


def frequencies(out: Path, rows: dict[str, list[float]]) -> None:
    """Feed-forward error over frequency."""
    figure, axis = plt.subplots(figsize=(5.5, 4), layout="constrained")
    for name, values in rows.items():
        axis.loglog([0.01, 0.1, 1.0], values, "o-", label=f"{name} inverse")
    axis.set(xlabel="frequency [Hz]", ylabel="largest error of feed-forward within reach [um]", title="S15")
    axis.legend()
    _save(figure, out, "frequencies")


def measured(out: Path, found: Measured) -> None:
    """Reversal curves of nanowires with their density and FORC diagram, and a piezo's minor loops, as measured and predicted."""
    figure, axes = plt.subplots(2, 3, figsize=(16, 9.5), layout="constrained")
    plot_curves(found.curves, found.predicted, axes[0, 0], every=8)
    axes[0, 0].set_title("held-out reversal curves")
    found.fit.plot("density", axes[0, 1])
    axes[0, 1].set_title("density of the cells")
    plot_forc_diagram(found.diagram, axes[0, 2])
    axes[0, 2].set_title("FORC diagram")
    loops, passed = found.loops, times(found.loops) - times(found.loops)[0]
    shown = passed < 30
    axes[1, 0].plot(loops.u[shown], loops.y[shown], lw=0.8, label="measured")
    axes[1, 0].plot(loops.u[shown], found.runs["cells"][shown], "--", lw=0.8, label="cells")
    axes[1, 0].set(xlabel="command [V]", ylabel="displacement [um]", title="minor loops, first 30 s")
    small = shown & (np.abs(passed - 20) < 5)
    axes[1, 1].plot(loops.u[small], loops.y[small], lw=0.8, label="measured")
    axes[1, 1].plot(loops.u[small], found.runs["cells"][small], "--", lw=0.8, label="cells")
    axes[1, 1].set(xlabel="command [V]", ylabel="displacement [um]", title="the same, 15 to 25 s")
    for name, y in found.runs.items():
        axes[1, 2].plot(loops.t, y - loops.y, lw=0.5, label=name)
    axes[1, 2].set(xlabel="time [s]", ylabel="error [um]", title="predicted less measured", ylim=(-1.5, 1.5))
    for axis in axes[1]:
        axis.legend(fontsize=8)
    _save(figure, out, "measured")
