"""Figures of the experiment, as PNG."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from identification import AMPLITUDES, TRUE, loop
from plants import Tracking, bare

from hystfit import simulate
from hystfit.control import LoopResult
from hystfit.stage import piezo


def all_of_them(
    out: Path,
    circles: dict[float, Any],
    kept: Any,
    example: Tracking,
    runs: dict[str, Tracking],
    stage: dict[str, LoopResult],
) -> None:
    """Write loops.png, filter.png, tracking.png and stage.png.

    Args:
        out: folder.
        circles: voltage and displacement of a loop, by frequency.
        kept: record and identification of the filter.
        example: tracking of a sine.
        runs: tracking of the staircase by name.
        stage: runs of the three-axis stage by name.
    """
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
        for name, draw, content in (
            ("loops", _loops, (circles,)),
            ("filter", _filter, kept),
            ("tracking", _tracking, (example, runs)),
            ("stage", _stage, (stage,)),
        ):
            figure = draw(plt, *content)
            figure.savefig(out / f"{name}.png")
            plt.close(figure)


def _loops(plt: Any, circles: dict[float, Any]) -> Any:
    figure, ((major, family), (speeds, creep)) = plt.subplots(2, 2, figsize=(9.5, 7.4), layout="constrained")
    u, y = loop(bare())
    major.plot(u, y, lw=1.3)
    low, high = (
        np.interp(40.0, *(v[side][np.argsort(u[side])] for v in (u, y)))
        for side in (np.gradient(u) > 0, np.gradient(u) < 0)
    )
    major.annotate("", (40, high), (40, low), arrowprops={"arrowstyle": "<->", "lw": 0.8, "shrinkA": 0, "shrinkB": 0})
    major.annotate(f"{high - low:.2f} µm at 40 V", (40, low), (44, low - 0.7), fontsize=8)
    major.set(xlabel="voltage / V", ylabel="displacement / µm", title="major loop (M1, the paper's Fig. 1)")
    k = np.arange(2001) / 1000
    for high in AMPLITUDES:
        u = 0.5 * high * (1 - np.cos(2 * np.pi * k))
        family.plot(u, simulate(bare(), jnp.asarray(u))[0], lw=1.1, label=f"{high:g} V")
    family.set(xlabel="voltage / V", ylabel="displacement / µm", title="amplitudes (M2, Fig. 2)")
    family.legend()
    for frequency, (u, y) in circles.items():
        shift = np.mean(y) - 0.1042 * np.mean(u)
        speeds.plot(u, y - 0.1042 * u - shift, lw=1.1, label=f"{frequency:g} Hz")
    speeds.set(
        xlabel="voltage / V",
        ylabel="displacement less 0.104 µm/V / µm",
        title="frequencies, 630 Hz mode rung down (M2, Fig. 3)",
    )
    speeds.legend()
    t = np.concatenate([[0.0], np.geomspace(0.01, 1000, 300)])
    y = simulate(piezo(), jnp.asarray(np.where(t > 0, 100.0, 0.0)), jnp.diff(jnp.asarray(t), prepend=0.0))[0]
    creep.semilogx(t[1:], y[1:], lw=1.3)
    creep.set(xlabel="time after a 100 V step / s", ylabel="displacement / µm", title="creep (M3, Fig. 4)")
    return figure


def _filter(plt: Any, record: Any, identified: Any) -> Any:
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
    x = identified.history[:, :4].copy()
    x[:, 3] *= x[:, 2]
    for column, name in enumerate(("c", "μ", "τ", "δ")):
        left.plot(record.t, x[:, column] / TRUE[column], lw=1.2, label=name)
    left.axhline(1, color="0.4", lw=0.8)
    left.set(xlabel="time / s", ylabel="estimate / truth", title="parameters, started far off (M4)", ylim=(0.4, 1.8))
    left.legend()
    run = np.asarray(simulate(identified.model, jnp.asarray(record.u))[0])
    right.plot(record.t, 1e3 * (record.y - run), ".", ms=1, color="0.65", label="record less free run")
    right.plot(
        record.t,
        1e3 * (np.asarray(simulate(bare(), jnp.asarray(record.u))[0]) - run),
        lw=1.2,
        label="truth less free run",
    )
    right.set(xlabel="time / s", ylabel="error / nm", title="free run of the final parameters")
    right.legend(markerscale=6)
    return figure


def _tracking(plt: Any, example: Tracking, runs: dict[str, Tracking]) -> Any:
    figure, ((a, b), (c, d)) = plt.subplots(2, 2, figsize=(9.5, 6.2), layout="constrained", sharex="col")
    a.plot(example.t, example.reference, lw=1.6, color="0.6", label="reference")
    a.plot(example.t, example.y, lw=1, label="displacement, identified model")
    a.set(ylabel="µm", title="20 µm at 10 Hz (M5)", ylim=(-1, 25))
    a.legend(loc="upper center", ncols=2)
    c.plot(example.t, 100 * (example.reference - example.y) / np.ptp(example.reference), lw=1)
    c.set(xlabel="time / s", ylabel="error, % of range")
    for name in ("uncontrolled, best linear gain", "controlled, identified"):
        run = runs[name]
        b.plot(run.t, run.y, lw=1, label=name)
        d.plot(run.t, 100 * (run.reference - run.y) / np.ptp(run.reference), lw=1, label=name)
    b.plot(run.t, run.reference, "--", lw=0.8, color="0.3", label="reference")
    b.set(ylabel="µm", title="staircase (M7, M8)")
    b.legend()
    d.set(xlabel="time / s", ylabel="error, % of ladder")
    return figure


def _stage(plt: Any, stage: dict[str, LoopResult]) -> Any:
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 4.2), layout="constrained")
    late = slice(-4000, None)
    left.plot(*next(iter(stage.values())).reference[late, :2].T, lw=1.8, color="0.7", label="reference")
    for name, style in (("designed Jacobian", "--"), ("identified", ":")):
        left.plot(*stage[name].y[late, :2].T, style, lw=1.2, label=name)
    left.set(xlabel="x / µm", ylabel="y / µm", title="circle that turns (M9)", aspect="equal")
    left.legend()
    for name in (
        "identified",
        "identified, with feedback",
        "perturbed actuators",
        "perturbed actuators, with feedback",
    ):
        error = stage[name].error[late] * [1.0, 1.0, 40.0]
        right.semilogy(np.arange(len(error)) / 10, 1e3 * np.linalg.norm(error, axis=1), lw=1, label=name)
    right.set(
        xlabel="time / ms",
        ylabel="|error| in x, y, θ · 40 mm / nm",
        title="open and closed loop (M9)",
        ylim=(1, 30_000),
    )
    right.legend(loc="upper right")
    return figure
