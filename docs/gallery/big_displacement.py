"""Georeferencing that is off by 75 pixels: the default looks for the shift when nothing agrees nearby."""

import tempfile
from pathlib import Path

import numpy as np
from scene import outline, panels, read, save, show, write_band

import pcwlad_geo

PART = np.s_[50:190, 195:335]

with tempfile.TemporaryDirectory() as folder:
    red = write_band(f"{folder}/red.tif")
    thermal = write_band(f"{folder}/thermal.tif", "thermal", shift_px=(63.4, -40.2))
    result = pcwlad_geo.register(red, thermal, out_dir=Path(folder) / "out")
    reference, before = read(red), read(thermal, like=red)
    after = read(f"{folder}/out/thermal_registered.tif", like=red)

rmse = result.accuracy["check_px"].rmse
figure, axes = panels(["before: 75 px off", f"after: {rmse:.2f} px at check points"])
for axis, thermal_on_red in zip(axes, (before, after), strict=True):
    show(axis, thermal_on_red, PART)
    outline(axis, reference)
figure.supxlabel("grey: thermal band on the red one's grid; orange: edges of the red band", fontsize=9)
save(figure, __file__)
