"""The explorer: what its server answers and refuses, which samples it sends, and the page in a browser, with the command it gives."""

from __future__ import annotations

import http.client
import importlib
import json
import shlex
import signal
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import hystfit as hf
from hystfit.cli import run
from hystfit.errors import HystfitError
from hystfit.explorer import session as sessions
from hystfit.explorer.server import Server
from hystfit.explorer.session import Session, chunks, visible

from .conftest import ROOT

TRUTH = {"c": 0.2, "mu": 0.5, "tau": 0.05, "rho": 0.4}


@pytest.fixture(scope="module")
def record() -> hf.Record:
    """Three cycles of falling amplitude in noise."""
    t = np.arange(600) / 200
    u = 20 * (1 - np.cos(2 * np.pi * t)) * (1 - 0.2 * np.floor(t))
    y = hf.BoucWen(**TRUTH).free_run(u) + 0.01 * np.random.default_rng(3).standard_normal(t.size)
    return hf.Record(u, y, t=t, name="loop", u_unit="V", y_unit="um")


@pytest.fixture(scope="module")
def server(record) -> Iterator[Server]:
    running = Server(Session(record))
    running.open()
    yield running
    running.close()


def send(server: Server, name: str, body: object = None, path: str | None = None, **headers: str):
    """Status, headers and body of an answer; `body` as JSON, or as it is where it is bytes."""
    connection = http.client.HTTPConnection(*server.server_address, timeout=60)
    content = body if isinstance(body, bytes) else json.dumps(body).encode()
    path = f"/{server.token}/{name}" if path is None else path
    shown = {
        "Content-Type": "application/json",
        "Host": server.hosts[0],
        **{k.replace("_", "-"): v for k, v in headers.items()},
    }
    try:
        if body is None:
            connection.request("GET", path, headers=shown)
        else:
            connection.request("POST", path, content, shown)
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()
    finally:
        connection.close()


def ask(server: Server, name: str, body: object) -> dict:
    status, _, content = send(server, name, body)
    assert status == 200, content
    return json.loads(content)


def begun(server: Server) -> dict[str, float]:
    """Values of the sliders when the page opens."""
    return {slider["name"]: slider["value"] for slider in server.session.scene()["view"]["sliders"]}


def asked(server: Server, columns: int = 500, **more: object) -> dict:
    return {"view": 0, "values": begun(server), "from": None, "to": None, "columns": columns, **more}


# -- what the server refuses ---------------------------------------------------------------------------------------------------


def test_the_page_is_served_on_this_machine_alone_and_loads_nothing_else(server):
    assert server.server_address[0] == "127.0.0.1"
    status, headers, body = send(server, "")
    assert status == 200
    page = body.decode()
    assert "<title>loop - hystfit explorer</title>" in page
    assert "http" not in page.replace("http.server", "")
    policy = headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'")
    assert "unsafe" not in policy
    assert headers["Referrer-Policy"] == "no-referrer"
    assert "Access-Control-Allow-Origin" not in headers


def test_the_name_of_a_record_cannot_become_markup(record):
    scene = Session(record.replace(name="</script><script>alert(1)</script>"), "bouc-wen").scene()
    page = importlib.import_module("hystfit.explorer.server").document(scene)
    assert "<script>alert" not in page


@pytest.mark.parametrize("path", ["/", "/wrong/", "//", "/%2e%2e/", "/wrong/predict", "http://127.0.0.1/"])
def test_without_the_token_nothing_is_there(server, path):
    assert send(server, "", path=path)[0] == 404
    assert send(server, "", asked(server), path=path)[0] == 404


@pytest.mark.parametrize(
    "name", ["index.html", "../", "predict/../fit-state", "..%2f..%2fetc%2fpasswd", "choose", "?x=1"]
)
def test_with_the_token_nothing_but_the_page_and_its_questions_is_there(server, name):
    assert send(server, name)[0] == 404
    assert send(server, name, {})[0] == 404


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1", "127.0.0.1:1", "localhost.evil.example:80", ""])
def test_another_host_name_is_refused(server, host):
    """A page of another site whose name was made to resolve to this machine (DNS rebinding)."""
    assert send(server, "", Host=host)[0] == 403
    assert send(server, "fit-state", {}, Host=host)[0] == 403


