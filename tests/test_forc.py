"""FORC diagrams in numbers and at the shell: against a Preisach model of known density, and a measured family."""

import dataclasses
import json
import os
from pathlib import Path

import numpy as np
import pytest

import hystfit as hf
from hystfit.cli import run
from hystfit.errors import DataError, ParameterError
from hystfit.models.preisach.forc_diagram import ForcDiagram, forc_diagram
from hystfit.models.preisach.forc_numbers import forc_numbers
from hystfit.outcome import Status
from hystfit.quality.reversal_curves import corrected_curves, reversal_curves
from hystfit.results.measured.forc_loop import forc_loop
from hystfit.sampling.derived import sampled_density
from hystfit.sampling.diagnostics import Convergence
from hystfit.sampling.posterior import Posterior

COERCIVITY, SPREAD = 0.35, 0.1


@pytest.fixture(scope="module")
def truth() -> hf.Preisach:
    """A Gaussian density about coercivity 0.35 and interaction 0.05."""
    levels = np.linspace(-1, 1, 41)
    middle = 0.5 * (levels[1:] + levels[:-1])
    i, j = np.tril_indices(middle.size)
    h, m = 0.5 * (middle[i] - middle[j]), 0.5 * (middle[i] + middle[j])
    density = np.exp(-0.5 * ((h - COERCIVITY) / SPREAD) ** 2 - 0.5 * ((m - 0.05) / SPREAD) ** 2)
    return hf.Preisach(w=density, levels=levels, initial="positive", spacing="given")


@pytest.fixture(scope="module")
def curves(truth: hf.Preisach) -> hf.Dataset:
    """Its curves from 40 reversal fields."""
    records = []
    for number, reversal in enumerate(np.linspace(0.95, -0.99, 40)):
        u = np.concatenate([np.linspace(1.0, reversal, 50)[:-1], np.linspace(reversal, 1.0, 60)])
        y = np.asarray(hf.simulate(truth, u)[0])
        records.append(hf.Record(u=u[49:], y=y[49:], u_unit="kOe", y_unit="emu", name=f"curve={number}"))
    return hf.Dataset(tuple(records))


def noisy(curves: hf.Dataset, sigma: float, seed: int) -> hf.Dataset:
    rng = np.random.default_rng(seed)
    return hf.Dataset(tuple(dataclasses.replace(r, y=r.y + sigma * rng.standard_normal(len(r))) for r in curves))


def grains(spread: float, count: int = 60, *, falling: bool = False) -> hf.Dataset:
    """Curves of 40 000 square loops of coercivity 0.35 +- 0.1 and interactions of a given spread, of outputs from -1 to 1."""
    rng = np.random.default_rng(3)
    coercive = np.abs(COERCIVITY + 0.1 * rng.standard_normal(40_000))
    interaction = spread * rng.standard_normal(coercive.size)
    records = []
    for number, reversal in enumerate(np.linspace(0.98, -0.98, count)):
        field = np.linspace(reversal, 1, max(4, round(2 * count * (1 - reversal) / 2)))
        switched = np.sort((interaction + coercive)[interaction - coercive > reversal])
        y = 1 - 2 * (switched.size - np.searchsorted(switched, field)) / coercive.size
        sign = -1 if falling else 1
        records.append(
            hf.Record(u=sign * field, y=sign * y, u_unit="T", y_unit="A m2", u_name="H", y_name="M", name=f"{number}")
        )
    return hf.Dataset(tuple(records))


def test_numbers_are_those_of_the_density(curves, truth):
    numbers = forc_numbers(forc_diagram(curves, smoothing=2))
    found = {name: value for name, value in numbers.values.items() if value is not None}
    assert (found["peak_coercivity"], found["peak_interaction"]) == pytest.approx((COERCIVITY, 0.05), abs=0.03)
    assert found["median_coercivity"] == pytest.approx(COERCIVITY, abs=0.02)
    widened = 2.355 * np.hypot(SPREAD, 0.04)  # by the smoothing
    assert found["coercivity_width"] == pytest.approx(widened, rel=0.2)
    assert found["interaction_width"] == pytest.approx(widened, rel=0.2)
    assert found["total"] == pytest.approx(float(np.sum(truth.masses())), rel=0.05)
    assert found["negative_percent"] < 5
    profile = numbers.profiles["coercivity"]
    assert np.trapezoid(profile.values, profile.x) == pytest.approx(found["total"], rel=0.05)


def test_a_fitted_density_gives_the_same_numbers(curves, truth):
    exact = ForcDiagram.of_model(truth)
    fitted = ForcDiagram.of_model(hf.fit("preisach-forc:n=30", curves).model)
    assert exact.mass.sum() == pytest.approx(float(np.sum(truth.masses())), rel=0.05)
    ours, theirs = forc_numbers(fitted).values, forc_numbers(exact).values
    assert ours["median_coercivity"] == pytest.approx(theirs["median_coercivity"], abs=0.04)
    assert ours["peak_interaction"] == pytest.approx(0.05, abs=0.03)
    assert ours["total"] == pytest.approx(theirs["total"], rel=0.05)


