"""Faults that `tests.hard.library_faults` puts into the library: that they can be put in, and that one without effect survives."""

from pathlib import Path

import pytest

from .hard import library_faults
from .hard.library_faults import Fault, faults, outcome, put_in


@pytest.mark.parametrize("fault", faults(), ids=lambda fault: f"{fault.module}: {fault.breaks}")
def test_faults_can_be_put_in(fault: Fault, tmp_path: Path) -> None:
    """Their text is in the module once, the module with the fault is still Python, and their tests exist."""
    sound = library_faults.place_of(fault).read_text(encoding="utf-8")
    copy = tmp_path / "hystfit" / fault.module
    copy.parent.mkdir(parents=True)
    copy.write_text(sound, encoding="utf-8")
    with put_in(fault, tmp_path):
        faulty = copy.read_text(encoding="utf-8")
        assert faulty != sound
        compile(faulty, copy, "exec")
    assert copy.read_text(encoding="utf-8") == sound
    assert all(Path(__file__).with_name(f"test_{name}.py").is_file() for name in fault.tests.split())


def test_what_no_test_notices_survives(tmp_path: Path) -> None:
    for name, text in {
        "hystfit/sums.py": "def total(a, b):\n    return a + b  # both\n",
        "tests/test_sums.py": "from hystfit.sums import total\n\n\ndef test_total():\n    assert total(1, 2) == 3\n",
        "hystfit/__init__.py": "",
    }.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert outcome(Fault("sums.py", "a + b", "a - b", "the sum", "sums"), tmp_path) == "tests/test_sums.py::test_total"
    assert outcome(Fault("sums.py", "# both", "# all", "nothing", "sums"), tmp_path) == ""
    with pytest.raises(LookupError, match="0 times"):
        outcome(Fault("sums.py", "a * b", "a - b", "nothing", "sums"), tmp_path)
