"""Parameters that depend on covariates of the records: where values come from, fits, predictions, refusals."""

import dataclasses
import json

import jax
import numpy as np
import pytest

import hystfit as hf
from hystfit.cli import run
from hystfit.data.covariates import covariate, dependences
from hystfit.errors import DataError, ModelError, ParameterError
from hystfit.models.varying import Varying
from hystfit.params.param import leaves_of

TEMPERATURES = (10.0, 20.0, 45.0, 80.0)
MEAN = (10 + 20 + 80) / 3  # of the temperatures fitted
NOISE, TWO = 0.02, np.array([0.0, 1.0])
C, C_BY_T, MU, TAU, RHO = 0.12, 0.0006, 0.5, 0.08, 0.3  # c at 0 degC and its slope: the truth of the records


def device(temperature: float) -> hf.BoucWen:
    """A device whose gain rises with the temperature."""
    return hf.BoucWen(c=C + C_BY_T * temperature, mu=MU, tau=TAU, rho=RHO)


def loops(temperatures=TEMPERATURES, noise: float = NOISE) -> list[hf.Record]:
    """Loops of two amplitudes, named by their temperature."""
    phase = np.linspace(0, 6 * np.pi, 240)
    u = np.where(phase < 4 * np.pi, 50.0, 25.0) * np.sin(phase)
    rng = np.random.default_rng(7)
    measured = lambda t: np.asarray(hf.simulate(device(t), u)[0]) + noise * rng.standard_normal(u.size)
    return [hf.Record(u=u, y=measured(t), name=f"loop {t:g}degC", u_unit="V", y_unit="um") for t in temperatures]


@pytest.fixture(scope="module")
def fitted() -> hf.FitResult:
    """A fit to all temperatures but the third."""
    records = loops()
    held = {"tau": TAU, "rho": RHO}
    return hf.fit("bouc-wen", [*records[:2], records[3]], covariates={"T_degC": "c"}, fix=held, starts=1, noise="iid")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("loop_T25", 25),
        ("run T_degC=-5.5 b", -5.5),
        ("25 degC", 25),
        ("a_30C_2", 30),
        ("T=1e2", 100),
        ("loop_-5degC", -5),
    ],
)
def test_a_value_in_the_name_of_a_record(name, value):
    assert covariate(hf.Record(u=TWO, y=TWO, name=name), "T_degC") == value


def test_metadata_come_before_names_and_what_is_missing_or_ambiguous_is_refused():
    record = hf.Record(u=TWO, y=TWO, name="T25", metadata={"T [degC]": "30.5 degC"})
    assert covariate(record, "T_degC") == 30.5
    with pytest.raises(DataError, match="no value of current"):
        covariate(record, "current")
    with pytest.raises(DataError, match="several values"):
        covariate(record.replace(metadata={}, name="T25 to T30"), "T_degC")


def test_pairs_from_text_and_from_a_mapping():
    assert dependences("T_degC:c, mu") == (("T_degC", "c"), ("T_degC", "mu"))
    assert dependences({"T": ["c"], "load": "c"}) == (("T", "c"), ("load", "c"))
    for wrong in ("T_degC", "T:c,c", ":c", "a b:c"):
        with pytest.raises(ParameterError):
            dependences(wrong)


def test_the_slope_and_its_error(fitted):
    """Against the truth, and against least squares by hand on columns from differences of the simulation."""
    assert fitted.usable
    for name, truth in (("c/T_degC", C_BY_T), ("c", C + C_BY_T * MEAN), ("mu", MU)):
        assert abs(fitted[name].value - truth) < 4 * fitted[name].stderr
    assert fitted["c/T_degC"].unit == "um/V/degC"
    u, mu, step, blocks = fitted.data[0].u, fitted["mu"].value, 1e-6, []
    run = lambda c, mu: np.asarray(hf.simulate(dataclasses.replace(device(0), c=c, mu=mu), u)[0])
    for k, away in enumerate(np.array([10, 20, 80]) - MEAN):
        c = fitted["c"].value + fitted["c/T_degC"].value * away
        by_c, by_mu = (
            run(1.0, mu),
            (run(c, mu + step) - run(c, mu - step)) / (2 * step),
        )  # the output is proportional to c
        blocks.append(np.column_stack([by_c, by_mu, np.outer(np.ones(u.size), np.eye(3)[k]), by_c * away]))
    columns, y = np.concatenate(blocks), np.concatenate([record.y for record in fitted.data])
    without_mu = np.delete(columns, 1, axis=1)
    solution, squares, *_ = np.linalg.lstsq(without_mu, y, rcond=None)
    assert [fitted["c"].value, fitted["c/T_degC"].value] == pytest.approx(solution[[0, 4]], rel=1e-5)
    errors = np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)) * squares / (y.size - 6))
    assert [fitted[name].stderr for name in ("c", "mu", "c/T_degC")] == pytest.approx(errors[[0, 1, 5]], rel=0.01)


