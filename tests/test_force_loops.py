"""Cycles, backbone and failure of force loops beside closed forms, and on measured walls and joints."""

from __future__ import annotations

import csv
import itertools
import json
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

import hystfit as hf
from hystfit.cli import run


def cycles(*amplitudes: float, samples: int = 400) -> np.ndarray:
    return np.concatenate([a * np.sin(2 * np.pi * np.arange(samples) / samples) for a in (*amplitudes, 0.0)])


def record(u: np.ndarray, f: np.ndarray, **fields: object) -> hf.Record:
    return hf.Record(u=u, y=f, u_unit="mm", y_unit="kN", name="wall", **fields)


def test_an_elastic_plastic_loop_has_the_values_of_its_parallelogram() -> None:
    """Yield force 3 at 1: energy 4 Fy (u - uy), secant Fy / u, damping 2 / pi (1 - uy / u)."""
    u, f, force = cycles(2.0, 2.0, 4.0, 4.0), [], 0.0
    for du in np.diff(u, prepend=0.0):
        force = min(max(force + 3.0 * du, -3.0), 3.0)
        f.append(force)
    found = hf.force_loops(record(u, np.array(f)))["wall"]
    assert len(found.cycles) == 4
    for one, size in zip(found.cycles[1::2], (2.0, 4.0), strict=True):  # the second of each amplitude is closed
        assert one.energy == pytest.approx(4 * 3.0 * (size - 1.0), rel=1e-3)
        assert one.stiffness == pytest.approx(3.0 / size, rel=1e-3)
        assert one.damping == pytest.approx(2 / np.pi * (1 - 1 / size), rel=2e-3)
    assert found.cycles[3].stiffness_lost == pytest.approx(0.5, abs=0.01)
    for side, sign in ((True, 1.0), (False, -1.0)):
        assert [p.displacement for p in found.backbone[side]] != []
        assert [p.force for p in found.backbone[side]] == pytest.approx([3.0 * sign] * 2)
        assert [p.later for p in found.backbone[side]] == pytest.approx([3.0 * sign] * 2)
    assert found.failure == {True: None, False: None}


def test_a_viscous_damper_has_its_damping_ratio_and_noise_gives_the_errors() -> None:
    """k u + c du/dt: energy pi c omega a^2, ratio c omega / (2 k). The scatter of repeats is that of the standard errors."""
    turn, count, k, ratio, noise = 2 * np.pi / 200, 60, 5.0, 0.1, 0.2
    t = np.arange(200 * count + 60)
    u = 2.0 * np.sin(turn * t)
    f = k * u + 2 * ratio * k * 2.0 * np.cos(turn * t) + np.random.default_rng(0).normal(0, noise, t.size)
    found = hf.force_loops(record(u, f))["wall"]
    energy = np.array([one.energy for one in found.cycles])
    assert np.mean(energy) == pytest.approx(np.pi * 2 * ratio * k * 4.0, rel=0.01)
    assert np.mean([one.damping for one in found.cycles]) == pytest.approx(ratio, rel=0.01)
    assert np.std(energy) == pytest.approx(np.mean([one.energy_error for one in found.cycles]), rel=0.35)
    stiffness = np.array([one.stiffness for one in found.cycles])
    assert np.std(stiffness) == pytest.approx(np.mean([one.stiffness_error for one in found.cycles]), rel=0.35)


def test_failure_lies_where_the_backbone_has_fallen_to_80_percent() -> None:
    """A triangular backbone: 10 at 2, 0 at 12. It is drawn through its points, and reaches 8 at 4."""
    u = cycles(1.0, 2.0, 3.0, 5.0, 7.0)
    f = np.sign(u) * np.interp(np.abs(u), [0.0, 2.0, 12.0], [0.0, 10.0, 0.0])
    peaks = np.maximum.accumulate(np.abs(u))
    f = f * np.where(np.abs(u) < 0.98 * peaks, 0.1, 1.0)  # only the peaks reach the backbone
    found = hf.force_loops(record(u, f))["wall"]
    assert found.failure[True] == pytest.approx(4.0, abs=0.1)
    assert found.failure[False] == pytest.approx(-4.0, abs=0.1)
    lost = [one.stiffness_lost for one in found.cycles]
    assert all(b >= a for a, b in itertools.pairwise(lost))


def test_a_force_that_drives_is_the_force_all_the_same() -> None:
    u = cycles(2.0, 2.0)
    f = 3.0 * u + 0.5 * np.sign(np.gradient(u))
    driven = hf.Record(u=f, y=u, u_unit="kN", y_unit="mm", name="wall")
    one, other = hf.force_loops(record(u, f))["wall"], hf.force_loops(driven)["wall"]
    assert other.units == one.units == ("mm", "kN")
    assert [c.energy for c in other.cycles] == [c.energy for c in one.cycles]


def test_records_without_a_cycle_or_of_other_fields_are_left_out() -> None:
    u = np.linspace(0, 3, 200)
    assert hf.force_loops(record(u, u)) == {}
    assert hf.force_loops(record(np.ones(20), np.ones(20))) == {}
    loop = cycles(1.0, 1.0)
    assert hf.force_loops(hf.Record(u=loop, y=loop, u_unit="V", y_unit="um")) == {}


def test_the_verb_prints_and_writes_cycles_and_backbone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    u = cycles(1.0, 2.0, 2.0)
    f = 3.0 * u + 0.5 * np.sign(np.gradient(u))
    lines = ["displacement [mm],force [kN]", *(f"{a},{b}" for a, b in zip(u, f, strict=True))]
    (tmp_path / "wall.csv").write_text("\n".join(lines))
    assert run(["quantities", str(tmp_path / "wall.csv"), "--out", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr().out
    assert "backbone" in shown
    (content,) = json.loads((tmp_path / "out" / "result.json").read_text())["force_loops"].values()
    rows = list(csv.DictReader((tmp_path / "out" / "cycles.csv").read_text().splitlines()))
    assert [float(row["energy"]) for row in rows] == [one["energy"] for one in content["cycles"]]
    points = list(csv.DictReader((tmp_path / "out" / "backbone.csv").read_text().splitlines()))
    assert len(points) == sum(len(side) for side in content["backbone"].values()) == 4
    picture = matplotlib.image.imread(tmp_path / "out" / "backbone.png")
    assert picture[..., :3].std() > 0.02


def test_a_measured_wall_loses_its_stiffness(measured: Path) -> None:
    found = next(iter(hf.force_loops(hf.datasets.load("struct_slotboom/trial2")).values()))
    lost = [one.stiffness_lost for one in found.cycles]
    assert lost[-1] > 0.7
    assert all(one.energy > 0 for one in found.cycles)
    assert [p.displacement for p in found.backbone[True]] == sorted(p.displacement for p in found.backbone[True])
