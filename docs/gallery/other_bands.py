"""A finished registration on another band of the target: of other pixel size, without matching again."""

import tempfile
from pathlib import Path

import numpy as np
from scene import outline, panels, read, save, show, write_band

import pcwlad_geo

SHIFT_PX = (4.0, -3.0)

with tempfile.TemporaryDirectory() as folder:
    red = write_band(f"{folder}/red.tif", pixel_m=15, side=640)
    thermal = write_band(f"{folder}/thermal.tif", "thermal", side=320, shift_px=SHIFT_PX)
    finer = write_band(f"{folder}/pan.tif", "red", pixel_m=15, side=640, shift_px=np.multiply(2, SHIFT_PX))
    pcwlad_geo.register(red, thermal, out_dir=Path(folder) / "registration")
    pcwlad_geo.warp(Path(folder) / "registration", [finer], out_dir=Path(folder) / "stack")
    before, after = read(finer, like=red), read(f"{folder}/stack/pan_registered.tif", like=red)
    reference = read(red)

titles = ["panchromatic band before (15 m)", "after the registration\nfound with the thermal band (30 m)"]
figure, axes = panels(titles)
for axis, band in zip(axes, (before, after), strict=True):
    show(axis, band, np.s_[60:220, 440:600])
    outline(axis, reference)
figure.supxlabel(
    "grey: the panchromatic band on the reference's grid; orange: edges of the reference", fontsize=9
)
save(figure, __file__)