def test_cells_of_unequal_size_leave_no_gaps_in_the_distribution():
    """A density that is even over a square of reversals and fields has a triangle as distribution, also where most cells are coarse."""
    levels = np.concatenate([np.arange(-6.6, -0.7, 0.3), np.linspace(-0.6, 0.6, 25), np.arange(0.9, 6.7, 0.3)])
    width, middle = np.diff(levels), 0.5 * (levels[1:] + levels[:-1])
    inside = np.abs(np.abs(middle) - 0.4) < 0.1
    square = np.outer(inside & (middle < 0), inside & (middle > 0)).astype(float)
    density = np.where(middle[None, :] > middle[:, None], square, np.nan)
    draws = density * np.array([0.9, 1.0, 1.1])[:, None, None]
    numbers = forc_numbers(ForcDiagram(middle, middle, density, np.outer(width, width), repeats=draws))
    profile = numbers.profiles["coercivity"]
    triangle = 0.4 * np.maximum(1 - np.abs(profile.x - 0.4) / 0.1, 0.0)
    np.testing.assert_allclose(profile.values, triangle, atol=0.05)
    assert profile.width() == pytest.approx(0.1, abs=0.025)  # half a bin
    # Every draw has its peak in the same cells, and none says where in them it lies.
    assert numbers.stderr["peak_coercivity"] == pytest.approx(0.5 * np.sqrt(2 * 0.05**2 / 12 / 16), rel=1e-6)


def test_the_density_is_that_of_polynomials_point_by_point(curves):
    some = list(noisy(curves, 0.5, 1))[::5]
    diagram = forc_diagram(some, smoothing=2)
    reversal, field = diagram.reversal, diagram.field
    assert diagram.stderr is not None
    table = np.array(
        [np.where((field >= r.u.min()) & (field <= r.u.max()), np.interp(field, r.u, r.y), np.nan) for r in some[::-1]]
    )
    reach = round((diagram.resolution + 1e-9) / (field[1] - field[0]))
    ratios = []
    for k, j in ((3, 30), (5, 45), (1, 12), (4, field.size - 2)):
        rows, columns = slice(max(k - 2, 0), k + 3), slice(max(j - reach, 0), j + reach + 1)
        a, b = np.meshgrid(reversal[rows] - reversal[k], field[columns] - field[j], indexing="ij")
        known = np.isfinite(table[rows, columns])
        a, b, y = a[known], b[known], table[rows, columns][known]
        terms = np.column_stack([np.ones(a.size), a, b, a * a, a * b, b * b])
        inverse = np.linalg.inv(terms.T @ terms)
        assert diagram.density[k, j] == pytest.approx(-0.5 * (inverse @ terms.T @ y)[4], rel=1e-6)
        ratios.append(diagram.stderr[k, j] / (0.5 * np.sqrt(inverse[4, 4])))
    np.testing.assert_allclose(ratios, ratios[0])  # the noise, one number for all points


def test_standard_errors_are_the_scatter_of_repeated_measurements(curves):
    sigma = 1e-3 * np.ptp(curves[-1].y)
    fewer = hf.Dataset(tuple(curves)[::2])
    repeats = [forc_numbers(forc_diagram(noisy(fewer, sigma, seed), 2)).values for seed in range(16)]
    stderr = forc_numbers(forc_diagram(noisy(fewer, sigma, 99), 2, repeats=16)).stderr
    for name in ("peak_coercivity", "median_coercivity", "interaction_width", "total"):
        assert 0.6 < stderr[name] / np.std([one[name] for one in repeats], ddof=1) < 1.7


def test_the_central_ridge_is_that_of_grains_without_interaction():
    ridge = forc_numbers(forc_diagram(grains(0.0), 3)).values
    assert ridge["central_ridge"] == pytest.approx(
        1.0, rel=0.05
    )  # half the change of the output, all of it in the ridge
    assert forc_numbers(forc_diagram(grains(0.15), 3)).values["central_ridge"] is None


@pytest.mark.parametrize("falling", [False, True])
def test_the_loop_of_grains_without_interaction(falling):
    loop = forc_loop(reversal_curves(grains(0.0, falling=falling)))
    assert loop.value("coercive_input") == pytest.approx(COERCIVITY, abs=0.005)
    assert loop.remanent_coercivity == pytest.approx(COERCIVITY, abs=0.005)  # half of the grains have switched
    assert loop.coercivity_ratio == pytest.approx(1.0, abs=0.02)
    assert loop.squareness == pytest.approx(1.0, abs=0.01)