@pytest.mark.parametrize(
    "headers",
    [
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Sec_Fetch_Site": "cross-site"},
        {"Sec_Fetch_Site": "same-site"},
        {"Content_Type": "text/plain"},
        {"Content_Type": "application/x-www-form-urlencoded"},
    ],
)
def test_a_question_from_another_page_is_refused(server, headers):
    assert send(server, "fit-state", {})[0] == 200
    assert send(server, "fit-state", {}, **headers)[0] == 403


@pytest.mark.parametrize(
    "body", [b"", b"{", b"[]", b"7", b'{"view": 0}', b'"x"', b"[" * 100_000, b"\xff\xfe", b'{"view": 1e999, "from": 0}']
)
def test_a_body_that_is_no_question_is_refused(server, body):
    assert send(server, "predict", body)[0] == 400


@pytest.mark.parametrize("length", [str(2**20 + 1), "9" * 5000, "-1", "many", ""])
def test_a_large_body_is_refused_unread(server, length):
    assert send(server, "predict", b"", Content_Length=length)[0] == 413


@pytest.mark.parametrize(
    "part", [{"view": 99}, {"columns": "many"}, {"from": "now"}, {"values": []}, {"band": 3}, {"columns": None}]
)
def test_a_question_with_wrong_parts_is_refused(server, part):
    assert send(server, "predict", asked(server, **part))[0] == 400


@pytest.mark.parametrize(
    "values",
    [
        {"mu": 1.5},
        {"tau": -1},
        {"rho": "high"},
        {"c": True},
        {"c": None},
        {"d": 1},
        {"c": float("nan")},
        {"c": 10**400},
    ],
)
def test_values_that_the_model_cannot_have_are_refused(server, values):
    question = asked(server)
    status, _, body = send(server, "predict", question | {"values": question["values"] | values})
    assert status == 422
    assert next(iter(values)) in json.loads(body)["error"]
    assert send(server, "fit", question | {"values": question["values"] | values, "fitted": []})[0] == 422


def test_a_model_that_the_page_does_not_offer_is_refused_and_its_file_not_run(server, tmp_path):
    trap = tmp_path / "trap.py"
    trap.write_text(f"open({str(tmp_path / 'sprung')!r}, 'w')\nclass Trap: pass\n")
    for model in ("no-model", f"{trap}:Trap", 3, None):
        assert send(server, "model", {"model": model})[0] == 422
    assert not (tmp_path / "sprung").exists()


def test_a_port_in_use_is_an_error_for_the_user(server, record):
    with pytest.raises(HystfitError, match="port"):
        Server(server.session, server.server_address[1])


# -- what the server answers -----------------------------------------------------------------------------------------------------


def curves(server: Server, name: str, question: dict) -> tuple[dict, list[np.ndarray]]:
    """Facts, and x, u, each curve, abscissa of the residuals and residuals, from their origins."""
    status, headers, body = send(server, name, question)
    assert status == 200, body
    facts = json.loads(headers["X-Facts"])
    sizes = [facts["points"]] * (2 + facts["curves"]) + [facts["columns"]] * 2
    numbers = np.frombuffer(body, "<f4")
    assert numbers.size == sum(sizes)
    return facts, np.split(numbers, np.cumsum(sizes)[:-1])


def test_curves_are_those_of_the_model(server, record):
    question = asked(server, band=[{"tau": 0.02}, {"tau": 0.1}])
    question["values"] = question["values"] | TRUTH
    facts, (x, u, middle, low, high, _, residuals) = curves(server, "predict", question)
    origin = server.session.scene()["record"]["origin"]
    of = lambda tau: np.asarray(hf.simulate(hf.BoucWen(**(question["values"] | {"tau": tau})), record.u)[0])
    np.testing.assert_allclose(x, record.t, rtol=1e-6)
    np.testing.assert_allclose(u + origin["u"], record.u, atol=1e-5)
    for curve, tau in ((middle, 0.05), (low, 0.02), (high, 0.1)):
        np.testing.assert_allclose(curve + origin["y"], of(tau), atol=1e-6)
    np.testing.assert_allclose(residuals, record.y - of(0.05), atol=1e-6)
    rms = np.sqrt(np.mean((record.y - of(0.05)) ** 2))
    assert facts["error"]["rmse"] == pytest.approx(rms, rel=1e-9)
    assert facts["error"]["nrmse_percent"] == pytest.approx(100 * rms / np.ptp(record.y), rel=1e-9)
    assert server.session.model.tau == 0.05


