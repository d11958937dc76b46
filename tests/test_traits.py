"""What `check` names in simulated loops: terms that lower the error on held-out samples, and none in loops that have no such term."""

from __future__ import annotations

import dataclasses
import itertools
import json
import math
from pathlib import Path

import numpy as np

import hystfit as hf
from hystfit.data.dataset import Dataset
from hystfit.fitting.comparison.compared_models import Row
from hystfit.fitting.comparison.traits import traits
from hystfit.quality.baselines import Baselines
from hystfit.quality.check import Trait, examine


def named(*records: hf.Record) -> set[str]:
    """Traits beside a search that took plain stops at 5 % of the range."""
    data = Dataset.of(records)
    searched = Row("prandtl-ishlinskii-stop:plays=10", "prandtl-ishlinskii-stop:plays=10", score_percent=5.0)
    return {trait.name for trait in traits(data, [searched], Baselines.of(data))}


def growing(samples: int = 1200) -> tuple[np.ndarray, np.ndarray]:
    """Twelve cycles of one duration, of which two follow each other at each of six amplitudes."""
    t = np.arange(samples) / 100
    return t, (np.floor(t / 2) + 1) / 6 * np.sin(2 * np.pi * t)


def noisy(y: np.ndarray) -> np.ndarray:
    return y + 0.005 * np.ptp(y) * np.random.default_rng(0).normal(size=y.size)


def scaling(u: np.ndarray) -> np.ndarray:
    """Stops of u over its largest value so far, in a plain loop."""
    peak, plays, y = 0.0, np.zeros(3), []
    for now in u:
        peak = max(peak, abs(now), 1e-3)
        plays = np.clip(plays, now / peak - [0.1, 0.3, 0.6], now / peak + [0.1, 0.3, 0.6])
        y.append(peak**0.5 * np.sum(now / peak - plays))
    return np.array(y)


def test_a_loop_that_scales_with_its_peak_is_degrading_and_peak_oriented() -> None:
    t, u = growing()
    assert named(hf.Record(u=u, y=noisy(scaling(u)), t=t)) == {"degrading", "peak-oriented"}


def slipping(u: np.ndarray, slip: float) -> np.ndarray:
    """A joint: stiff springs within limits, of which the upper one is friction over a part `slip` of the last peak, then a line to it."""
    force, peak, forces = 0.0, 1e-3, []
    backbone = lambda at: at**0.5

    def upper(now: float, peak: float) -> float:
        closed = slip * peak
        rise = max(0.0, (now - closed) / (peak - closed))
        return float(backbone(now) if now >= peak else 0.15 * backbone(peak) + 0.85 * backbone(peak) * rise)

    for before, now in itertools.pairwise([0.0, *u]):
        force = float(np.clip(force + 20 * (now - before), -upper(-now, peak), upper(now, peak)))
        peak = max(peak, abs(now))
        forces.append(force)
    return np.array(forces)


def test_a_joint_that_slips_to_its_last_peak_is_pinched() -> None:
    """Without a gap the same joint aims at the peak along straight lines."""
    t, u = growing()
    assert named(hf.Record(u=u, y=noisy(slipping(u, 0.6)), t=t)) == {"degrading", "peak-oriented", "pinched"}
    assert "pinched" not in named(hf.Record(u=u, y=noisy(slipping(u, -1.0)), t=t))


def test_a_spring_that_hardens_beside_loops_that_scale_is_not_pinched() -> None:
    t, u = growing()
    found = named(hf.Record(u=u, y=noisy(scaling(u) + 2 * u**3), t=t))
    assert "degrading" in found
    assert "pinched" not in found


def test_a_measured_wall_and_a_fastener_are_pinched_and_a_steel_damper_is_not(measured: Path) -> None:
    assert "pinched" in named(hf.read(measured / "struct_slotboom/trial2.csv"))
    test = json.loads((measured / "wild/fastener_c33g12_1.json").read_text(encoding="utf-8"))["test"]
    u, y = np.array(test["displacement"]), np.array(test["force"])
    last = int(np.flatnonzero(np.abs(y) >= 0.8 * np.abs(y).max())[-1]) + 1
    assert "pinched" in named(hf.Record(u=u[:last], y=y[:last]))
    assert "pinched" not in named(hf.read(measured / "struct_slotboom/xyTestData.csv"))


def test_plain_stops_have_no_trait() -> None:
    """In cycles of one duration speed and amplitude are one, so that nothing depends on the rate for certain."""
    t, u = growing()
    limits, e, y = np.array([0.05, 0.2, 0.5]), np.zeros(3), []
    for step in np.diff(u, prepend=0.0):
        e = np.clip(e + step, -limits, limits)
        y.append(e.sum())
    assert named(hf.Record(u=u, y=noisy(np.array(y)), t=t)) == set()


def test_a_power_law_of_time_at_three_rates_is_viscoelastic() -> None:
    records = []
    for frequency in (0.01, 1.0, 100.0):
        t = np.arange(161) / 80 / frequency
        u = np.sin(2 * np.pi * frequency * t)
        of = lambda x: np.maximum(x, 0.0) ** 0.8 / math.gamma(1.8)
        relaxed = [np.sum(np.diff(u) / np.diff(t) * (of(now - t[:-1]) - of(now - t[1:]))) for now in t]
        records.append(hf.Record(u=u, y=noisy(0.5 * u + np.array(relaxed)), t=t, name=f"{frequency:g} Hz"))
    assert named(*records) == {"viscoelastic"}


def test_plays_that_widen_with_the_rate_are_rate_dependent() -> None:
    records = []
    for frequency in (1.0, 20.0, 100.0):
        t = np.arange(300) / 100 / frequency
        u = np.sin(2 * np.pi * frequency * t) * np.where(t * frequency < 2, 1.0, 0.5)
        plays, y = np.zeros(3), []
        rate = np.append(0.0, np.abs(np.diff(u) / np.diff(t)))
        for now, speed in zip(u, np.append(0.0, rate[:-1]), strict=True):
            width = np.array([0.05, 0.2, 0.4]) + 4e-4 * speed
            plays = np.clip(plays, now - width, now + width)
            y.append(now + plays.sum())
        records.append(hf.Record(u=u, y=noisy(np.array(y)), t=t, name=f"{frequency:g} Hz"))
    assert named(*records) == {"rate-dependent"}


def test_the_report_says_what_the_loops_show() -> None:
    t, u = growing(200)
    trait = Trait("viscoelastic", "linear+viscoelastic", 1.2, "prandtl-ishlinskii", 4.5)
    report = dataclasses.replace(examine(hf.Record(u=u, y=u, t=t)), traits=(trait,))
    assert "viscoelastic: linear+viscoelastic has an error of 1.2 %" in report.text()
    assert report.to_dict()["traits"][0]["other_percent"] == 4.5
