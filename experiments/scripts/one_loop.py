"""One loop: read, check, fit, test on held-out samples, save. The same at the shell: hystfit fit FILE --test-window 6: --out FOLDER."""

import sys
from pathlib import Path

import hystfit as hf

hf.enable_x64()
FILE = Path(__file__).parents[2] / "data" / "stage_sweep.csv"
OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out/one_loop")

record = hf.read(FILE)
print(hf.check(record).text())

result = hf.fit("bouc-wen", record.window(None, 6.0), test=record.window(6.0), starts=1)
print(result)

OUT.mkdir(parents=True, exist_ok=True)
result.save(OUT)
for name in result.free_names:
    print(f"{name:12} {result[name].value:10.5g} +- {result[name].stderr:.2g} {result[name].unit}")
