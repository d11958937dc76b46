"""One loop: read, check, fit, test on held-out samples, save. The same at the shell: hystfit fit FILE --test-window 6: --out FOLDER."""

import sys
from pathlib import Path

import hystfit as hf

hf.enable_x64()
FILE = Path(__file__).parents[2] / "data" / "stage_sweep.csv"
MODEL = "bouc-wen"  # hf.check proposes one for your loop
# Samples before it are fitted, the others test the fit: seconds, or a sample number where the file has no time.
SPLIT = 6.0
OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out/one_loop")

record = hf.read(FILE)
print(hf.check(record).text())

result = hf.fit(MODEL, record.window(None, SPLIT), test=record.window(SPLIT), starts=1)
print(result)

OUT.mkdir(parents=True, exist_ok=True)
result.save(OUT)
for name in result.free_names:
    one = result[name]
    error = (
        "-" if one.stderr is None else f"{one.stderr:.2g}"
    )  # None at a bound, and where the data do not determine it
    print(f"{name:12} {one.value:10.5g} +- {error} {one.unit}")
