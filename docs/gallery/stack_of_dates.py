"""Many dates in one frame: every date gets its shift with a sigma; a wrong pair is found by its cycles."""

import tempfile
from pathlib import Path

import numpy as np
from matplotlib.dates import DateFormatter
from scene import BLUE, ORANGE, panels, save, write_band

import pcwlad_geo

DATES = ["2023-04-02", "2023-06-11", "2023-08-20", "2024-04-14", "2024-06-23"]
TRUE_PX = np.array([[0, 0], [0.4, -0.3], [-0.2, 0.5], [0.8, 0.1], [-0.6, -0.4]])

with tempfile.TemporaryDirectory() as folder:
    files = [
        write_band(
            f"{folder}/{'landsat' if k % 2 else 'sentinel'}_{date}.tif",
            "nir" if k % 2 else "red",
            shift_px=shift,
            side=320,
            clouds=0.1 * (k % 3 == 2),
        )
        for k, (date, shift) in enumerate(zip(DATES, TRUE_PX, strict=True))
    ]
    series = pcwlad_geo.stack(files, out_dir=Path(folder) / "stack", jobs=1)

figure, axes = panels(["Shift along columns, px", "Shift along rows, px"], height=3.0)
days = np.array(DATES, dtype="datetime64[D]")
for number, axis in enumerate(axes):
    shift = [image.shift_px[number] for image in series.images]
    error = [3 * image.sigma_px[number] for image in series.images]
    axis.plot(days, TRUE_PX[:, number], "o", ms=11, mfc="none", color=BLUE, label="truth")
    axis.errorbar(days, shift, error, fmt=".", color=ORANGE, label="measured, 3 sigma")
    axis.xaxis.set_major_formatter(DateFormatter("%Y-%m"))
    axis.tick_params(axis="x", rotation=30, labelsize=8)
axes[0].legend(fontsize=8)
save(figure, __file__)