class TestCorrections:
    def calibrated(self, curves: hf.Dataset, gains: np.ndarray) -> hf.Dataset:
        """Each curve times a gain, after a calibration point at the largest field."""
        records = []
        for r, gain in zip(noisy(curves, 0.01, 5), gains, strict=True):
            u, y = np.append(1.0, r.u), gain * np.append(float(curves[-1].y[-1]), r.y)
            records.append(dataclasses.replace(r, u=u, y=y, weight=np.append(0.0, np.ones(len(r)))))
        return hf.Dataset(tuple(records))

    def test_drift_of_the_gain_is_removed(self, curves):
        gains = 1 + 0.02 * np.sin(np.arange(40) / 8)
        data, notes = corrected_curves(self.calibrated(curves, gains))
        assert ["drift" in str(note) for note in notes] == [True]
        ratio = np.array([found.y[-1] / before.y[-1] for found, before in zip(data, curves, strict=True)])
        assert np.std(ratio) < 0.1 * np.std(gains)

    def test_calibration_points_in_random_order_are_noise(self, curves):
        gains = 1 + 0.02 * np.random.default_rng(2).standard_normal(40)
        data = self.calibrated(curves, gains)
        assert corrected_curves(data) == (data, ())

    def test_first_points_before_the_field_has_settled_are_continued(self, curves):
        late = [dataclasses.replace(r, y=r.y + 20.0 * (np.arange(len(r)) == 0)) for r in noisy(curves, 0.3, 6)]
        data, notes = corrected_curves(hf.Dataset(tuple(late)))
        assert ["first point" in str(note) for note in notes] == [True]
        off = [found.y[0] - exact.y[0] for found, exact in zip(data, curves, strict=True)][:-8]
        assert np.median(np.abs(off)) < 3.0
        assert all((found.u == exact.u).all() for found, exact in zip(data, curves, strict=True))

    @pytest.mark.parametrize("sigma", [0.0, 0.3])
    def test_sound_curves_stay_as_they_are(self, curves, sigma):
        data = noisy(curves, sigma, 7)
        assert corrected_curves(data) == (data, ())


def test_a_density_that_is_nowhere_positive_is_refused(curves):
    diagram = forc_diagram(list(curves)[::4], 2)
    negative = dataclasses.replace(diagram, density=-np.abs(diagram.density))
    with pytest.raises(DataError, match="nowhere positive"):
        forc_numbers(negative)


def write(path: Path, curves: hf.Dataset) -> None:
    rows = [f"{k},{u!r},{y!r}" for k, r in enumerate(curves) for u, y in zip(r.u.tolist(), r.y.tolist(), strict=True)]
    path.write_text("curve,H_Oe,M_emu\n" + "\n".join(rows) + "\n")


def test_the_verb_writes_picture_density_distribution_and_page(curves, tmp_path, capsys):
    write(tmp_path / "forc.csv", hf.Dataset(tuple(curves)[::2]))
    out = tmp_path / "out"
    assert run(["forc", str(tmp_path / "forc.csv"), "--by", "curve", "--smoothing", "2", "--out", str(out)]) == 0
    assert "smoothing factor 2" in capsys.readouterr().out
    names = {"forc.png", "profiles.png", "curves.png", "forc.csv", "forc.npz", "profiles.csv"}
    assert {path.name for path in out.iterdir()} == names | {"report.html", "result.json"}
    stored = json.loads((out / "result.json").read_text())
    assert stored["schema"] == "hystfit.forc/2"
    assert (stored["smoothing"], stored["curves"], stored["units"]["input"]) == (2, 20, "Oe")
    peak = stored["numbers"]["peak_coercivity"]
    assert (peak["value"], peak["unit"]) == (pytest.approx(COERCIVITY, abs=0.05), "Oe")
    assert 0 < peak["stderr"] < 0.01
    assert stored["loop"]["remanent_coercivity"]["value"] == pytest.approx(COERCIVITY, abs=0.1)
    grid = np.load(out / "forc.npz")
    assert grid["density"].shape == (grid["reversal"].size, grid["field"].size)
    columns = np.genfromtxt(out / "forc.csv", delimiter=",", names=True)
    assert columns["density"].size == np.isfinite(grid["density"]).sum()
    np.testing.assert_allclose(
        columns["coercivity_Oe"], 0.5 * (columns["field_Oe"] - columns["reversal_Oe"]), atol=1e-8
    )
    page = (out / "report.html").read_text()
    assert page.count("data:image/svg+xml;base64,") == 3


