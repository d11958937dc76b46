"""Figures of the experiment, as PNG."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from identification import TRUE
from plants import Tracking, bare

from hystfit import simulate
from hystfit.stage import piezo


def all_of_them(
    out: Path, kept: Any, example: Tracking, runs: dict[str, Tracking], poses: dict[str, np.ndarray]
) -> None:
    """Write loops.png, filter.png, tracking.png and stage.png.

    Args:
        out: folder.
        kept: record and identification of the filter.
        example: tracking of a sine.
        runs: tracking of the staircase by name.
        poses: reference and poses of the stage by name, shape (T, 3).
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
            ("loops", _loops, ()),
            ("filter", _filter, kept),
            ("tracking", _tracking, (example, runs)),
            ("stage", _stage, (poses,)),
        ):
            figure = draw(plt, *content)
            figure.savefig(out / f"{name}.png")
            plt.close(figure)


def _loops(plt: Any) -> Any:
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
    k = np.arange(2001) / 1000
    for high in (20, 40, 60, 80, 100):
        u = 0.5 * high * (1 - np.cos(2 * np.pi * k))
        left.plot(u, simulate(bare(), jnp.asarray(u))[0], lw=1.1, label=f"{high} V")
    left.set(xlabel="voltage / V", ylabel="displacement / µm", title="amplitude family (M2)")
    left.legend()
    t = np.concatenate([[0.0], np.geomspace(0.01, 1000, 300)])
    y = simulate(piezo(), jnp.asarray(np.where(t > 0, 100.0, 0.0)), jnp.diff(jnp.asarray(t), prepend=0.0))[0]
    right.semilogx(t[1:], y[1:], lw=1.3)
    right.set(xlabel="time after a 100 V step / s", ylabel="displacement / µm", title="creep (M3)")
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
    a.plot(example.t, example.y, lw=1, label="displacement, model perturbed")
    a.set(ylabel="µm", title="20 µm at 10 Hz (M5)", ylim=(-1, 25))
    a.legend(loc="upper center", ncols=2)
    c.plot(example.t, 100 * (example.reference - example.y) / np.ptp(example.reference), lw=1)
    c.set(xlabel="time / s", ylabel="error, % of range")
    for name in ("uncontrolled, best linear gain", "controlled, perturbed"):
        run = runs[name]
        b.plot(run.t, run.y, lw=1, label=name)
        d.plot(run.t, 100 * (run.reference - run.y) / np.ptp(run.reference), lw=1, label=name)
    b.plot(run.t, run.reference, "--", lw=0.8, color="0.3", label="reference")
    b.set(ylabel="µm", title="staircase (M7, M8)")
    b.legend()
    d.set(xlabel="time / s", ylabel="error, % of ladder")
    return figure


def _stage(plt: Any, poses: dict[str, np.ndarray]) -> Any:
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 4.2), layout="constrained")
    reference = poses["reference"]
    for name, style in (("reference", "-"), ("designed", "--"), ("calibrated", ":")):
        left.plot(poses[name][:2000, 0], poses[name][:2000, 1], style, lw=1.2, label=name)
    left.set(xlabel="x / µm", ylabel="y / µm", title="circle that turns (M9)", aspect="equal")
    left.legend()
    error = poses["calibrated"] - reference
    for k, (name, unit) in enumerate((("x", 1.0), ("y", 1.0), ("θ · 40 mm", 40.0))):
        right.plot(np.arange(4000) / 10, 1e3 * unit * error[:4000, k], lw=1, label=name)
    right.set(xlabel="time / ms", ylabel="error / nm", title="calibrated Jacobian", ylim=(-6.5, 8.5))
    right.legend(ncols=3, loc="upper center")
    return figure
