"""hystfit in a Python session: arrays and data frames, classes and misspelled names, what a result gives and shows."""

import html.parser
import subprocess
import sys

import jax
import numpy as np
import pandas as pd
import pytest
import xarray as xr

import hystfit as hf
from hystfit.cli import run
from hystfit.errors import DataError, MissingExtraError, ModelError, ParameterError
from hystfit.models import AbstractHysteresis
from hystfit.models.registry import make_model
from hystfit.outcome import Code, Note, Table, fragment
from hystfit.outcome.note import has
from hystfit.outcome.table import rounded

from .saved_examples import posterior_of

T = np.linspace(0.0, 4.0, 200)
U = 3 * np.sin(2 * np.pi * T) * np.exp(-0.2 * T)
TRUTH = hf.BoucWen(c=0.15, mu=0.4, tau=0.5, rho=0.8, offset=0.2)
MODEL = "bouc-wen"


def output(u: np.ndarray = U) -> np.ndarray:
    return np.asarray(hf.simulate(TRUTH, u)[0])


@pytest.fixture(scope="module")
def y() -> np.ndarray:
    return output() + 0.002 * np.random.default_rng(0).normal(size=U.size)


@pytest.fixture(scope="module")
def frame(y: np.ndarray) -> pd.DataFrame:
    return pd.DataFrame({"um": y, "volts": U, "elapsed": T, "remark": "a"})


@pytest.fixture(scope="module")
def result(y: np.ndarray) -> hf.FitResult:
    return hf.fit(MODEL, hf.Record(U, y, t=T, u_unit="V", y_unit="um"), starts=1)


def numbers(data: hf.Dataset) -> tuple[np.ndarray | None, ...]:
    (record,) = data
    return record.u, record.y, record.t


# -- data ------------------------------------------------------------------------------------------------------------------------


def test_arrays_fit_as_their_record_does(y: np.ndarray, result: hf.FitResult) -> None:
    for found in (hf.fit(MODEL, U, y, T, starts=1), hf.fit(MODEL, u=U, y=list(y), t=T, starts=1)):
        np.testing.assert_array_equal(found.x, result.x)
    assert hf.fit(MODEL, U, y, starts=1).data[0].t is None


def test_a_data_frame_is_read_as_a_file_with_its_columns(
    frame: pd.DataFrame, y: np.ndarray, result: hf.FitResult, tmp_path
) -> None:
    guessed = hf.fit(MODEL, frame, starts=1)
    np.testing.assert_array_equal(guessed.x, result.x)
    assert has(guessed.data[0].notes, Code.COLUMN_CHOICE)
    frame.to_csv(tmp_path / "loop.csv", index=False)
    read = hf.read_csv(tmp_path / "loop.csv")
    record = guessed.data[0]
    assert (read.u_name, read.y_name, read.t_unit) == (record.u_name, record.y_name, record.t_unit)
    other = frame.rename(columns={"um": "a", "volts": "b", "elapsed": "c"})
    np.testing.assert_array_equal(hf.fit(MODEL, other, u="b", y="a", t="c", starts=1).x, result.x)
    np.testing.assert_array_equal(hf.fit(MODEL, other, u=1, y=0, t=2, starts=1).x, result.x)


@pytest.mark.parametrize(
    "make",
    [
        lambda u, y, t: {"t": t, "u": u, "y": y},
        lambda u, y, t: np.rec.fromarrays([t, u, y], names="t,u,y"),
        lambda u, y, t: pd.DataFrame({"u": u, "y": y}, index=pd.Index(t, name="t")),
        lambda u, y, t: pd.DataFrame({"u": u, "y": y}, index=pd.Timestamp("2026-01-05") + pd.to_timedelta(t, unit="s")),
        lambda u, y, t: pd.DataFrame({"u": u, "y": y, "start": pd.to_datetime(t, unit="s", utc=True)}),
        lambda u, y, t: pd.DataFrame({"u": u, "y": pd.array(y, dtype="Float64"), "t": pd.to_timedelta(t, unit="s")}),
        lambda u, y, t: xr.Dataset({"u": ("t", u), "y": ("t", y)}, coords={"t": t}),
    ],
)
def test_columns_of_every_kind_are_the_same_record(make, y: np.ndarray) -> None:
    from hystfit.reading.in_memory import records_of

    u, measured, t = numbers(records_of(make(U, y, T)))
    np.testing.assert_array_equal(u, U)
    np.testing.assert_array_equal(measured, y)
    np.testing.assert_allclose(t - t[0], T, atol=1e-8)