def test_a_sampled_density_has_credible_errors_and_a_picture_beside_the_regression(curves, tmp_path, monkeypatch):
    """Draws made by hand: the mean and scatter of each cell by a plain loop, and errors of what is read off the diagram."""
    few = hf.Dataset(tuple(curves)[::5])
    fit = hf.fit("preisach-forc:n=6", few)
    scatter = 0.1 * np.random.default_rng(1).standard_normal((2, 40, fit.x.size))
    draws = np.maximum(fit.x + scatter, 0.0)
    names, units = tuple(fit.free_names), ("emu",) * fit.x.size
    stats, convergence = {}, Convergence.of(draws)
    posterior = Posterior(
        fit, "weights", "iid", names, units, draws, np.zeros((2, 40)), stats, convergence, Status.OK, (), {}, 0.0, 0, {}
    )
    diagram = sampled_density(posterior, 80)
    cell = list(zip(*np.tril_indices(6), strict=True)).index((3, 1))  # alpha in the fourth interval, beta in the second
    at, width = names.index(f"w[{cell}]"), np.diff(np.asarray(fit.model.levels))
    area = width[3] * width[1]
    assert diagram.density[1, 3] == pytest.approx(draws[..., at].mean() / area)
    assert diagram.stderr[1, 3] == pytest.approx(draws[..., at].std(ddof=1) / area)

    monkeypatch.setattr("hystfit.fitting.fit.fit", lambda *given: fit)
    monkeypatch.setattr("hystfit.sampling.sample.sample", lambda result: posterior)
    write(tmp_path / "forc.csv", few)
    out = tmp_path / "out"
    assert run(["forc", str(tmp_path / "forc.csv"), "--by", "curve", "--density", "sampled", "--out", str(out)]) == 0
    assert (out / "report.html").read_text().count("data:image/svg+xml;base64,") == 4
    total = json.loads((out / "result.json").read_text())["numbers"]["total"]
    weights = [k for k, name in enumerate(names) if name.startswith("w[")]
    assert total["stderr"] == pytest.approx(draws[..., weights].sum(axis=-1).std(ddof=1))
    u = np.sin(np.arange(80) / 5)
    other = dataclasses.replace(posterior, result=hf.fit("linear", hf.Record(u=u, y=2 * u)))
    with pytest.raises(ParameterError, match="no density"):
        sampled_density(other)


def test_a_file_without_reversal_curves_is_refused(tmp_path, capsys):
    u = np.sin(np.arange(200) / 10)
    rows = "\n".join(f"{a},{b}" for a, b in zip(u, u**3, strict=True))
    (tmp_path / "loop.csv").write_text(f"H_Oe,M_emu\n{rows}\n")
    assert run(["forc", str(tmp_path / "loop.csv")]) == 2
    assert "two reversal curves or more are needed, got 1" in capsys.readouterr().err


@pytest.mark.parametrize("open_by", [0.0, 0.2])
def test_reversal_curves_on_one_line_are_no_loop(curves, open_by):
    """A paramagnet, of which all curves are one, and a sample with a loop."""
    tilted = [dataclasses.replace(record, y=record.u + open_by * record.y) for record in curves]
    fit = hf.fit("preisach-forc:n=20", noisy(hf.Dataset(tuple(tilted)), 1e-3, 1))
    assert (fit.status is Status.NO_LOOP) == (open_by == 0)


def test_a_measured_family_has_its_published_coercivity():
    if not os.environ.get("HYSTFIT_DATA"):
        pytest.skip("HYSTFIT_DATA does not name the folder of measured data")
    data = hf.datasets.load("mag_forc_pyforc/FeCo")
    numbers = forc_numbers(forc_diagram(list(data)[::3], smoothing=2))
    last = list(data)[-1]  # from the lowest reversal: nearly the ascending branch of the major loop
    u, y = last.u[last.used], last.y[last.used]
    coercive = float(np.interp(0.0, y[np.argsort(y)], u[np.argsort(y)]))
    assert numbers.values["median_coercivity"] == pytest.approx(coercive, rel=0.1)
    assert abs(numbers.values["peak_interaction"]) < 0.1 * coercive
    assert forc_loop(reversal_curves(data)).value("coercive_input") == pytest.approx(coercive, rel=0.03)


def test_curves_that_noise_lets_cross_have_no_note():
    rng, fields = np.random.default_rng(22), np.linspace(-1, 1, 41)
    ends = [0.9 - 0.1 * k for k in range(18)]
    curve = lambda end: np.tanh(3 * (fields[fields >= end] - 0.4 * (0.9 - end)))
    noisy = lambda size: [
        hf.Record(fields[fields >= end], curve(end) + size * rng.normal(size=np.sum(fields >= end)), name=f"{end:.1f}")
        for end in ends
    ]
    assert "cross" not in " ".join(reversal_curves(noisy(0.006)).notes)
    crossed = noisy(0.006)
    crossed[9] = crossed[9].replace(y=crossed[9].y + 0.1)
    assert "cross" in " ".join(reversal_curves(crossed).notes)
