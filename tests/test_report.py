"""The report and its pictures."""

import base64
import dataclasses
import html.parser
import itertools
import math
import re
import warnings

import matplotlib
import matplotlib.figure
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib import font_manager

from hystfit.data.dataset import Dataset
from hystfit.data.record import Record
from hystfit.errors import HystfitError
from hystfit.fitting.fit import fit
from hystfit.fitting.trial import with_test
from hystfit.inference.problem import Problem
from hystfit.models import BoucWen, PrandtlIshlinskii, Preisach, simulate
from hystfit.outcome import Status
from hystfit.outcome.table import number, rounded
from hystfit.params.units import axis_label
from hystfit.results import plots, report
from hystfit.results.estimates import ParameterEstimate
from hystfit.results.record_plots import thin
from hystfit.results.result import FitResult


@pytest.fixture(scope="module")
def result() -> FitResult:
    t = np.arange(200) / 50
    u = 30 * np.sin(2 * np.pi * t / 2) * (1 - t / 8)
    y = np.asarray(simulate(BoucWen(c=0.2, mu=0.5, tau=0.05, rho=0.3), u)[0])
    y = y + 0.02 * np.random.default_rng(5).standard_normal(t.size)
    record = Record(u=u, y=y, t=t, u_unit="V", y_unit="um", u_name="u_V", y_name="y_um", name="run <b>1</b> & more")
    fitted = fit(BoucWen(), record.window(0.0, 3.0), starts=1)
    return with_test(fitted, record.window(3.0, None))


def weights(count: int, zeros: int) -> tuple[ParameterEstimate, ...]:
    rows = []
    for k in range(count):
        value = 0.0 if k < zeros else 0.5 + k
        bound = "lower" if k < zeros else None
        rows.append(
            ParameterEstimate(f"w[{k}]", value, None if k < zeros else 0.1, "um/V", 0.0, None, False, bound, k >= zeros)
        )
    return tuple(rows)


# -- numbers ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "stderr", "shown"),
    [
        (0.156789, 0.00087, ("0.15679", "0.00087")),
        (123.456, 12.3, ("123", "12")),
        (123456.0, 1234.0, ("123500", "1200")),
        (-1.23456e-7, 1.1e-9, ("-1.235e-07", "0.011e-07")),
        (3.0e9, 2.0e7, ("3.000e+09", "0.020e+09")),
        (-0.001, 914.0, ("0", "910")),
        (-0.000191, 0.00038, ("-0.00019", "0.00038")),
        (0.0, 0.02, ("0.000", "0.020")),
        (100.0, 3e-10, ("100", "3e-10")),
        (1.5, None, ("1.5", "-")),
        (1.5, math.nan, ("1.5", "-")),
        (1.5, 0.0, ("1.5", "-")),
        (4.9407e-324, None, ("0", "-")),
    ],
)
def test_rounding(value, stderr, shown):
    assert rounded(value, stderr) == shown


@given(value=st.floats(1e-12, 1e12).flatmap(lambda v: st.sampled_from([v, -v])), relative=st.floats(1e-9, 1e3))
def test_rounded_numbers_have_the_digits_of_the_error(value, relative):
    stderr = abs(value) * relative
    shown_value, shown_error = map(float, rounded(value, stderr))
    assert abs(shown_error - stderr) <= 0.051 * stderr  # two digits
    assert abs(shown_value - value) <= 0.051 * stderr + 1e-14 * abs(value)


# -- text ------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "form", "shown"),
    [
        (1093.7, ".3g", "1090"),
        (58183.0, ".4g", "58180"),
        (160.4, ".2g", "160"),
        (999999.0, ".2g", "1000000"),
        (2.5e6, ".3g", "2.5e+06"),
        (-1628.4, ".3g", "-1630"),
        (0.00012, ".2g", "0.00012"),
        (1.5e-7, ".2g", "1.5e-07"),
        (float("nan"), ".3g", "-"),
    ],
)
def test_numbers_have_an_exponent_only_where_digits_would_be_many(value, form, shown):
    assert number(value, form) == shown