def test_another_temperature_is_predicted(fitted):
    record = loops()[2]
    assert fitted.metrics(record).rmse < 1.2 * NOISE
    chosen = fitted.at(T_degC=45)
    assert np.allclose(chosen.predict(record.u), fitted.predict(record))
    assert chosen.model.resolved().c == pytest.approx(C + 45 * C_BY_T, abs=1e-4)
    warm = record.replace(name="loop 120degC")
    assert "outside the fitted 10 to 80" in fitted.extrapolation(warm).text
    ends = {row.name: row for row in fitted.derived}
    variance = fitted.covariance[np.ix_(at := [fitted.free_names.index(n) for n in ("c", "c/T_degC")], at)]
    push = np.array([1.0, 80 - MEAN])
    assert ends["c(T_degC=80)"].stderr == pytest.approx(np.sqrt(push @ variance @ push))


def test_without_a_temperature_the_device_is_not_known(fitted):
    u = fitted.data[0].u
    with pytest.raises(DataError, match="no value of T_degC"):
        fitted.predict(u)
    with pytest.raises(ModelError, match=r"result.at\(T_degC="):
        hf.invert(fitted, u)
    with pytest.raises(ParameterError, match="no covariate 'T'"):
        fitted.at(T=3)


@pytest.fixture(scope="module")
def folder(fitted, tmp_path_factory):
    """The fit, saved."""
    fitted.save(folder := tmp_path_factory.mktemp("covariates") / "fit", report=False)
    return folder


def test_a_saved_fit_is_the_same_fit(fitted, folder):
    again, record = hf.load_fit(folder), loops()[2]
    assert np.array_equal(again.predict(record), fitted.predict(record))
    assert again["c/T_degC"].stderr == fitted["c/T_degC"].stderr


def test_columns_of_linear_weights():
    """Closed-form columns of weights and of their slopes against differences of the simulation."""
    records = loops((10.0, 30.0))
    model = Varying.of(hf.PrandtlIshlinskii.of(plays=4).start(records), [("T_degC", "w")], records)
    leaf = next(leaf for leaf in leaves_of(model) if leaf.path[-1] == "w/T_degC")
    leaves, structure = jax.tree_util.tree_flatten(model)
    leaves[leaf.index] = leaves[leaf.index] + 0.003
    model = structure.unflatten(leaves)
    design = model.design_matrix(records[0].u)
    block = next(block for block in design.blocks if block.leaf == leaf.index)
    for k in range(4):
        leaves[leaf.index] = model.slopes[0].value.at[0, k].add(0.5)
        change = structure.unflatten(leaves).free_run(records[0].u) - model.free_run(records[0].u)
        assert np.allclose(block.columns[design.index, k] * 0.5, change, atol=1e-10)


def test_a_parameter_stays_within_its_bounds():
    model = Varying.of(device(0), [("T_degC", "mu")], loops((10.0, 30.0)))
    steep = dataclasses.replace(model, slopes=(dataclasses.replace(model.slopes[0], value=10.0),))
    low, high = steep.of_record(loops((0.0,))[0]).resolved(), steep.of_record(loops((90.0,))[0]).resolved()
    assert 0 < low.mu < 1e-5
    assert 1 - 1e-5 < high.mu < 1


def test_what_cannot_be_determined_is_named():
    records = loops((10.0, 30.0), noise=0)
    with pytest.raises(DataError, match="T_degC is 10 in every record"):
        hf.fit("bouc-wen", records[0], covariates="T_degC:c")
    both = [record.replace(metadata={"load": str(k)}) for k, record in enumerate(records)]
    with pytest.raises(DataError, match="change together"):
        hf.fit("bouc-wen", both, covariates=["T_degC:c", "load:mu"])
    with pytest.raises(ParameterError, match="a value for each record"):
        hf.fit("bouc-wen", records, covariates="T_degC:offset")
    with pytest.raises(ParameterError, match="needs an explicit model"):
        hf.fit("auto", records, covariates="T_degC:c")
    with pytest.raises(ModelError, match="Preisach"):
        hf.fit("preisach", records, covariates="T_degC:w")


def test_at_the_shell(folder, tmp_path, capsys):
    """The temperature is a column of the files; the model has a closed-form solve."""
    names = []
    for k, record in enumerate(loops()):
        table = np.column_stack([record.u, record.y, np.full(len(record), TEMPERATURES[k])])
        names.append(str(tmp_path / f"run{k}.csv"))
        np.savetxt(names[-1], table, delimiter=",", header="u_V,y_um,T_degC", comments="")
    assert run(["fit", *names, "--model", "prandtl-ishlinskii:plays=3", "--covariate", "T_degC:w", "--json"]) == 0
    assert "w/T_degC[0,2]" in json.loads(capsys.readouterr().out)["parameters"]
    assert run(["predict", str(folder), names[2], "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["metrics"]["test"]["rmse"] < 1.2 * NOISE
    assert (
        run(["predict", str(folder), names[2], "--covariate", "T_degC=10", "--json"]) == 1
    )  # another temperature than the file's
    capsys.readouterr()
    assert run(["export", str(folder), "--c", str(tmp_path / "code")]) == 2
    assert "T_degC" in capsys.readouterr().err
