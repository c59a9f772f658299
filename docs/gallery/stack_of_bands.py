"""The bands of a product in one frame: how each lies, and how well any two of them fit each other."""

import tempfile
from pathlib import Path

import numpy as np
from scene import panels, save, write_band

import pcwlad_geo

BANDS = {"B4 red": (0.0, 0.0), "B5 nir": (0.12, -0.08), "B10 thermal": (0.45, 0.30), "B4 again": (0.03, 0.05)}

with tempfile.TemporaryDirectory() as folder:
    files = [
        write_band(f"{folder}/{name}.tif", kind, shift_px=shift, side=320)
        for (name, shift), kind in zip(BANDS.items(), ("red", "nir", "thermal", "red"), strict=True)
    ]
    bands = pcwlad_geo.stack(files, out_dir=Path(folder) / "stack", model="shift", jobs=1)

count, names = len(files), list(BANDS)
apart, sigma = np.zeros((count, count)), np.zeros((count, count))
middle = np.array([[160.0, 160.0]])
for one in range(count):
    for other in range(count):
        shifts = [bands.adjustment.displacement(band, middle)[0] for band in (one, other)]
        apart[one, other] = np.hypot(*(shifts[1] - shifts[0]))
        sigma[one, other] = np.sqrt(np.trace(bands.adjustment.covariance(one, middle, other)[0]) / 2)

figure, axes = panels(["distance of two bands, px", "its sigma along an axis, px"], height=4.0)
for axis, values in zip(axes, (apart, sigma), strict=True):
    axis.imshow(values, cmap="Oranges", vmax=1.6 * values.max())
    for (row, col), value in np.ndenumerate(values):
        axis.text(col, row, f"{value:.3f}" if row != col else "", ha="center", va="center")
    axis.set_xticks(range(count), names, rotation=30, fontsize=8)
    axis.set_yticks(range(count), names, fontsize=8)
save(figure, __file__)
