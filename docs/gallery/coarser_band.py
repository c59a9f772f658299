"""A band of three times the pixel size: compared on its own pixels, tie points good to a part of them."""

import tempfile

import numpy as np
from scene import arrows, panels, read, save, show, write_band

import pcwlad_geo

TRUE_SHIFT_PX = np.array([0.6, -0.4])

with tempfile.TemporaryDirectory() as folder:
    fine = write_band(f"{folder}/fine.tif", pixel_m=10, side=660)
    coarse = write_band(f"{folder}/coarse.tif", "thermal", pixel_m=30, side=220, shift_px=TRUE_SHIFT_PX)
    points = pcwlad_geo.match(fine, coarse).select("matched")
    images = read(fine), read(coarse)

off = points.displacement_px.mean(axis=0) - TRUE_SHIFT_PX
error = f"mean error of the tie points ({off[0]:+.2f}, {off[1]:+.2f}) px"
figure, axes = panels(["reference: red, 10 m (part)", f"target: thermal, 30 m (part)\n{error}"])
show(axes[0], images[0], np.s_[180:480, 180:480])
show(axes[1], images[1], np.s_[60:160, 60:160])
arrows(axes[1], points.target_px, points.displacement_px, times=10)
axes[1].set(xlim=(60, 160), ylim=(160, 60))
figure.supxlabel("arrows: displacement of the tie points, ten times as long", fontsize=9)
save(figure, __file__)
