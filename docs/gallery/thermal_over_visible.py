"""Thermal over visible: a band of other contrast, off by 1.5 pixels, is laid on the red one."""

import tempfile
from pathlib import Path

import numpy as np
from scene import ORANGE, SAMPLE, panels, read, save, show

import pcwlad_geo

RED, THERMAL = SAMPLE / "landsat_b4.tif", SAMPLE / "landsat_b10.tif"
WOOD = np.s_[505:545, 10:50]

with tempfile.TemporaryDirectory() as folder:
    result = pcwlad_geo.register(RED, THERMAL, out_dir=Path(folder) / "out")
    after = read(Path(folder) / "out" / "landsat_b10_registered.tif", like=RED)

rmse = result.accuracy["check_px"].rmse
figure, axes = panels(["before: 1.5 px off", f"after: {rmse:.2f} px at check points"])
for axis, thermal in zip(axes, (read(THERMAL, like=RED), after), strict=True):
    show(axis, read(RED), WOOD)
    cold, warm = np.nanpercentile(thermal[WOOD], (2, 98))
    centres = np.arange(700) + 0.5
    axis.contour(centres, centres, thermal, levels=[(cold + warm) / 2], colors=ORANGE, linewidths=2)
figure.supxlabel("grey: red band; orange: boundary between cold and warm in the thermal band", fontsize=9)
save(figure, __file__)
