"""The figures and the Markdown page of the Duhem experiment."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from cases import WAVES, WEIGHTS, case
from common import Results
from estimators import gradient_correction, output_error

import hystfit as hf
from hystfit.identify import GradientCorrection, Rls, identify
from hystfit.models.shared.simulation import simulate
from hystfit.results.accuracy import Metrics

INK = {"truth": "0.25", "RLS": "#c0392b", "gradient correction": "#e08e0b", "output error": "#1f6fb4"}
SHOWN = ("paper.png", "loops.png", "histories.png", "rates.png")
HERE = Path(__file__).resolve().parent


class RunErrors(NamedTuple):
    """Simulation of a measured record and its errors in percent of the range; None without a valid model.

    `rest` is the part that was not fitted, `after` the part of it after the last fitted sample.
    """

    record: hf.Record
    fitted: np.ndarray
    simulated: np.ndarray | None
    train: float | None
    rest: float | None
    largest: float | None
    after: float | None

    @property
    def numbers(self) -> tuple[float | None, ...]:
        """For the table."""
        return self.train, self.rest, self.largest, self.after


def free_run_errors(model: Any, whole: hf.Record, train: hf.Record) -> RunErrors:
    """One simulation over the whole input, with errors on the fitted part and on the rest.

    Args:
        model: None where there is none.
        whole: the record.
        train: the same record, in which only the fitted samples count.
    """
    fitted = train.used
    rest = whole.used & ~fitted
    after = rest & (np.arange(len(whole)) > np.flatnonzero(fitted)[-1])
    if model is None:
        return RunErrors(whole, fitted, None, None, None, None, None)
    run = np.asarray(simulate(model, whole.u)[0])
    parts = [Metrics.of([whole.y[mask]], [run[mask]]) for mask in (fitted, rest, after)]
    percents = (parts[0].nrmse_percent, parts[1].nrmse_percent, parts[1].max_error_percent, parts[2].nrmse_percent)
    return RunErrors(whole, fitted, run, *percents)


def figures(out: Path, outcomes: dict, loops: dict) -> None:
    """All figures, as PNG."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    style = {
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.alpha": 0.25,
        "font.size": 9,
    }
    with plt.rc_context({**style, "legend.frameon": False, "savefig.dpi": 95}):
        _paper(plt, out)
        _loops(plt, out)
        _histories(plt, out)
        _rates(plt, out, outcomes)
        if loops:
            _measured(plt, out, loops)


def _save(plt: Any, figure: Any, path: Path) -> None:
    figure.savefig(path)
    plt.close(figure)


def _paper(plt: Any, out: Path) -> None:
    """Loops and errors of both methods in the paper's form (its Figs. 1, 5 and 6): 5 nm noise, one start within 10 %."""
    figure, axes = plt.subplots(2, 3, figsize=(12.5, 6.4), layout="constrained")
    for row, wave in zip(axes, WAVES, strict=True):
        c = case(wave, noise=0.005)
        models = {"RLS": identify(c.record, "rls", basis="powers").model}
        for name, weights in WEIGHTS.items():
            models[f"gradient, {name}"] = gradient_correction(c, 0, basis="powers", weights=weights)
        row[0].plot(c.record.u, c.record.y, ".", ms=1.5, color="0.6", label="record")
        lines = (INK["RLS"], INK["gradient correction"], "#7d3c98")
        for (name, model), ink in zip(models.items(), lines, strict=True):
            run = np.asarray(simulate(model, c.record.u)[0])
            row[0].plot(c.record.u, run, color=ink, lw=1, label=name)
            axis = row[1] if name == "RLS" else row[2]
            axis.plot(1e3 * (run - c.y), color=ink, lw=1, label=name)
        span = c.span
        row[0].set(
            xlabel="input / V", ylabel="output / µm", title=wave, ylim=(c.y.min() - 0.3 * span, c.y.max() + 0.5 * span)
        )
        row[1].set(xlabel="sample k", ylabel="free-run error / nm", title="RLS")
        row[2].set(xlabel="sample k", ylabel="free-run error / nm", title="gradient correction")
        row[2].set_yscale("symlog", linthresh=100)
        for axis in row:
            axis.legend(fontsize=7, markerscale=5)
    _save(plt, figure, out / "paper.png")