def test_text_has_what_a_reader_needs(result):
    text = report.text_report(result)
    assert text.startswith("bouc-wen fitted to run <b>1</b> & more: usable\n====")
    for p in result.parameters:
        if p.fixed:
            assert f"{p.name} = {p.value:.5g}" in text
        else:
            value, error = rounded(p.value, p.stderr)
            assert re.search(
                rf"^  {p.name} +{re.escape(value)} +{re.escape(error)} +{re.escape(p.unit)}", text, re.MULTILINE
            )
    flat = " ".join(text.split())
    for note in result.notes:
        assert " ".join(str(note).split()) in flat
    assert f"{result.test.nrmse_percent:.3g}" in text
    assert result.provenance["records"][0]["data_sha256"] in text
    assert "200 samples, 150 fitted" in flat
    for heading in ("Parameters", "Notes", "Residuals", "Fit", "Data", "Provenance"):
        assert re.search(rf"^{heading}$", text, re.MULTILINE)
    assert max(map(len, text.splitlines())) <= 100
    assert not re.search(r"\b(nan|None|inf)\b", text)


def test_status_advice_and_unknown_values(result):
    poor = dataclasses.replace(
        result, status=Status.POOR, test=None, compile_s=None, run_s=None, rank=None, condition=None
    )
    text = report.text_report(poor)
    assert "NOT USABLE (poor)" in text
    assert " ".join(poor.advice.split()) in " ".join(text.split())
    assert re.search(r"^  test ", report.text_report(result), re.MULTILINE)
    assert not re.search(r"^  test ", text, re.MULTILINE)  # there are no test data
    assert not re.search(r"\b(nan|None|inf)\b", text)


def test_many_weights_take_one_line(result):
    many = dataclasses.replace(result, parameters=weights(30, 11))
    (row,) = report.parameter_table(many).rows
    assert (row[0], row[1]) == ("w[30]", "0 to 29.5")
    assert row[5] == "30 values, 11 zero"
    few = report.parameter_table(dataclasses.replace(result, parameters=weights(12, 3))).rows
    assert [row[0] for row in few] == [f"w[{k}]" for k in range(12)]
    assert [row[5] for row in few] == ["at its lower bound"] * 3 + [""] * 9


def test_bounds_and_remarks(result):
    parameter = ParameterEstimate("a", 1.0, None, "", None, 4.0, False, None, False)
    (row,) = report.parameter_table(dataclasses.replace(result, parameters=(parameter,))).rows
    assert row == ["a", "1", "-", "", "<= 4", "not determined"]


def test_a_perfect_fit_is_not_rounded_up(result):
    close = dataclasses.replace(result.train, r2=0.9999999)
    table = report.metrics_table(dataclasses.replace(result, train=close))
    assert table.cells()[0][5] == "0.999999"


def test_metrics_of_training_and_test_data(result):
    training, test = report.metrics_table(result).to_list()
    for row, metrics in ((training, result.train), (test, result.test)):
        for key in ("rmse", "nrmse_percent", "max_error", "max_error_percent", "n"):
            assert row[key] == getattr(metrics, key)


# -- page and files --------------------------------------------------------------------------------------------------------