def test_a_part_has_the_samples_of_that_time(server, record):
    facts, (x, _, y, *_) = curves(server, "measured", asked(server, **{"from": 1.0, "to": 1.5}))
    inside = (record.t >= 1.0) & (record.t <= 1.5)
    assert facts["x"] == 1.0
    np.testing.assert_allclose(x + 1.0, record.t[inside], atol=1e-6)
    np.testing.assert_allclose(y + server.session.scene()["record"]["origin"]["y"], record.y[inside], atol=1e-5)
    for beyond in ({"from": 99.0, "to": 100.0}, {"from": -5.0, "to": -4.0}, {"from": 2.0, "to": 1.0}):
        assert curves(server, "measured", asked(server, **beyond))[0]["points"] == 2


@pytest.mark.parametrize("count", [7, 1000, 9_999, 10_000])
def test_few_samples_cover_the_pixels_of_all(count):
    """In every piece the lowest and the highest value of each signal are among the samples sent, and so are both ends."""
    generator = np.random.default_rng(count)
    first, second = np.cumsum(generator.standard_normal((2, count)), axis=1)
    second[generator.random(count) < 0.1] = np.nan
    starts = chunks(count, 100)
    kept = visible(starts, first, second)
    assert kept.size == count if count <= 200 else kept.size <= 600
    assert (np.diff(kept) > 0).all()
    for low, high in zip(starts, [*starts[1:], count], strict=True):
        inside = kept[(kept >= low) & (kept < high)]
        assert {low, high - 1} <= set(inside)
        for curve in (first, second):
            if not np.isnan(curve[low:high]).all():
                assert np.nanmin(curve[inside]) == np.nanmin(curve[low:high])
                assert np.nanmax(curve[inside]) == np.nanmax(curve[low:high])


def test_sliders_hold_their_values_and_stay_within_the_bounds(server):
    for model in ("bouc-wen", "duhem", "prandtl-ishlinskii", "preisach"):
        view = ask(server, "model", {"model": model})
        for slider in view["sliders"]:
            assert slider["low"] <= slider["value"] <= slider["high"]
            assert slider["lower"] is None or slider["lower"] <= slider["low"]
            assert slider["upper"] is None or slider["high"] <= slider["upper"]
    assert view["hidden"] == 495
    names = {slider["name"]: slider for slider in server.session.scene()["view"]["sliders"]}
    assert names["tau"]["logarithmic"]
    assert names["tau"]["unit"] == "1/V"
    assert (names["rho"]["low"], names["rho"]["high"]) == (-1, 1)
    assert not names["h0"]["fitted"]


def test_without_time_only_models_without_time_are_offered(record):
    choices = Session(record.replace(t=None)).choices
    assert "bouc-wen" in choices
    assert not [name for name in choices if "creep" in name or name == "oscillator"]


def test_a_fit_from_the_sliders_is_that_of_the_library(server, record):
    start = begun(server) | {"tau": 0.03, "rho": 0.25}
    state = ask(server, "fit", asked(server, values=start, fitted=["c", "mu", "tau", "h0", "offset"]))
    while state["state"] == "running":
        time.sleep(0.05)
        state = ask(server, "fit-state", {})
    result = hf.fit("bouc-wen", record, start=start, starts=1, fix=["rho"], free=["h0"])
    assert state["state"] == "done"
    assert state["result"]["status"] == result.status
    assert {slider["name"]: slider["value"] for slider in state["view"]["sliders"]} == result.values
    assert result.values["rho"] == 0.25


