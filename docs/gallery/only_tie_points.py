"""Only measure: where the thermal band shows the ground, against what its georeferencing says."""

import sys

import numpy as np
from scene import BLUE, SAMPLE, arrows, panels, read, save, show

import pcwlad_geo

sys.path.insert(0, str(SAMPLE))
from make_sample_data import true_displacement_px

points = pcwlad_geo.match(SAMPLE / "landsat_b4.tif", SAMPLE / "landsat_b10.tif").select("matched")

truth = true_displacement_px(points.predicted_px)
rmse = np.sqrt(((points.displacement_px - truth) ** 2).sum(axis=1).mean())
titles = [f"{len(truth)} tie points", f"the truth: {rmse:.2f} px RMSE from the tie points"]
figure, axes = panels(titles)
for axis, vectors, color in zip(axes, (points.displacement_px, truth), (None, BLUE), strict=True):
    show(axis, read(SAMPLE / "landsat_b10.tif"))
    few = np.s_[::6]
    arrows(axis, points.target_px[few], vectors[few], 40, color or "#ff7a00")
figure.supxlabel("displacement of every sixth tie point, forty times as long", fontsize=9)
save(figure, __file__)
