"""`notebooks/run.py`: only complete runs are shown by the documentation."""

import os
import signal
import subprocess
import sys
import time

import pytest

from .conftest import ROOT

NOTEBOOK = "# %%\nprint('ran')\n# %%\nimport pathlib, time\npathlib.Path('reached').touch()\ntime.sleep(60)\n"
EXECUTE = (
    "import sys, pathlib; sys.path.insert(0, {folder!r}); import run, os, tempfile\n"
    "os.environ |= {{'IPYTHONDIR': {scratch!r}, 'JUPYTER_RUNTIME_DIR': tempfile.mkdtemp(prefix='hystfit-')}}\n"
    "run.execute(pathlib.Path('slow.py'), pathlib.Path('slow.ipynb'), 100)"
)


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_an_interrupted_notebook_is_kept_apart(tmp_path):
    (tmp_path / "slow.py").write_text(NOTEBOOK)
    (tmp_path / "slow.ipynb").write_text("the run before")
    code = EXECUTE.format(folder=str(ROOT / "notebooks"), scratch=str(tmp_path))
    process = subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
    patience = time.monotonic() + 60
    while not (tmp_path / "reached").exists() and time.monotonic() < patience:
        time.sleep(0.05)
    os.kill(process.pid, signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert "KeyboardInterrupt" in error
    assert (tmp_path / "slow.ipynb").read_text() == "the run before"
    assert "ran" in (tmp_path / "slow.partial.ipynb").read_text()
