"""A target that is turned by two degrees, which its georeferencing does not know."""

import tempfile
from pathlib import Path

import numpy as np
from scene import outline, panels, read, save, show, write_band

import pcwlad_geo

PART = np.s_[20:140, 260:380]

with tempfile.TemporaryDirectory() as folder:
    red = write_band(f"{folder}/red.tif")
    thermal = write_band(f"{folder}/thermal.tif", "thermal", turn_deg=2.0, shift_px=(3.0, -2.0))
    result = pcwlad_geo.register(red, thermal, out_dir=Path(folder) / "out")
    reference, before = read(red), read(thermal, like=red)
    after = read(f"{folder}/out/thermal_registered.tif", like=red)

rmse = result.accuracy["check_px"].rmse
figure, axes = panels(["before: turned by 2°", f"after: {result.correction.name}, {rmse:.2f} px"])
for axis, thermal_on_red in zip(axes, (before, after), strict=True):
    show(axis, thermal_on_red, PART)
    outline(axis, reference)
figure.supxlabel("grey: thermal band on the red one's grid; orange: edges of the red band", fontsize=9)
save(figure, __file__)