def test_one_fit_runs_at_a_time_and_a_failed_one_says_why(record, monkeypatch):
    session, blocked = Session(record, "bouc-wen"), threading.Event()

    def fail(*_, **__):
        blocked.wait(30)
        raise HystfitError("no luck")

    monkeypatch.setattr(sessions, "fit", fail)
    question = {"view": 0, "values": session.values, "fitted": ["c"]}
    assert session.start_fit(question)["state"] == "running"
    with pytest.raises(HystfitError, match="running"):
        session.start_fit(question)
    blocked.set()
    while session.fit_state()["state"] == "running":
        time.sleep(0.01)
    assert session.fit_state() == {"state": "failed", "error": "no luck"}


def test_starting_values_by_name_replace_those_of_the_data(record):
    named = hf.fit("bouc-wen", record, start={"tau": 0.03}, fix=["tau"], starts=1)
    assert named["tau"].value == 0.03
    assert named.values == hf.fit("bouc-wen", record, fix={"tau": 0.03}, starts=1).values
    for model, start in (
        ("bouc-wen", {"tua": 1.0}),
        ("bouc-wen", {"mu": 2.0}),
        ("prandtl-ishlinskii-search", {"r": 1.0}),
    ):
        with pytest.raises(HystfitError):
            hf.fit(model, record, start=start)


def test_in_python_the_page_is_an_object_that_closes(record):
    with hf.explore(record, model="bouc-wen", start={"tau": 0.03}) as page:
        assert page.url in page._repr_html_()
        assert page.model.tau == page.values["tau"] == 0.03
        assert page.result is None
        with urllib.request.urlopen(page.url, timeout=10) as answer:
            assert answer.status == 200
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(page.url, timeout=10)
    with pytest.raises(HystfitError, match="one record"):
        hf.explore([record, record.replace(name="other")])


# -- the command line ------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def loop(record, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("explorer") / "my loop.csv"
    rows = "\n".join(
        f"{t!r},{u!r},{y!r}" for t, u, y in zip(*(v.tolist() for v in (record.t, record.u, record.y)), strict=True)
    )
    path.write_text(f"clock,drive,answer\n{rows}\n")
    return path


@pytest.mark.parametrize(
    "arguments",
    [
        ["explore", "no such file"],
        ["explore", "stage-sine", "--model", "no-model"],
        ["explore", "stage-sine", "--at", "c"],
        ["explore", "stage-sine", "--model", "bouc-wen", "--at", "c=-1"],
        ["explore", "stage-sine", "--port", "99999999"],
        ["fit", "stage-sine", "--model", "bouc-wen", "--at", "tau=0.1", "--start", "model"],
        ["fit", "stage-sine", "--at", "tau=0.1"],
    ],
)
def test_bad_arguments_end_with_one_line(arguments, capsys):
    assert run(arguments) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.fixture(scope="module")
def command(loop) -> Iterator[str]:
    """Address of a page that the command serves; it ends by an interrupt, as a user ends it."""
    options = [
        "--no-browser",
        "--model",
        "bouc-wen",
        "--time",
        "clock",
        "--input",
        "drive",
        "--output",
        "answer",
        "--units",
        "V,um",
    ]
    program = [sys.executable, "-m", "hystfit", "explore", loop.name, *options]
    process = subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=loop.parent)
    line = process.stdout.readline()
    yield line.split()[-1]
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors == ""


@pytest.fixture
def page(browser) -> Iterator[object]:
    """A page whose console must stay empty."""
    context = browser.new_context(viewport={"width": 1280, "height": 850}, color_scheme="dark")
    opened = context.new_page()
    opened.set_default_timeout(60_000)
    faults: list[str] = []
    opened.on("console", lambda message: faults.append(message.text))
    opened.on("pageerror", lambda error: faults.append(str(error)))
    yield opened
    context.close()
    assert faults == []


