"""Data to which one model of hysteresis is no answer: curves without a loop, and records of several states."""

import dataclasses
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import hystfit as hf
from hystfit.cli import run
from hystfit.outcome import Code, Status
from hystfit.outcome.note import has, warn
from hystfit.quality.baselines import curve_scatter
from hystfit.quality.equal_inputs import none_describes, records_apart
from hystfit.results.report.answer import Wording, next_commands

from .conftest import examined

N = 200
RNG = np.random.default_rng(11)
WHITE = RNG.normal(size=N)
LOOP = np.concatenate([np.linspace(1, -1, N // 2), np.linspace(-1, 1, N // 2)])
CURVES = {  # steeper or longer than the polynomial of seventh degree describes
    "diode": (LOOP, np.exp(LOOP / 0.08)),
    "superparamagnet": (7 * LOOP, np.tanh(21 * LOOP) + 0.02 * LOOP),
    "isotherm with noise in its input": (jitter := np.abs(np.linspace(0, 90, N) + 1.5 * WHITE), jitter / (12 + jitter)),
}


def play(u: np.ndarray, radius: float) -> np.ndarray:
    p, out = u[0] - radius, []
    for x in u:
        p = np.clip(p, x - radius, x + radius)
        out.append(p)
    return np.array(out)


def made(u: np.ndarray, y: np.ndarray, noise: float = 2e-3, **labels) -> hf.Record:
    return hf.Record(u, y + noise * np.ptp(y) * np.resize(WHITE[::-1], y.size), **labels)


@pytest.mark.parametrize("kind", CURVES)
@pytest.mark.parametrize("model", ["preisach:n=20:spacing=steep", pytest.param("bouc-wen", marks=pytest.mark.slow)])
def test_a_curve_of_any_shape_is_no_loop(kind: str, model: str) -> None:
    record = made(*CURVES[kind])
    result = hf.fit(model, record, noise="iid")
    assert result.status is Status.NO_LOOP
    assert has(result.notes, Code.SINGLE_VALUED)


@pytest.mark.usefixtures("few_families")
@pytest.mark.parametrize("kind", ["diode", "superparamagnet"])
def test_a_check_advises_no_model_of_hysteresis_for_a_curve(kind: str) -> None:
    report = hf.check(made(*CURVES[kind]))
    assert has(report.findings, Code.SINGLE_VALUED)
    assert report.advice is None


def test_a_narrow_loop_is_one() -> None:
    """Of a width of ten times the noise; one of its size is seen by the mean distance of the branches."""
    narrow = lambda radius: made(LOOP, play(LOOP, radius) + 0.1 * LOOP**3, noise=1e-3)
    assert hf.fit("prandtl-ishlinskii:plays=6", narrow(0.02), noise="iid").status is Status.OK
    assert not has(examined(narrow(0.002)).findings, Code.SINGLE_VALUED)


def test_the_scatter_about_a_curve_is_the_noise() -> None:
    u, y = CURVES["diode"]
    assert curve_scatter([made(u, y)]) == pytest.approx(2e-3 * np.ptp(y), rel=0.15)
    held = np.repeat(
        [0.0, 1.0, 0.5], 60
    )  # creep at held inputs, of which each sample has the neighbors in time beside it
    assert curve_scatter([hf.Record(held, np.log1p(np.arange(180.0)))]) > 0.2


def states(width: float, seconds: float = 1.0, offset: float = 0.0) -> hf.Record:
    u = np.tile(LOOP, 2)
    return made(u, np.tanh(4 * play(u, 0.3 * width)) + offset, t=seconds * np.arange(u.size), name=f"T={width}")


@pytest.fixture(scope="module")
def two_states() -> hf.Dataset:
    return hf.Dataset((states(1.0), states(0.4)))


def test_records_of_two_states_are_asked_for_one_of_them(two_states: hf.Dataset) -> None:
    """The least error of one model: half of the mean distance, computed here from the loops themselves."""
    wide, narrow = (record.y[N:] - record.y[N:].mean() for record in two_states)
    least = float(np.sqrt(np.mean((wide - narrow) ** 2))) / 2
    found = records_apart(two_states)
    assert found is not None
    assert found.rms == pytest.approx(least, rel=0.1)
    report = hf.check(two_states)
    note = next(note for note in report.findings if note.code is Code.RECORDS_DIFFER)
    assert note.option == ("only", "1.0")
    assert report.advice is None
    result = hf.fit("preisach-magnetic:n=16", two_states, noise="iid")
    assert result.status is Status.POOR
    assert has(result.notes, Code.RECORDS_DIFFER)


@pytest.mark.parametrize(("width", "cells", "differ"), [(0.85, 16, True), (1.0, 6, False)])
def test_two_states_are_told_where_they_make_most_of_a_visible_error(width: float, cells: int, differ: bool) -> None:
    """Less than makes a fit poor, and ten times the noise; a coarse model errs as much on one state alone."""
    data = hf.Dataset((states(1.0), dataclasses.replace(states(width), name="second")))
    result = hf.fit(f"preisach-magnetic:n={cells}", data, noise="iid", starts=1)
    assert result.status in (Status.OK, Status.ROUGH)
    assert 1 < result.train.nrmse_percent < 3
    assert has(result.notes, Code.RECORDS_DIFFER) == differ


def test_the_command_for_one_record_is_quoted_for_a_shell() -> None:
    """Names of loops side by side have blanks: "0 deg"."""
    note = warn(Code.RECORDS_DIFFER, "")
    result = hf.fit("prandtl-ishlinskii", made(LOOP, play(LOOP, 0.2), name="0 deg"), noise="iid")
    result = dataclasses.replace(
        result, status=Status.POOR, notes=(dataclasses.replace(note, option=("only", "0 deg")),)
    )
    first = next_commands(result, Wording())[0]
    assert shlex.split(first)[-1] == "--only=0 deg"


def test_files_of_devices_that_differ_are_to_be_fitted_one_by_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Three specimens of other strengths: no other model helps, and a command that fits each of them follows."""
    files = [tmp_path / f"specimen_{k}.csv" for k in range(3)]
    for path, strength in zip(files, (1.0, 1.6, 2.2), strict=True):
        rows = "".join(f"{a:.6f},{b:.6f}\n" for a, b in zip(2 * LOOP, strength * play(2 * LOOP, 0.3), strict=True))
        path.write_text("Displacement (mm),Force (kN)\n" + 2 * rows)
    result = hf.fit("prandtl-ishlinskii:plays=6", hf.read(files), noise="iid")
    first = shlex.split(next_commands(result, Wording())[0])
    assert first[:2] == ["hystfit", "batch"]
    assert run(first[1:]) == 0


def test_the_least_error_is_that_of_the_samples() -> None:
    """A sine has most of its samples near the turning points, where the loops are close: the best one model errs less there."""
    u = np.sin(np.linspace(0, 4 * np.pi, 2 * N))
    loops = [made(u, np.tanh(4 * play(u, width)), noise=0.0, name=f"T={width}") for width in (0.3, 0.12)]
    one, two = (record.y[N:] - record.y[N:].mean() for record in loops)
    found = records_apart(loops)
    assert found is not None
    assert found.rms == pytest.approx(float(np.sqrt(np.mean((one - two) ** 2))) / 2, rel=0.05)


def test_records_of_two_states_end_the_choice_of_a_model(two_states: hf.Dataset) -> None:
    """No model changes the verdict; where most samples are of one state, a model may describe them, and all are tried."""
    ranking = hf.compare(two_states)
    assert ranking.winner.status is Status.POOR
    assert has(ranking.winner.notes, Code.RECORDS_DIFFER)
    assert len(ranking.fits) == 1
    wide, narrow = two_states
    many = made(np.tile(LOOP, 40), np.tanh(4 * play(np.tile(LOOP, 40), 0.3)), t=np.arange(40.0 * N), name="T=1")
    assert none_describes([wide, narrow])
    assert not none_describes([many, narrow])


@pytest.mark.parametrize("other", [{"offset": 0.5}, {"seconds": 30.0}, {"range": 0.5}], ids=lambda one: next(iter(one)))
def test_offsets_rates_and_other_ranges_are_no_other_states(other: dict[str, float]) -> None:
    """Models have an offset for each record, and may depend on the rate."""
    if "range" in other:
        u = 0.5 * np.tile(LOOP, 2)
        second = dataclasses.replace(states(1.0), u=u, y=np.tanh(4 * play(u, 0.3)), name="second")
    else:
        second = dataclasses.replace(states(0.4 if "seconds" in other else 1.0, **other), name="second")
    assert not has(examined(hf.Dataset((states(1.0), second))).findings, Code.RECORDS_DIFFER)


def test_noise_that_hides_records_alike_is_no_difference_between_them() -> None:
    """Loops of one device under noise of 15 % of the range, all of which a fit leaves."""
    u = np.tile(LOOP, 2)
    y = sum(play(u, radius) for radius in (0.1, 0.3, 0.6))
    noise = 0.15 * np.ptp(y) * np.random.default_rng(8).standard_normal((2, u.size))
    data = hf.Dataset(tuple(hf.Record(u, y + row, name=name) for row, name in zip(noise, "ab", strict=True)))
    result = hf.fit("prandtl-ishlinskii:plays=6", data, noise="iid")
    assert result.status is Status.OK
    assert has(result.notes, Code.MEASUREMENT_NOISE)


def test_loops_at_different_speeds_are_no_states_of_a_device() -> None:
    """One damper at three speeds: its force differs at equal displacements, as a law of the rate describes."""
    phase = np.linspace(0, 2 * np.pi, N)
    records = [
        made(np.sin(phase), speed * np.cos(phase), t=phase / speed, name=f"{speed} in/s") for speed in (1.0, 5.0, 10.0)
    ]
    assert records_apart(records) is None
    assert records_apart([records[0], records[0].replace(y=2 * records[0].y)]) is not None


@pytest.mark.parametrize(
    ("u", "y", "role"), [(10 ** (1.5 + 1.5 * LOOP), LOOP, "input"), (LOOP, 10 ** (3 + 2 * LOOP), "output")]
)
def test_a_quantity_over_decades_is_told(u: np.ndarray, y: np.ndarray, role: str) -> None:
    lagging = hf.Record(np.roll(u, -8), y)  # which has a loop
    for notes in (examined(hf.Record(u, y)).findings, hf.fit("preisach:n=8", lagging).notes):
        assert [role in note.text for note in notes if note.code is Code.DECADES] == [True]


def test_records_of_other_ranges_that_differ_by_a_factor_are_no_loops_of_one_device() -> None:
    """Soil at three depths: no two loops have one range, and each record is described alone; one device at three ranges is described."""
    ranges, plain = (1.0, 1.4, 2.0), np.tile(LOOP, 2)
    loop = lambda u: sum(play(u, r) for r in (0.2, 0.5, 0.8)) + 0.2 * u
    several = lambda factors: hf.Dataset(
        tuple(made(a * plain, c * loop(a * plain), name=f"{a:g}") for a, c in zip(ranges, factors, strict=True))
    )
    model = "prandtl-ishlinskii:plays=10"
    differ = hf.fit(model, several((1.0, 1.6, 1.1)), noise="iid")
    assert 3.0 < differ.train.nrmse_percent < 10.0
    assert has(differ.notes, Code.RECORDS_DIFFER)
    assert hf.fit(model, differ.data[0], noise="iid").status is Status.OK
    assert not has(hf.fit(model, several((1.0, 1.0, 1.0)), noise="iid").notes, Code.RECORDS_DIFFER)


def test_one_of_several_specimens_is_the_next_fit_where_no_model_describes_most_of_them(tmp_path: Path) -> None:
    """Two specimens are a thousand times weaker than a third: that one decides the fit of all, whatever the loss."""
    rows = [
        f"{name},{x:.6g},{size * y:.6g}"
        for name, size, width in (("weak", 1e-3, 0.6), ("tiny", 2e-3, 0.1), ("large", 1.0, 0.3))
        for x, y in zip(LOOP, play(LOOP, width) + LOOP, strict=True)
    ]
    path = tmp_path / "specimens.csv"
    path.write_text("specimen,H (A/m),M (A/m)\n" + "\n".join(rows) + "\n")
    result = hf.fit("prandtl-ishlinskii:plays=10", hf.read(path))
    assert not result.usable
    assert any("--only=weak" in command for command in next_commands(result, Wording()))


def at_three_currents(
    path: Path, force: Callable[[int, np.ndarray], np.ndarray], current: Callable[[int, np.ndarray], np.ndarray]
) -> Path:
    """A file of two cycles of a damper at each of three currents, one after the other: force and current by level and phase."""
    phase = 2 * np.pi * np.arange(200) / 100
    columns = [[np.sin(phase), force(k, phase), current(k, phase)] for k in range(3)]
    table = np.column_stack([0.01 * np.arange(600), np.hstack(columns).T])
    np.savetxt(path, table, "%.5f", ",", header="Time (s),Displacement (mm),Force (N),Current (A)", comments="")
    return path


def test_one_level_of_a_further_input_is_the_next_fit_and_check(tmp_path: Path) -> None:
    """No model of the displacement alone describes a damper at three currents."""
    set_to = lambda k, p: np.full(p.size, 0.5 * k)
    path = at_three_currents(tmp_path / "damper.csv", lambda k, p: (1 + k) * np.tanh(5 * np.cos(p)), set_to)
    data = hf.read(path)
    (found,) = (note for note in examined(data).findings if note.code is Code.CONDITIONS)
    assert found.option == ("where", "Current (A)=1")
    result = hf.fit("prandtl-ishlinskii-stop:plays=10", data)
    assert not result.usable
    assert has(result.notes, Code.CONDITIONS)
    assert next_commands(result, Wording())[0] == f"hystfit fit {path} '--where=Current (A)=1'"
    one = hf.read(path, where="Current (A)=1")
    assert len(one) == 200
    assert not has(examined(one).findings, Code.CONDITIONS)


@pytest.mark.parametrize("noise", [0.0, 0.004])
def test_the_command_after_a_check_of_a_further_input_runs(
    noise: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Levels that were set are chosen by their value, and those of a measured current become records."""
    rng = np.random.default_rng(0)
    measured = lambda k, p: 0.5 * k + noise * rng.normal(size=p.size)
    path = at_three_currents(tmp_path / "damper.csv", lambda k, p: (1 + 0.4 * k) * np.sin(p + 1.2), measured)
    assert run(["check", str(path), "--data-only"]) == 0
    command = shlex.split(capsys.readouterr().out.strip().splitlines()[-1])
    assert command[0] == "hystfit"
    assert command[1:3] == ["check", str(path)]
    assert command[3].startswith("--by=" if noise else "--where=")
    assert run([*command[1:], "--data-only"]) == 0
