"""`hystfit completion`: scripts that shells accept, with all verbs and the options of each."""

import shutil
import subprocess

import pytest

from hystfit.cli import run
from hystfit.cli.verbs import VERBS


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_scripts_name_every_verb(shell, tmp_path, capsys):
    assert run(["completion", shell]) == 0
    script = capsys.readouterr().out
    assert [verb for verb in VERBS if verb not in script] == []
    assert "test-window" in script
    if program := shutil.which(shell):
        (tmp_path / "script").write_text(script)
        subprocess.run([program, "-n", str(tmp_path / "script")], check=True)


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
def test_bash_completes_after_one_command(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv("XDG_DATA_HOME", raising=False)
    assert run(["completion", "bash", "--install"]) == 0
    (script,) = [path for path in tmp_path.rglob("hystfit") if path.is_file()]
    assert script.name in capsys.readouterr().out
    function = "$(complete -p hystfit | sed 's/.*-F *//; s/ .*//')"
    code = f"source {script}; COMP_WORDS=(hystfit fit --test-w); COMP_CWORD=2; {function}; echo ${{COMPREPLY[@]}}"
    done = subprocess.run(["bash", "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["--test-window"]
