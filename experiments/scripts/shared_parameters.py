"""Many loops with shared parameters: records fitted together. The offset and the initial state belong to each record, the rest to all."""

from pathlib import Path

import hystfit as hf

hf.enable_x64()
DATA = Path(__file__).parents[2] / "data"

records = [hf.read(DATA / name).take(slice(None, None, 4)) for name in ("stage_sine.csv", "stage_sweep.csv")]
result = hf.fit("bouc-wen", records, starts=1)
print(result)
for record in records:
    print(
        f"{record.name:12} offset {result[f'offset@{record.name}'].value:+.4f} um, error {result.metrics(record).nrmse_percent:.3f} %"
    )