class Links(html.parser.HTMLParser):
    """Everything that a page would load, its tags, and its text."""

    def __init__(self):
        super().__init__()
        self.loaded, self.tags, self.words = [], [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.loaded += [value for key, value in attrs if key in ("src", "href", "srcset", "data", "action")]

    def handle_data(self, data):
        self.words.append(data)


def test_page_is_whole_and_self_contained(result):
    page = report.html_report(result)
    links = Links()
    links.feed(page)
    assert len(links.loaded) == 6
    assert all(link.startswith("data:image/svg+xml;base64,") for link in links.loaded)
    assert not re.search(r"https?://|@import|url\(", page)
    drawn = base64.b64decode(links.loaded[0].partition(",")[2]).decode()
    assert not re.search(r'(href|src)="(?!#|data:)', drawn)
    assert {"table", "th", "td", "img"} <= set(links.tags)
    assert not {"link", "iframe", "object", "b"} & set(links.tags)
    text = " ".join(links.words)
    assert "run <b>1</b> & more" in text  # a name from a file is text, not markup
    for note in result.notes:
        assert str(note) in text
    for cells in (*report.metrics_table(result).cells(), *report.parameter_table(result, meaning=True).cells()):
        assert all(cell in text for cell in cells)  # the page and the text show the same tables
    assert "fraction of the slope c that is lost at a reversal" in text
    assert 'name="viewport"' in page
    assert '<div class="next"><dt>Next</dt>' in page  # commands have a line of their own, in a monospaced font


def test_files(result, tmp_path):
    import matplotlib.pyplot as plt

    record = result.data[0].replace(name="other")
    folder = report.write(result, tmp_path / "out", test=record, refit_offset=True)
    names = ("loop", "series", "residuals", "residuals-input", "autocorrelation", "parameters", "test", "test-series")
    assert {p.name for p in folder.iterdir()} == {"report.html", "report.txt"} | {
        f"{n}.{e}" for n in names for e in ("png", "svg")
    }
    for name in names:
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert "<svg" in (folder / f"{name}.svg").read_text()
    assert plt.get_fignums() == []
    with pytest.raises(HystfitError, match="does not exist"):
        report.write(result, tmp_path / "no" / "such")
    (tmp_path / "file").write_text("")
    with pytest.raises(HystfitError, match="it is a file"):
        report.write(result, tmp_path / "file")


# -- pictures --------------------------------------------------------------------------------------------------------------


def axes():
    return matplotlib.figure.Figure().subplots()


def test_loop_and_series_show_the_numbers(result):
    record = result.data[0]
    for kind, x in (("loop", record.u), ("series", record.t)):
        ax = axes()
        assert plots.fit(result, kind, ax) is ax
        drawn = {line.get_label(): line for line in ax.get_lines()}
        assert np.array_equal(drawn["model"].get_xdata(), x)
        assert np.array_equal(drawn["model"].get_ydata(), result.predict(record))
        inside = record.t < 3
        assert np.array_equal(drawn["measured"].get_ydata()[inside], record.y[inside])
        assert np.isnan(drawn["measured"].get_ydata()[~inside]).all()
        assert np.array_equal(drawn["measured, not fitted"].get_ydata()[~inside], record.y[~inside])
        assert ax.get_xlabel() == {"loop": "u [V]", "series": "time [s]"}[kind]
        assert ax.get_ylabel() == "y [um]"


@pytest.mark.parametrize("kind", ["loop", "series"])
def test_the_model_is_not_drawn_over_samples_that_only_set_its_state(result, kind):
    record = result.data[0]
    late = record.t >= 3
    ax = plots.fit(result, kind, axes(), data=record.replace(weight=late.astype(float)))
    (model,) = (line for line in ax.get_lines() if line.get_label() == "model")
    assert np.array_equal(np.isfinite(model.get_ydata()), late)


def test_a_calibration_point_before_a_curve_is_not_joined_to_it(result):
    record = result.data[0]
    u, weight = np.append(90.0, record.u), np.append(0.0, np.ones(len(record)))
    curve = Record(u=u, y=np.append(20.0, record.y), weight=weight, name="curve")
    drawn = {line.get_label(): line for line in plots.fit(fit(BoucWen(), curve, starts=1), "loop", axes()).get_lines()}
    assert list(drawn) == ["measured", "model"]
    assert np.isnan(drawn["model"].get_ydata()[0])
    assert np.isfinite(drawn["model"].get_ydata()[1:]).all()


def test_every_kind_leaves_the_result_alone(result):
    before = result.to_dict(), result.data[0].digest()
    for kind in plots.KINDS:
        assert plots.fit(result, kind, axes()).get_xlabel()
    assert (result.to_dict(), result.data[0].digest()) == before
    with pytest.raises(HystfitError, match="there are loop, series"):
        plots.fit(result, "pie", axes())


def test_axes_are_made_where_none_are_given(result):
    matplotlib.use("agg")
    import matplotlib.pyplot as plt

    ax = result.plot()
    assert ax.figure.number in plt.get_fignums()
    plt.close(ax.figure)


def test_autocorrelation_starts_at_one_and_parameters_show_relative_errors(result):
    (line,) = [
        line for line in plots.fit(result, "autocorrelation", axes()).collections if hasattr(line, "get_segments")
    ]
    assert line.get_segments()[0][1][1] == pytest.approx(1.0)
    ax = plots.fit(result, "parameters", axes())
    dots = [line.get_xdata()[0] for line in ax.get_lines() if line.get_marker() == "o"]
    free = [p for p in result.parameters if not p.fixed]
    assert dots == pytest.approx([100 * p.stderr / abs(p.value) for p in free])
    assert [label.get_text() for label in ax.get_yticklabels()] == [p.name for p in free]


@given(seed=st.integers(0, 1000), size=st.integers(50, 3000), most=st.integers(8, 200))
@settings(max_examples=50)
def test_thinning_keeps_ends_and_extremes(seed, size, most):
    rng = np.random.default_rng(seed)
    a, b = rng.standard_normal((2, size))
    b[rng.integers(size, size=size // 10)] = np.nan
    at = thin(most, a, b)
    assert (np.diff(at) > 0).all()
    assert (at[0], at[-1]) == (0, size - 1)
    assert at.size <= max(most, 8) + 2
    assert (a[at].min(), a[at].max()) == (a.min(), a.max())
    assert (np.nanmin(b[at]), np.nanmax(b[at])) == (np.nanmin(b), np.nanmax(b))


def test_a_report_with_names_in_other_scripts_has_them_in_the_text_and_no_warnings(result, tmp_path, monkeypatch):
    fonts = [entry for entry in font_manager.fontManager.ttflist if "mpl-data" in entry.fname]
    monkeypatch.setattr(font_manager.fontManager, "ttflist", fonts)
    record = result.data[0].replace(u_name="电压_V", y_name="перемещение", y_unit="微米", name="記録")
    renamed = dataclasses.replace(result, problem=Problem(result.problem.model, record))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        report.write(renamed, tmp_path / "report", test=record)
    text = (tmp_path / "report" / "report.txt").read_text(encoding="utf-8")
    assert all(name in text for name in ("电压_V", "перемещение", "微米", "記録"))
    ax = plots.fit(renamed, "loop", matplotlib.figure.Figure().subplots())
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("input [V]", "output")


def test_labels_show_a_unit_once():
    assert axis_label("u_V", "V") == "u [V]"
    assert axis_label("H [Oe]", "Oe") == "H [Oe]"
    assert axis_label("V", "V") == "V [V]"
    assert axis_label("force", "") == "force"
    assert axis_label("mag / emu / g", "emu / g") == "mag [emu / g]"
    assert axis_label("Ewe/V", "V") == "Ewe [V]"
    assert axis_label("kappa_w", "[y]") == "kappa_w [y]"
    assert axis_label("Strom", "m") == "Strom [m]"


def test_a_few_residuals_not_fitted_do_not_flatten_those_of_the_fit():
    u = 30 * np.sin(2 * np.pi * np.arange(200) / 50)
    y = 0.2 * u + 0.02 * np.random.default_rng(5).standard_normal(u.size)
    whole = fit(BoucWen(), Record(u=u, y=y, weight=np.arange(200) < 150), starts=1)
    y[[160, 170]] += [5.0, -7.0]
    marred = fit(BoucWen(), Record(u=u, y=y, weight=np.arange(200) < 150), starts=1)
    for kind in ("residuals", "residuals-input"):
        assert not plots.fit(whole, kind, axes()).texts
        ax = plots.fit(marred, kind, axes())
        shown = re.fullmatch(r"2 [^0-9]*(\S+)\)", ax.texts[0].get_text())
        assert shown is not None
        assert float(shown[1]) == pytest.approx(7.0, abs=0.1)
        assert np.abs(marred.predict(marred.data[0]) - y)[:150].max() < ax.get_ylim()[1] < 0.5


def cycling(count: int, spikes: int = 0, worst: int = 6) -> FitResult:
    """A fit of many cycles, of which one (the seventh) has a larger error, and of outliers."""
    n = 60
    u = 30 * np.sin(2 * np.pi * np.arange(n * count + 1) / n)
    y = 0.2 * u + 0.02 * np.random.default_rng(5).standard_normal(u.size)
    y[worst * n : (worst + 1) * n] += 0.3
    y[: n * spikes : n] += 40.0
    return fit(BoucWen(), Record(u=u, y=y), starts=1, fix={"mu": 0.5, "tau": 0.05, "rho": 0.0}, loss="huber")


def test_a_cycle_that_is_last_and_worst_is_shown_once():
    labels = [line.get_label() for line in plots.fit(cycling(12, worst=11), "loop", axes()).get_lines()]
    assert [label for label in labels if label.startswith("cycle")] == ["cycle 1 (first)", "cycle 11 (largest error)"]


def test_of_many_cycles_the_first_the_last_and_the_worst_are_shown():
    many = cycling(12)
    labels = [line.get_label() for line in plots.fit(many, "loop", axes()).get_lines()]
    shown = [label for label in labels if label.startswith("cycle")]
    assert [label.partition(" (")[2] for label in shown] == ["first)", "last)", "largest error)"]
    numbers = [int(label.split()[1]) for label in shown]
    assert numbers[0] == 1
    assert numbers[1] == 11  # whole cycles between turning points
    assert numbers[2] in (6, 7)
    line = plots.fit(many, "cycle-errors", axes()).get_lines()[0]
    record = many.data[0]
    at = np.flatnonzero(record.u == line.get_xdata()[5])
    measured_less_model = (record.y - many.predict(record))[at]
    assert np.abs(measured_less_model - line.get_ydata()[5]).min() == 0
    assert {"cycle-errors", "worst"} <= set(report.page.pictures(many))
    worst = plots.fit(many, "worst", axes())
    low, high = worst.get_xlim()
    assert 300 < low < 6.5 * 60 < high < 500


def test_pictures_of_many_records_share_predictions_and_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    """152 reversal curves were predicted for each of seven pictures, and drawn as 304 lines in each."""
    u = np.sin(np.linspace(0, 2 * np.pi, 60))
    parts = [Record(a * u, a * np.sin(np.linspace(0, 2 * np.pi, 60) - 0.3), name=f"{a}") for a in (0.4, 0.7, 1.0)]
    fitted, runs = fit("prandtl-ishlinskii:plays=4", Dataset(tuple(parts)), noise="iid"), []
    predict = type(fitted).predict
    monkeypatch.setattr(type(fitted), "predict", lambda *a, **k: runs.append(1) or predict(*a, **k))
    lines = report.page.pictures(fitted)["loop"].axes[0].get_lines()
    assert len(runs) == len(parts)
    assert [line.get_label() for line in lines] == ["measured", "model"]
    x, y = (np.asarray(values) for values in lines[0].get_data())
    gaps, shown = (
        np.flatnonzero(np.isnan(x)),
        [(record.u, np.where(record.used, record.y, np.nan)) for record in fitted.data],
    )
    assert (np.diff([-1, *gaps, x.size]) - 1).tolist() == [u.size for u, _ in shown]
    np.testing.assert_array_equal(np.delete(x, gaps), np.concatenate([u for u, _ in shown]))
    np.testing.assert_array_equal(np.delete(y, gaps), np.concatenate([part for _, part in shown]))


def test_outliers_of_the_fit_are_clipped_and_counted():
    marred = cycling(40, spikes=3)
    ax = plots.fit(marred, "residuals", axes())
    assert ax.texts[0].get_text().startswith("3 outliers lie outside (up to 4")
    assert ax.get_ylim()[1] < 10


def test_weights_and_density_have_units_and_mark_what_is_zero_or_not_switched():
    u = np.concatenate([np.linspace(0, 8, 40), np.linspace(8, -6, 60), np.linspace(-6, 6, 50)])
    plays = PrandtlIshlinskii.of(5)
    y = np.asarray(simulate(plays.replace(high=8.0), u)[0])
    record = Record(u=u, y=y + 0.01 * np.random.default_rng(0).standard_normal(u.size), u_unit="V", y_unit="um")
    fitted = fit(plays, record)
    ax = plots.fit(fitted, "weights", axes())
    (family,) = fitted.model.plays()
    drawn = ax.containers[0][0]
    np.testing.assert_allclose(drawn.get_ydata(), [fitted[name].value for name in family.names])
    span = float(fitted.model.high - fitted.model.low)
    np.testing.assert_allclose(drawn.get_xdata(), span * np.asarray(fitted.model.r))
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("threshold (half width) [V]", "weight [um]")
    ax = plots.fit(fit(Preisach.of(12), record), "density", axes())
    assert ax.get_ylabel() == "switch-up threshold alpha [V]"
    assert ax.figure.axes[1].get_ylabel() == "weight density [um/V^2]"
    square = ax.collections[0].get_array()
    assert np.ma.getmaskarray(np.ma.masked_invalid(square))[0, 1:].all()  # alpha < beta: no cells


def test_the_answer_stands_at_the_top_of_the_page_and_the_text(result):
    page, text = report.html_report(result), report.text_report(result)
    rows = dict(re.findall(r"<dt>(.*?)</dt><dd>(.*?)</dd>", page, re.DOTALL))
    assert rows["Error"].startswith(f"{result.train.nrmse_percent:.3g} % of the range")
    assert f"{result.baselines.noise:.2g} um" in rows["Error"]
    hysteresis = next(q for q in result.quantities if q.name == "hysteresis_percent")
    assert rows["Hysteresis (of the stroke)"] == f"{' +- '.join(rounded(hysteresis.value, hysteresis.stderr))} %"
    assert rows["Not determined"] == "nothing"
    assert "hystfit invert FIT REFERENCE" in rows["Next"]
    assert page.index("<dl") < page.index("<section")
    assert text.index("\nAnswer\n") < text.index("\nVerdict\n")
    poor = dataclasses.replace(result, status=Status.POOR)
    assert "hystfit compare LOOP" in report.html_report(poor)


def test_a_wide_table_is_whole_on_paper(browser, tmp_path, result):
    (tmp_path / "page.html").write_text(report.html_report(result))
    page = browser.new_page(viewport={"width": 720, "height": 1000})
    page.goto((tmp_path / "page.html").as_uri())
    page.emulate_media(media="print")
    assert (
        page.evaluate(
            "Math.max(...[...document.querySelectorAll('td, th')].map((e) => e.getBoundingClientRect().right))"
        )
        < 720
    )
    page.close()


def test_a_picture_is_enlarged_in_data_coordinates(browser, tmp_path):
    """The point under the pointer stays, marks keep to the labels of the new ticks, linked axes follow, and named ticks stay."""
    from matplotlib.figure import Figure

    from hystfit.results.webpage import Page, Picture

    x, figures = np.arange(11.0), [Figure(figsize=(5.6, 4.0), layout="constrained") for _ in range(2)]
    for ax in (pair := figures[0].subplots(2, 1, sharex=True)):
        ax.plot(x, 1e-7 * x, "o")
        ax.axhline(5e-7, color="red")
    named = figures[1].subplots()
    named.semilogx(10.0 ** (x - 5), x, "o")
    named.set_yticks([0, 10], ["low", "high"])
    shown = [Picture(figure, "points") for figure in figures]
    (tmp_path / "page.html").write_text(Page("Zoom", "Usable.", True, (), [("Pictures", [shown])]).render())
    page, faults = browser.new_page(viewport={"width": 1000, "height": 800}), []
    page.on("pageerror", lambda error: faults.append(str(error)))
    page.goto((tmp_path / "page.html").as_uri())
    look = """(k) => {
        const middle = (e) => { const b = e.getBoundingClientRect(); return [b.x + b.width / 2, b.y + b.height / 2]; };
        const group = document.querySelectorAll("dialog svg [id^=axes]")[k], ticks = group.lastElementChild;
        const marks = [...group.querySelectorAll(":scope > g:not([id^=matplotlib]) use")].map(middle);
        return { marks, ticks: [...ticks.querySelectorAll("text")].map((t) => [t.textContent, ...middle(t)]) };
    }"""
    page.locator("figure img").first.click()
    before, other = page.evaluate(look, 0)["marks"], page.evaluate(look, 1)["marks"]
    page.mouse.move(*before[6])
    page.mouse.wheel(0, -400 * np.log(2))
    after = page.evaluate(look, 0)
    marks = np.array(after["marks"])
    np.testing.assert_allclose(marks[6], before[6], atol=1)
    np.testing.assert_allclose(np.diff(marks, axis=0), 2 * np.diff(before, axis=0), atol=0.5)
    across = [
        (float(text), place) for text, place, up in after["ticks"] if up > max(y for _, _, y in after["ticks"]) - 3
    ]
    assert len(across) >= 3
    np.testing.assert_allclose(
        [place for _, place in across], np.interp([v for v, _ in across], x, marks[:, 0]), atol=2
    )
    along = [(float(text), up) for text, _, up in after["ticks"] if up < max(y for _, _, y in after["ticks"]) - 3]
    assert pair[0].yaxis.get_offset_text().get_text() == "1e−6"
    np.testing.assert_allclose([up for _, up in along], [np.interp(10 * v, x, marks[:, 1]) for v, _ in along], atol=4)
    linked = np.array(page.evaluate(look, 1)["marks"])
    np.testing.assert_allclose(linked[:, 0], marks[:, 0], atol=0.5)
    np.testing.assert_allclose(linked[:, 1], np.array(other)[:, 1], atol=0.5)
    page.keyboard.press("0")
    np.testing.assert_allclose(page.evaluate(look, 0)["marks"], before, atol=0.01)
    page.locator("dialog button").click()
    page.locator("figure img").nth(1).click()
    before = page.evaluate(look, 0)["marks"]
    page.keyboard.press("+")
    after = page.evaluate(look, 0)
    np.testing.assert_allclose(np.array(after["marks"])[:, 1], np.array(before)[:, 1], atol=0.5)
    places = np.interp([np.log10(float(text)) for text, *_ in after["ticks"]], x - 5, np.array(after["marks"])[:, 0])
    np.testing.assert_allclose([place for _, place, _ in after["ticks"]], places, atol=3)
    page.close()
    assert faults == []


def test_quantities_of_a_loop_that_no_measured_one_covers_are_those_of_the_model() -> None:
    """A tensile test with short unloadings, and one that comes back."""
    text = "no measured loop covers the range"

    def hysteresis(ends: list[float]) -> str:
        parts = [np.linspace(a, b, 41)[1:] for a, b in itertools.pairwise([0.0, *ends])]
        u = np.concatenate([[0.0], *parts])
        y = np.asarray(simulate(BoucWen(c=0.2, mu=0.5, tau=0.05, rho=0.3), u)[0])
        fitted = fit(BoucWen(), Record(u=u, y=y + 0.02 * np.random.default_rng(5).standard_normal(u.size)), starts=1)
        return next(value for name, value in fitted.answer if name.startswith("Hysteresis"))

    assert text in hysteresis([10.0, 7.0, 20.0, 16.0, 30.0, 25.0])
    assert text not in hysteresis([10.0, -10.0, 20.0, -20.0, 30.0, -30.0])


def test_weights_that_are_zero_are_not_at_a_bound():
    u = np.tile(np.concatenate([np.linspace(0, 1, 60), np.linspace(1, 0, 60)[1:-1]]), 3)
    plays = np.zeros(u.size)
    for radius in (0.1, 0.3):
        state = u[0]
        for k, value in enumerate(u):
            state = min(max(state, value - radius), value + radius)
            plays[k] += state
    result = fit("prandtl-ishlinskii", Record(u, plays, u_unit="V", y_unit="um"))
    zeros = sum("[" in p.name and p.value == 0 for p in result.parameters if p.at_bound is not None)
    assert zeros > 1
    assert f"{zeros} weights are zero" in report.text_report(result)