def test_a_data_frame_takes_the_options_of_a_file() -> None:
    frame = pd.DataFrame({"loop": np.arange(200) // 100, "field": U, "moment": U**2})
    data = hf.read(frame, by="loop", rate=50.0, units="A/m,mT")
    assert isinstance(data, hf.Dataset)
    assert [len(record) for record in data] == [100, 100]
    assert {(record.u_unit, record.y_unit) for record in data} == {("A/m", "mT")}
    assert data[0].sampling_interval == pytest.approx(0.02)
    with pytest.raises(DataError, match="leave out sheet="):
        hf.read(frame, sheet="one")
    with pytest.raises(ParameterError, match=r"hystfit\.read\(data, rate="):
        hf.fit(MODEL, frame, rate=50.0)


def test_complex_numbers_are_refused_and_masked_ones_are_missing() -> None:
    """The imaginary part, and values under a mask, were used or dropped in silence."""
    for call in (lambda: hf.Record(U, U + 1j), lambda: hf.fit(MODEL, U, list(U + 1j))):
        with pytest.raises(DataError, match="complex"):
            call()
    record = hf.Record(U, np.ma.masked_greater(U, 2.5))
    np.testing.assert_array_equal(np.isnan(record.y), U > 2.5)
    assert 0 < record.used.sum() < U.size


class Polars:
    """A data frame that offers what those of polars do: names in `columns`, columns by name, and no index."""

    def __init__(self, columns: dict[str, np.ndarray]):
        self._columns, self.columns = columns, list(columns)

    def __getitem__(self, name: str) -> np.ndarray:
        return self._columns[name]


def test_units_of_columns_are_kept_and_missing_values_stay_missing() -> None:
    from hystfit.reading.in_memory import records_of

    (record,) = records_of(Polars({"u_V": U, "y [um]": np.where(T > 3, np.nan, U), "t_ms": 1e3 * T}))
    assert (record.u_unit, record.y_unit, record.t_unit) == ("V", "um", "ms")
    assert record.used.sum() == (T <= 3).sum()
    labelled = xr.Dataset({"drive": ("n", U, {"units": "V"}), "stage": ("n", U**2, {"units": "um"})})
    (record,) = records_of(labelled, u="drive", y="stage")
    assert (record.u_unit, record.y_unit, record.t) == ("V", "um", None)
    whole = pd.DataFrame({"u": U, "y": pd.array([None, *range(199)], dtype="Int64")})
    (record,) = records_of(whole)
    assert np.isnan(record.y[0])
    assert record.y[1] == 0.0
    (record,) = records_of(pd.Series(U, name="u_V"), pd.Series(U, name="y_um"))
    assert (record.u_name, record.u_unit, record.y_unit) == ("u_V", "V", "um")


def test_a_first_date_that_is_missing_leaves_out_its_row_alone() -> None:
    from hystfit.reading.in_memory import records_of

    dates = pd.Series(pd.to_datetime(T, unit="s"))
    dates[0] = pd.NaT
    (record,) = records_of(pd.DataFrame({"date": dates, "u": U, "y": U**2}))
    np.testing.assert_array_equal(record.u, U[1:])
    np.testing.assert_allclose(record.t, T[1:] - T[1], atol=1e-6)


@pytest.mark.parametrize(
    "arguments",
    [
        (np.stack([T, U, U], axis=1),),  # a matrix of columns
        (np.stack([U, U]), U),
        (U,),  # no output
        (U, None, T),
        ("loop.csv",),
        (U, "abc"),
        (U, U[:-1]),
        ({"u": U, "y": U[:-1]},),
        ({"u": U},),
        (pd.DataFrame({"u": U, "y": U}), U),  # an array where a column is named
        (pd.DataFrame(np.stack([U, U], axis=1), columns=["u", "u"]),),
        (hf.Record(U, U), U),
        (None,),
        (3,),
    ],
)
@pytest.mark.usefixtures("as_users_run")
def test_what_is_no_record_is_refused(arguments) -> None:
    with pytest.raises(DataError):
        hf.fit(MODEL, *arguments)
    with pytest.raises(DataError):
        hf.check(*arguments)


def test_a_matrix_is_answered_with_the_record_to_make() -> None:
    with pytest.raises(DataError, match=r"hystfit\.Record\("):
        hf.fit(MODEL, np.stack([T, U, U], axis=1))


@pytest.mark.usefixtures("findings_alone")
def test_check_and_the_test_data_take_data_frames(frame: pd.DataFrame, y: np.ndarray) -> None:
    report = hf.check(frame)
    assert report.records[0].motion == hf.check(U, y, T).records[0].motion
    tested = hf.fit(MODEL, frame, u="volts", y="um", t="elapsed", test=frame[50:], starts=1)
    assert tested.test is not None
    assert tested.test.n == 150


# -- models ----------------------------------------------------------------------------------------------------------------------


def test_a_class_is_the_model_of_its_name(y: np.ndarray, result: hf.FitResult) -> None:
    np.testing.assert_array_equal(hf.fit(hf.BoucWen, U, y, T, starts=1).x, result.x)
    assert repr(make_model(hf.Preisach)) == repr(make_model("preisach"))
    assert repr(make_model(hf.PrandtlIshlinskii)) == repr(make_model("prandtl-ishlinskii"))


def test_auto_is_the_winner_of_the_comparison(y: np.ndarray, monkeypatch) -> None:
    import hystfit.fitting.comparison.compare as comparison
    from hystfit.fitting.comparison.candidates import Candidates

    monkeypatch.setattr(comparison, "candidates", lambda data: Candidates(("bouc-wen", "offset+viscous")))
    found = hf.fit("auto", U, y, T, test=hf.Record(U, y, t=T))
    assert found.name == "bouc-wen"
    assert found.test is not None
    assert found.notes[0].code is Code.CHOICE
    for belongs_to_a_model in (
        {"fix": {"c": 0.15}},
        {"free": ["h0"]},
        {"start": "model"},
        {"loss": "huber"},
        {"method": "lm"},
    ):
        with pytest.raises(ParameterError):
            hf.fit("auto", U, y, T, **belongs_to_a_model)


def test_auto_takes_starting_points_and_noise(y: np.ndarray, monkeypatch) -> None:
    import hystfit.fitting.comparison.compare as comparison
    from hystfit.fitting.comparison.candidates import Candidates

    monkeypatch.setattr(comparison, "candidates", lambda data: Candidates(("bouc-wen", "offset+viscous")))
    plain, refined = (hf.fit("auto", U, y, T, starts=2, noise=noise) for noise in ("auto", "ou"))
    assert plain.starts == refined.starts == 2
    assert refined.notes[0].code is Code.CHOICE
    assert refined.left_out == plain.left_out is not None
    alone = hf.fit("bouc-wen", U, y, T, starts=2, noise="ou")
    assert (refined.name, refined.noise.name) == ("bouc-wen", "ou")
    np.testing.assert_allclose(refined.x, alone.x, rtol=1e-3)
    assert plain.noise.name == "auto"
    with pytest.raises(ParameterError):
        hf.fit("auto", U, y, T, starts=0)


@pytest.mark.usefixtures("as_users_run")
def test_compare_takes_names_classes_and_models(frame: pd.DataFrame) -> None:
    ranking = hf.compare(frame, ["bouc-wen", hf.BoucWen, hf.Sum(hf.BoucWen(), hf.Viscous())])
    assert set(ranking.fits) == {"bouc-wen", "bouc-wen (2)", "bouc-wen+viscous"}
    np.testing.assert_array_equal(ranking.fits["bouc-wen"].x, ranking.fits["bouc-wen (2)"].x)
    with pytest.raises(ModelError):
        hf.compare(frame, [dict])


@pytest.mark.parametrize("choice", [int, 3, None, ["bouc-wen"]])
@pytest.mark.usefixtures("as_users_run")
def test_what_is_no_model_is_refused(choice, y: np.ndarray) -> None:
    with pytest.raises(ModelError):
        hf.fit(choice, U, y)


class Unfinished(AbstractHysteresis):
    """Neither init nor step."""

    rate_independent = True
    gain: float = hf.param(1.0)


def test_a_missing_method_is_named_with_the_class_and_the_file(y: np.ndarray) -> None:
    with pytest.raises(ModelError) as caught:
        hf.fit(Unfinished, U, y)
    for word in ("Unfinished", "init", "step", __file__):
        assert word in str(caught.value)


def test_names_that_are_nearly_right_are_suggested(result: hf.FitResult, capsys, tmp_path) -> None:
    for misspelled, right in (("boucwen", "bouc-wen"), ("Preisach", "preisach"), ("log_creep", "log-creep")):
        with pytest.raises(ModelError, match=f"'{right}'"):
            make_model(misspelled)
    with pytest.raises(ParameterError, match="'dogleg'"):
        hf.fit(MODEL, result.data, method="dog-leg")
    with pytest.raises(ParameterError, match="'gamma'"):
        hf.LogCreep().replace(gama=1.0)
    with pytest.raises(KeyError, match="'offset'"):
        result["ofset"]
    with pytest.raises(DataError, match="'stage-sweep'"):
        hf.datasets.load("stage_sweep")
    assert run(["fit", "stage-sweep", "--model", "boucwen"]) == 2
    assert "'bouc-wen'" in capsys.readouterr().err


def test_replace_checks_names_and_bounds() -> None:
    model = hf.BoucWen(c=0.15)
    changed = model.replace(c=0.2, offset=-1.0)
    assert (float(changed.c), float(changed.offset), float(changed.mu)) == (0.2, -1.0, float(model.mu))
    assert float(model.c) == 0.15
    both = hf.Sum(hf.BoucWen(), hf.Offset()).replace(**{"bouc_wen.c": 0.3, "value": 2.0})
    assert (float(both.parts[0].c), float(both.parts[1].value)) == (0.3, 2.0)
    for values in ({"c": -1.0}, {"c": np.nan}, {"c": None}, {"c": [1.0, 2.0]}, {"c": "a"}, {"gain": 1.0}):
        with pytest.raises(ParameterError):
            model.replace(**values)


def test_a_model_shows_its_values_with_units() -> None:
    shown = repr(hf.BoucWen(c=0.1542))
    assert shown.startswith("BoucWen(c=0.1542 y/u, ")
    both = repr(hf.Sum(hf.BoucWen(c=0.1542), hf.Offset(value=2.5)))
    assert both == f"Sum({shown}, Offset(value=2.5 y))"
    assert "20 values from 1 to 1 " in repr(make_model("prandtl-ishlinskii").replace(w=1.0))
    traced: list[str] = []
    jax.jit(lambda model: traced.append(repr(model)))(hf.BoucWen())
    assert "c=f64[] y/u" in traced[0]


# -- results ---------------------------------------------------------------------------------------------------------------------


def test_predict_takes_arrays_and_data_frames(result: hf.FitResult, frame: pd.DataFrame) -> None:
    expected = np.asarray(hf.simulate(result.model, U[:50])[0])
    np.testing.assert_allclose(result.predict(U[:50], T[:50]), expected)
    np.testing.assert_allclose(result.predict(U[:50]), expected)
    np.testing.assert_allclose(result.predict(list(U[:50])), expected)
    np.testing.assert_allclose(result.predict(frame[["volts"]][:50]), expected)
    np.testing.assert_allclose(result.predict(frame[:50], u="volts"), expected)
    np.testing.assert_allclose(result.predict(hf.Record(U[:50], U[:50])), expected)
    assert result.units == {"u": "V", "y": "um", "t": "s"}
    for wrong in ((np.stack([U, U]),), (result.data,), (U, T[:-1]), ("loop.csv",), (frame[["remark"]],)):
        with pytest.raises(DataError):
            result.predict(*wrong)
    with pytest.raises(DataError):
        result.predict(U, refit_offset=True)


def test_a_prediction_that_needs_time_asks_for_it(y: np.ndarray) -> None:
    result = hf.fit(hf.Sum(hf.BoucWen(), hf.Viscous()), U, y, T, starts=1)
    with pytest.raises(ModelError):
        result.predict(U)
    expected = np.asarray(hf.simulate(result.model, U, np.diff(T, prepend=-T[1]))[0])
    np.testing.assert_allclose(result.predict(U, T), expected)


def test_values_residuals_and_intervals(result: hf.FitResult, y: np.ndarray) -> None:
    assert result.values == {p.name: p.value for p in result.parameters}
    record = hf.Record(U, np.where(T > 3, np.nan, y), t=T)
    other = hf.fit(MODEL, [record.replace(name="a"), record.replace(name="b")], starts=1)
    assert other.residuals.shape == (400,)
    assert np.isfinite(other.residuals).sum() == 2 * (T <= 3).sum()
    simulated = np.asarray(hf.simulate(result.model, U)[0])
    np.testing.assert_allclose(result.residuals, y - simulated, atol=1e-12)
    for level, reach in ((0.95, 1.959963984540054), (0.6826894921370859, 1.0)):  # quantiles of the normal distribution
        limits = result.confidence_intervals(level)
        assert list(limits) == list(result.free_names)
        c = result["c"]
        np.testing.assert_allclose(limits["c"], (c.value - reach * c.stderr, c.value + reach * c.stderr))
    for level in (0.0, 1.0, 95.0):
        with pytest.raises(ParameterError):
            result.confidence_intervals(level)
    held = hf.fit(MODEL, U, y, fix={"c": 0.15}, starts=1)
    assert held.values["c"] == 0.15
    assert "c" not in held.confidence_intervals()


def test_parameters_as_a_data_frame(result: hf.FitResult, monkeypatch) -> None:
    table = result.to_dataframe()
    assert dict(table["value"]) == result.values
    assert table.loc["c", "unit"] == "um/V"
    assert table["stderr"].isna().sum() == sum(p.stderr is None for p in result.parameters)
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingExtraError, match="frames"):
        result.to_dataframe()


class Reader(html.parser.HTMLParser):
    """The tags that are open, and the text."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: set[str] = set()
        self.text = ""

    def handle_starttag(self, tag: str, attrs) -> None:
        self.open.append(tag)
        self.seen.add(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def shown(item) -> Reader:
    reader = Reader()
    reader.feed(item if isinstance(item, str) else item._repr_html_())
    reader.close()
    assert reader.open == []
    return reader


EVIL = "<script>alert('a & b')</script>"


@pytest.mark.usefixtures("findings_alone")
def test_notebooks_show_tables_with_all_text_escaped(y: np.ndarray) -> None:
    record = hf.Record(U, y, t=T, name=EVIL, u_name=EVIL, u_unit=EVIL, y_unit=EVIL)
    result = hf.fit(MODEL, record, starts=1).with_notes(Note(Code.CHOICE, EVIL))
    comparison = hf.compare(record, ["bouc-wen"])
    for item in (result, posterior_of(result), comparison, hf.check(record)):
        page = shown(item)
        assert "table" in page.seen
        assert "script" not in page.seen
    assert EVIL in shown(result).text
    assert rounded(result["c"].value, result["c"].stderr)[0] in shown(result).text
    direct = shown(fragment(EVIL, (EVIL, (Note(Code.CHOICE, EVIL),), Table([EVIL, "b"], [[EVIL, 1.0]]), "", ())))
    assert direct.text.count(EVIL) == 5
    assert "script" not in direct.seen


# -- the package -----------------------------------------------------------------------------------------------------------------


def test_version_and_module() -> None:
    import importlib.metadata

    assert hf.__version__ == importlib.metadata.version("hystfit-jax")
    done = subprocess.run([sys.executable, "-m", "hystfit", "--version"], capture_output=True, text=True)
    assert (done.returncode, done.stdout.strip()) == (0, hf.__version__)