def _loops(plt: Any, out: Path) -> None:
    """Loops and simulation errors on noisy data."""
    figure, axes = plt.subplots(2, 2, figsize=(9.5, 6.4), layout="constrained", height_ratios=(1.25, 1))
    for column, (wave, scheme) in enumerate((("sine", "explicit"), ("decaying sine", "midpoint"))):
        c = case(wave, 2001, 0.005, 0, scheme)
        models = {
            "RLS": identify(c.record, "rls", hf.Duhem(scheme=scheme)).model,
            "output error": output_error(c.record, scheme).model,
        }
        top, low = axes[:, column]
        top.plot(c.record.u, c.record.y, ".", ms=1.5, color="0.6", label="record, 5 nm noise")
        for name, model in models.items():
            run = np.asarray(simulate(model, c.record.u)[0])
            top.plot(c.record.u, run, color=INK[name], lw=1, label=f"{name}, free run")
            low.plot(c.record.t, 1e3 * (run - c.y), color=INK[name], lw=1.1, label=name)
        top.set(xlabel="input / V", ylabel="output / µm", title=f"{wave}, {scheme} regressors, N = 2001")
        low.set(xlabel="time / s", ylabel="free-run error / nm")
        top.legend(loc="upper left", markerscale=5)
        low.legend(loc="best")
    _save(plt, figure, out / "loops.png")


def _histories(plt: Any, out: Path) -> None:
    """Parameters after every sample (the paper's Fig. 4), scaled and relative to the truth."""
    figure, axes = plt.subplots(2, 4, figsize=(11, 5), layout="constrained", sharex=True, sharey=True)
    clean, noisy = case("decaying sine"), case("decaying sine", noise=0.005)
    m = clean.model
    off = hf.Duhem(1.05 * m.alpha, 0.95 * m.f, m.g, m.w0, m.center, m.half)
    runs = [
        ("RLS, 5 nm noise", Rls.of(m, noisy.record), noisy, INK["RLS"]),
        ("RLS, no noise", Rls.of(m, clean.record), clean, INK["output error"]),
        (
            "gradient correction, no noise",
            GradientCorrection.of(off, clean.record, start="model"),
            clean,
            INK["gradient correction"],
        ),
    ]
    turns = np.flatnonzero(np.diff(np.sign(np.diff(clean.record.u)))) + 1
    for label, identifier, c, ink in runs:
        relative = identifier.fit(c.record).theta_history / identifier.regressor.theta(m)
        for k, axis in enumerate(axes.flat):
            inside = np.where(np.abs(relative[:, k] - 1) < 1.7, relative[:, k], np.nan)  # no lines across the figure
            axis.plot(inside, color=ink, lw=1.1, label=label)
    names = ("αf0", "αf1", "αf2", "αf3", "α", "g0", "g1", "g2")
    for k, axis in enumerate(axes.flat):
        for turn in turns:
            axis.axvline(turn, color="0.85", lw=0.8, zorder=0)
        axis.axhline(1.0, color=INK["truth"], lw=0.8, ls=":")
        axis.set(ylim=(-0.5, 2.5), xlim=(0, 1000), title=f"{names[k]} (Legendre) / truth")
        axis.grid(False)
        if k >= 4:
            axis.set_xlabel("sample k")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
    figure.suptitle("decaying sine, N = 2001; gray lines: the input turns")
    _save(plt, figure, out / "histories.png")


def _rates(plt: Any, out: Path, outcomes: dict) -> None:
    """alpha over its true value, and simulation errors, of every estimator and seed."""
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.6), layout="constrained", sharey=True)
    names = list(reversed([*next(iter(outcomes.values()))]))
    marks = {"explicit": "o", "midpoint": "^"}
    for (scheme, wave), by_name in outcomes.items():
        shift = 0.27 - 0.18 * list(outcomes).index((scheme, wave))
        ink = "#1f6fb4" if wave == "sine" else "#e08e0b"
        fill = ink if scheme == "midpoint" else "none"
        for row, name in enumerate(names):
            alpha, _, error = by_name[name].T
            good = np.isfinite(error)
            style = {"marker": marks[scheme], "ls": "", "ms": 4, "mec": ink, "mfc": fill, "alpha": 0.7}
            label = f"{scheme} regressors, {wave}" if row == 0 else None
            axes[0].plot(alpha[good], np.full(good.sum(), row + shift), **style, label=label)
            axes[1].plot(1e3 * error[good], np.full(good.sum(), row + shift), **style)
    axes[0].axvline(1.0, color=INK["truth"], lw=0.8, ls=":")
    axes[0].set(xscale="log", xlabel="α / truth", yticks=range(len(names)), yticklabels=names)
    axes[1].set(xscale="log", xlabel="free-run maximum / nm")
    figure.legend(loc="outside lower center", ncols=4)
    figure.suptitle("5 nm noise, N = 2001: one mark a seed")
    _save(plt, figure, out / "rates.png")


