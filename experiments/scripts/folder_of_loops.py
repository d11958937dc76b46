"""A folder: every file fitted on its own, one table. The same at the shell: hystfit batch 'FOLDER/*.csv' --model bouc-wen --out OUT."""

import sys
from pathlib import Path

import hystfit as hf

hf.enable_x64()
PATTERN = Path(__file__).parents[2] / "data" / "stage_s[iw]*.csv"
OUT = Path(sys.argv[1] if len(sys.argv) > 1 else "out/folder_of_loops")

OUT.mkdir(parents=True, exist_ok=True)
fits = hf.fit_many("bouc-wen", str(PATTERN), starts=1, folder=OUT / "run")  # resumes from this folder
print(fits)
fits.save(OUT / "fits.csv")
for row in fits.worst(3):
    print(f"{Path(row.name).name:20} {row.status:10} {row.error_percent or 0:.3f} %  {row.reason}")