def test_the_copied_command_and_code_give_the_numbers_of_the_page(page, command, loop, monkeypatch):
    page.goto(command)
    page.wait_for_selector("#error:not(:empty)")
    before, start = page.inner_text("#error"), page.evaluate("hystfitExplorer.state.values")
    for key in ("j", "j", "j", "PageUp", "ArrowRight"):
        page.keyboard.press(key)
    moved = page.evaluate("hystfitExplorer.state.values")
    assert moved["tau"] > 1.1 * start["tau"]
    page.wait_for_selector(f"#error:not(:text-is({json.dumps(before)}))")
    assert page.inner_text("#legend .lower").startswith("tau = ")
    assert page.inner_text("#legend .higher").startswith("tau = ")
    page.locator("#sliders .row", has_text="rho").get_by_role("checkbox").uncheck()
    page.keyboard.press("f")
    page.wait_for_selector("#verdict:not([hidden])")
    fitted = page.evaluate("hystfitExplorer.state.values")
    assert fitted["rho"] == moved["rho"]
    assert abs(fitted["mu"] - moved["mu"]) > 1e-6
    shell, python = (page.text_content(f"#{kind} pre") for kind in ("shell", "python"))
    page.keyboard.press("z")
    assert page.evaluate("hystfitExplorer.state.values") == moved
    monkeypatch.chdir(loop.parent)
    done = subprocess.run([sys.executable, "-m", *shlex.split(shell)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    saved = json.loads(Path("fit/result.json").read_text())["parameters"]
    assert {name: entry["value"] for name, entry in saved.items()} == pytest.approx(fitted, rel=1e-9)
    space: dict[str, hf.FitResult] = {}
    exec(python, space)
    assert space["result"].values == pytest.approx(fitted, rel=1e-9)


def test_models_zoom_and_typed_values_on_a_phone(page, command):
    page.set_viewport_size({"width": 390, "height": 850})
    page.goto(command)
    page.wait_for_selector("#error:not(:empty)")
    assert page.evaluate("document.documentElement.dataset.theme") == "dark"
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    page.select_option("#model", "duhem")
    page.wait_for_selector("#sliders .row >> nth=10")
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    page.locator("#series").scroll_into_view_if_needed()
    box = page.locator("#series").bounding_box()
    page.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 40)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.7 * box["width"], box["y"] + 40)
    page.mouse.up()
    start, end = page.evaluate("[hystfitExplorer.state.from, hystfitExplorer.state.to]")
    assert 0.2 < start < end < 2.8
    page.keyboard.press("Escape")
    assert page.evaluate("hystfitExplorer.state.from") is None
    page.keyboard.press("z")
    assert page.input_value("#model") == "bouc-wen"
    before = page.evaluate("hystfitExplorer.state.values")
    mu = page.locator("#sliders input[type=number]").nth(1)
    mu.fill("1.5")  # beyond its bound
    assert page.evaluate("hystfitExplorer.state.values") == before
    mu.fill("0.25")
    assert page.evaluate("hystfitExplorer.state.values") == before | {"mu": 0.25}


def test_the_page_without_a_server_simulates_as_the_library(page, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    demo = importlib.import_module("generate.explorer_demo")
    (tmp_path / "demo.html").write_text(demo.explorer_page(), encoding="utf-8")
    page.goto((tmp_path / "demo.html").as_uri())
    page.wait_for_selector("#error:not(:empty)")
    record = hf.datasets.load(demo.RECORD)
    values = page.evaluate("hystfitExplorer.state.values")
    jumps = np.random.default_rng(0).uniform(-50, 50, 300)
    changes = (
        {},
        {"rho": 1.0},
        {"rho": -1.0, "h0": -0.5},
        {"mu": 0.0},
        {"tau": 0.5, "h0": 0.7},
        {"tau": 0.0},
        {"c": 0.0},
    )
    for u in (record.u, jumps):
        for change in changes:
            chosen = values | change
            drawn = page.evaluate("([values, u]) => Array.from(simulateModel(values, u))", [chosen, u.tolist()])
            expected = hf.BoucWen(**chosen).free_run(u)
            np.testing.assert_allclose(drawn, expected, rtol=0, atol=1e-9 * np.ptp(expected) + 1e-12)
    rms = np.sqrt(np.mean((record.y - hf.BoucWen(**values).free_run(record.u)) ** 2))
    assert page.evaluate("hystfitExplorer.shown.model.facts.error.rmse") == pytest.approx(rms, rel=1e-9)
    page.keyboard.press("f")
    assert "hystfit explore" in page.inner_text("#message")
