"""The command line as users run it: real processes in a fresh environment, and what every verb prints and writes."""

import dataclasses
import itertools
import json
import os
import platform
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hystfit import cli
from hystfit.config import PROGRAM_FOLDER

MAIN = [sys.executable, "-c", "from hystfit.cli import main; main()"]
STARTED = [*MAIN[:2], "import sys; from hystfit.cli import main; print('started', file=sys.stderr, flush=True); main()"]
CACHE = "JAX_COMPILATION_CACHE_DIR"
TRUTH = {"c": 0.2, "mu": 0.5, "tau": 0.05, "rho": 0.4}


@pytest.fixture(scope="module")
def home(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("home")


@pytest.fixture(scope="module")
def process(home):
    """Run `hystfit` with a home folder of its own and no variable of JAX or XLA."""
    env = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_", "XLA_", "XDG_", "HYSTFIT_"))}
    env |= {"HOME": str(home), "USERPROFILE": str(home), "LOCALAPPDATA": str(home), "MPLCONFIGDIR": str(home)}

    def run(*arguments, env_more=None, **options) -> subprocess.CompletedProcess:
        words = [str(argument) for argument in arguments]
        options = {"capture_output": True, "text": True, "timeout": 300, "cwd": home, **options}
        return subprocess.run([*MAIN, *words], env=env | (env_more or {}), **options)

    return run


@pytest.fixture(scope="module")
def folder(home) -> Path:
    """A noisy Bouc-Wen loop, a reference, and a record without a loop."""
    t = np.arange(160) / 80
    u = 20 * (1 - np.cos(2 * np.pi * t)) * (1 - 0.2 * np.floor(t))
    c, mu, tau, delta = TRUTH["c"], TRUTH["mu"], TRUTH["tau"], TRUTH["tau"] * TRUTH["rho"]
    h, y = 0.0, [c * u[0]]
    for before, after in itertools.pairwise(u):
        dv = (after - before) / 100
        for _ in range(100):
            h += mu * c * dv - tau * abs(dv) * h - delta * dv * abs(h)
        y.append(c * after - h)
    noisy = np.array(y) + 0.01 * np.random.default_rng(3).standard_normal(t.size)
    tables = {"loop": ("t_s,u_V,y_um", (t, u, noisy)), "reference": ("t_s,y_um", (t, 2 - 0.8 * np.cos(6 * t)))}
    tables["up"] = ("u,y", (np.arange(40.0), 2 * np.arange(40.0) + 1))
    for name, (head, columns) in tables.items():
        np.savetxt(home / f"{name}.csv", np.column_stack(columns), delimiter=",", header=head, comments="")
    return home


@pytest.fixture(scope="module")
def fitted(process, folder) -> Path:
    done = process("fit", "loop.csv", "--model", "bouc-wen", "--starts", "1", "--out", "fit")
    assert (done.returncode, done.stderr) == (0, "")
    return folder / "fit"


@dataclasses.dataclass(frozen=True)
class Ended:
    """What a command in this process left."""

    status: int
    out: str
    err: str


@pytest.fixture
def here(fitted, folder, monkeypatch, capsys) -> Callable[..., Ended]:
    """Run a command in this process, in the folder of the loops and of the fit."""
    monkeypatch.chdir(folder)

    def run(*arguments: str) -> Ended:
        capsys.readouterr()
        return Ended(cli.run(arguments), *capsys.readouterr())

    return run


def test_fit_finds_the_truth(fitted):
    content = json.loads((fitted / "result.json").read_text())
    assert (content["schema"], content["status"]) == ("hystfit.fit/3", "ok")
    for name, truth in TRUTH.items():
        found = content["parameters"][name]
        assert abs(found["value"] - truth) < 5 * found["stderr"] < truth


REFERENCE = ["reference.csv", "--output", "y_um", "--time", "t_s"]
VERBS = [  # arguments, exit status, status in result.json, files beside it
    (["check", "up.csv"], 1, "no-model", {"check.txt"}),
    (["check", "up.csv", "--preisach"], 1, "no-model", {"check.txt"}),
    (["predict", "fit", "loop.csv"], 0, "ok", {"prediction.csv", "prediction.png"}),
    (["invert", "fit", *REFERENCE], 0, "ok", {"inverse.csv", "report.html"}),
    (["invert", "fit", *REFERENCE, "--limits", "0:10"], 1, "missed", {"inverse.csv", "report.html"}),
    (["errors", "fit"], 0, "ok", {"errors.txt"}),
    (["profile", "fit", "--parameter", "tau"], 0, "ok", {"profiles.png", "report.html"}),
    pytest.param(
        ["sample", "fit", "--noise", "iid", "--chains", "2", "--draws", "10", "--warmup", "60"],
        1,
        "not-converged",
        {
            "posterior.nc",
            "corner.png",
            "trace.png",
            "rank.png",
            "bands.png",
            "report.html",
            "fit",
            "run",
            "manifest.json",
        },
        marks=pytest.mark.slow,
    ),
]


@pytest.mark.parametrize(
    ("arguments", "code", "status", "files"),
    VERBS,
    ids=lambda value: str(sorted(value) if isinstance(value, set) else value)[:30],
)
def test_verbs_print_json_and_write_their_folder(arguments, code, status, files, here, tmp_path):
    out = tmp_path / "out"
    done = here(*arguments, "--out", str(out), "--json")
    assert done.status == code
    assert all(": " in line and " %, " in line for line in done.err.splitlines())  # progress where it takes seconds
    content = json.loads(done.out)
    assert content == json.loads((out / "result.json").read_text())
    assert content["schema"].partition("/")[0] == f"hystfit.{arguments[0]}"
    assert content["status"] == status
    assert {path.name for path in out.iterdir()} == files | {"result.json"}


def test_a_command_in_a_process_says_nothing_beside_its_result(process, fitted):
    done = process("predict", fitted, "loop.csv", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["status"] == "ok"
    done = process("check", "nofile.csv")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("hystfit: ")


def test_report_and_export(here, fitted, tmp_path):
    done = here("report", str(fitted), "--out", str(tmp_path / "again"))
    assert (done.status, done.err) == (0, "")
    title, _, rest = (fitted / "report.txt").read_text().strip().partition("\nVerdict\n")
    assert rest
    assert title.splitlines()[0] in done.out
    assert rest in done.out
    assert f"hystfit predict {fitted}" in " ".join(done.out.split())  # the folder as it was typed
    assert (tmp_path / "again" / "report.html").is_file()
    done = here("export", str(fitted), "--c", str(tmp_path / "c"), "--name", "stack")
    assert (done.status, done.err) == (0, "")
    assert sorted(file.name for file in (tmp_path / "c").iterdir()) == ["stack.c", "stack.h", "stack_main.c"]


BAD = [
    (["profile", "fit", "--noise", "magic"], "'magic'"),
    (["sample", "fit", "--sampler", "magic"], "'magic'"),
]


@pytest.mark.usefixtures("as_users_run")
@pytest.mark.parametrize(("arguments", "name"), BAD, ids=[" ".join(arguments) for arguments, _ in BAD])
def test_bad_input_is_status_2(arguments, name, here):
    done = here(*arguments)
    assert (done.status, done.out) == (2, "")
    assert done.err.startswith("hystfit: ")
    assert name in done.err


# -- what the process sets up before JAX is imported ---------------------------------------------------------------------

SPY = """import json, os, jax, pathlib
from jax._src import xla_bridge
import hystfit

state = {"flags": os.environ.get("XLA_FLAGS"), "x64": jax.config.jax_enable_x64, "late": bool(xla_bridge._backends)}
pathlib.Path("state.json").write_text(json.dumps(state))


class Mine(hystfit.BoucWen):
    pass
"""


def test_a_verb_computes_in_double_precision_with_whole_loops(process, tmp_path):
    """A model file shows what XLA will read: no backend has started when a verb imports it."""
    (tmp_path / "mine.py").write_text(SPY)
    done = process("models", "mine.py:Mine", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    state = json.loads((tmp_path / "state.json").read_text())
    assert (state["x64"], state["late"]) == (True, False)
    assert "small_while_loop_byte_threshold" in state["flags"]


def test_compiled_programs_are_kept_for_the_next_command(fitted, home):
    assert list((home / ".cache" / "hystfit" / "programs").rglob("*-cache")) or sys.platform != "linux"


def test_a_command_that_was_killed_while_it_kept_a_program_spoils_no_later_one(process, folder, tmp_path):
    """JAX looks for the time of use of every program before it keeps another, and warns for each that it cannot keep."""
    programs = tmp_path / "cache" / "hystfit" / "programs" / (platform.node() or "here")
    programs.mkdir(parents=True)
    (programs / "jit_half-cache").write_bytes(b"half")
    more = {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    done = process("fit", "stage-sine", "--model", "bouc-wen", "--starts", "1", env_more=more)
    assert done.returncode == 0, done.stderr
    assert "arning" not in done.stderr
    assert not (programs / "jit_half-cache").exists()
    assert sys.platform != "linux" or list(programs.glob("*-cache"))


@pytest.mark.parametrize(
    ("chosen", "traced"), [("elsewhere", str(Path("elsewhere") / "traced")), ("gs://bucket", None)]
)
def test_a_cache_folder_that_the_user_chose_is_used(monkeypatch, chosen, traced):
    """Traced programs, without which half of the time of a fit is tracing, are kept in it where it is a folder."""
    monkeypatch.setenv(CACHE, chosen)
    monkeypatch.setenv(PROGRAM_FOLDER, "removed at the end")
    monkeypatch.delenv(PROGRAM_FOLDER)
    cli.keep_programs()
    assert os.environ[CACHE] == chosen
    assert os.environ.get(PROGRAM_FOLDER) == traced


def test_without_a_cache_folder_commands_still_run(process, tmp_path):
    (tmp_path / "home").touch()
    more = {"HOME": str(tmp_path / "home"), "XDG_CACHE_HOME": str(tmp_path / "home" / "cache")}
    assert process("datasets", env_more=more).returncode == 0


def test_help_and_the_list_of_models_start_without_the_numerical_libraries():
    code = (
        "import sys, hystfit\nfrom hystfit.cli import run\nassert run(['--help']) == 0\nassert run(['models']) == 0\n"
        "heavy = {'jax', 'numpy', 'scipy', 'matplotlib', 'equinox'} & set(sys.modules)\nassert not heavy, heavy"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert all(verb in done.stdout for verb in cli.VERBS)
    assert "bouc-wen" in done.stdout


def test_a_reader_that_stops_early_changes_no_status(process, folder):
    reader, writer = os.pipe()
    os.close(reader)
    for arguments, status in ((["check", "up.csv"], 1), (["models"], 0)):
        done = process(*arguments, capture_output=False, stdout=writer, stderr=subprocess.PIPE)
        assert (done.returncode, done.stderr) == (status, "")
    os.close(writer)


def test_interrupt_from_the_keyboard(folder, tmp_path):
    before = signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # a shell's background jobs ignore it, and pass that on
    try:
        running = subprocess.Popen(
            [*STARTED, "fit", str(folder / "loop.csv"), "--model", "duhem", "--starts", "64", "--out", "out"],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=tmp_path,
        )
    finally:
        signal.signal(signal.SIGINT, before)
    assert running.stderr.readline() == "started\n"  # its imports take seconds on a busy machine
    time.sleep(1.5)
    running.send_signal(signal.SIGINT)
    out, err = running.communicate(timeout=60)
    assert running.returncode == 130, err
    assert "interrupted" in err
    assert "Traceback" not in err
    assert out == ""
    assert list(tmp_path.iterdir()) == []


def test_the_command_ends_without_taking_modules_down():
    code = """
import atexit, sys
from hystfit.cli import main
class Kept:
    def __del__(self): print("taken down")
kept = Kept()
atexit.register(print, "before the command")
class Late:
    def find_spec(self, *_):
        atexit.register(print, "imported by it")
        sys.meta_path.remove(self)
sys.meta_path.insert(0, Late())
sys.argv[1:] = ["data-sets"]
main()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 2
    assert (done.stdout, "hystfit:" in done.stderr) == ("imported by it\n", True)


_FAULTS = """
import resource
import numpy as np
from hystfit.config import keep_freed_memory
def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(20):
        np.ones(2**22)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
before = faults()
keep_freed_memory()
faults()  # the heap grows
print(faults() / before)
"""


def test_arrays_of_a_command_use_memory_that_others_freed():
    """By page faults: none where the C library has the setting, and no more than before elsewhere."""
    ended = subprocess.run([sys.executable, "-c", _FAULTS], capture_output=True, text=True, check=True)
    assert float(ended.stdout) < (0.1 if sys.platform == "linux" else 1.1)
