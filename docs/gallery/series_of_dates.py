"""A series over time: from the sixth date on, a new processing baseline places the images elsewhere."""

import tempfile
from pathlib import Path

import numpy as np
from matplotlib.dates import DateFormatter
from scene import BLUE, ORANGE, panels, save, write_band

import pcwlad_geo

DAYS = np.datetime64("2024-01-04") + 30 * np.arange(10)
STEP_PX = np.array([0.6, -0.4])
random = np.random.default_rng(4)
true_px = 0.05 * random.normal(size=(10, 2)) + np.where(np.arange(10)[:, None] < 5, 0.0, STEP_PX)

with tempfile.TemporaryDirectory() as folder:
    files = [
        write_band(f"{folder}/S2A_{str(day).replace('-', '')}.tif", shift_px=shift, side=200)
        for day, shift in zip(DAYS, true_px, strict=True)
    ]
    options = {"window": 41, "template": 61, "features": 60, "jobs": 1}
    pcwlad_geo.stack(files, out_dir=Path(folder) / "stack", max_pairs=12, **options)
    (series,) = pcwlad_geo.watch(Path(folder) / "stack", out_dir=Path(folder) / "watch").series

figure, axes = panels(["Displacement along columns, px", "Displacement along rows, px"], height=3.0)
bars_px = [3 * image.sigma_px for image in series.images]
for number, axis in enumerate(axes):
    shifts = [image.shift_px[number] for image in series.images]
    axis.errorbar(DAYS, shifts, bars_px, fmt=".", color=ORANGE, label="image, 3 sigma")
    model = [image.expected_px[number] for image in series.images]
    axis.step(DAYS, model, where="post", color=BLUE, label="model")
    for step in series.steps:
        size = f"step {step.size_px[number]:+.2f} px"
        axis.axvline(np.datetime64(step.date), ls="--", color=BLUE, label=size)
    axis.xaxis.set_major_formatter(DateFormatter("%Y-%m"))
    axis.tick_params(axis="x", rotation=30, labelsize=8)
    axis.legend(fontsize=8)
save(figure, __file__)