def _measured(plt: Any, out: Path, loops: dict) -> None:
    """Simulation errors over measured records."""
    records = list(dict.fromkeys(name for name, _ in loops))
    shape = {"figsize": (11, 3.4 * len(records)), "layout": "constrained", "width_ratios": (1, 1.8)}
    figure, axes = plt.subplots(len(records), 2, **shape)
    for (left, right), name in zip(axes, records, strict=True):
        best = loops[name, "output error"]
        record, unit = best.record, best.record.y_unit or "[y]"
        left.plot(record.u, record.y, color="0.6", lw=0.8, label="measured")
        for method in ("RLS", "gradient correction", "output error"):
            e = loops[name, method]
            if e.simulated is None:
                left.plot([], [], color=INK[method], label=f"{method}: no valid model")
                continue
            left.plot(record.u, e.simulated, color=INK[method], lw=0.7, label=method)
            right.plot(e.simulated - record.y, color=INK[method], lw=0.6, alpha=0.8, label=method)
        at = np.flatnonzero(best.fitted)
        right.axvspan(at[0], at[-1], color="0.93", zorder=0, label="fitted")
        left.set(xlabel=f"input / {record.u_unit}" if record.u_unit else "input", ylabel=f"output / {unit}", title=name)
        left.set_ylim(record.y.min() - 0.1 * np.ptp(record.y), record.y.max() + 0.45 * np.ptp(record.y))
        left.locator_params(axis="x", nbins=5)
        limit = 8 * np.std((best.simulated - record.y)[best.fitted])
        right.set(xlabel="sample", ylabel=f"free-run error / {unit}", ylim=(-limit, limit))
        left.legend(loc="upper left", fontsize=8, frameon=True, framealpha=0.9)
        right.legend(loc="upper right", ncols=4, fontsize=8, frameon=True, framealpha=0.9)
    _save(plt, figure, out / "measured.png")


def write(
    folder: Path, parts: dict[str, str | None], timing: dict[str, float], outcomes: dict, results: Results
) -> None:
    """Write RESULTS.md from page.md, and copy the figures that it shows.

    Args:
        folder: where to write.
        parts: Markdown by name; None where the measured records are missing.
        timing: seconds by name.
        outcomes: arrays of `Outcome` by (scheme, wave) and estimator.
        results: numbers of the experiment.
    """
    explicit = outcomes["explicit", "sine"]
    seconds = lambda name, value: f"{1e6 * value:.1f} µs" if "update" in name else f"{1e3 * value:.0f} ms"
    cost = "\n".join(f"* {name}: {seconds(name, value)}" for name, value in timing.items())
    text = (HERE / "page.md").read_text(encoding="utf-8")
    values = {
        "quick": " --quick" if results.quick else "",
        "seeds": str(len(explicit["RLS"])),
        "equation_rls": f"{1e3 * np.mean(explicit['RLS'][:, 1]):.2f}",
        "equation_oe": f"{1e3 * np.mean(explicit['output error'][:, 1]):.2f}",
        "wrong": f"{np.mean(explicit['RLS'][:, 0]):.0f}",
        "cost": cost,
        **{
            name.replace(" ", "_"): part or "The measured records were not available for this run.\n"
            for name, part in parts.items()
        },
    }
    (folder / "RESULTS.md").write_text(results.fill(text, values), encoding="utf-8")
    for name in SHOWN:
        if (results.out / name).is_file() and results.out.resolve() != folder.resolve():
            shutil.copy(results.out / name, folder / name)
