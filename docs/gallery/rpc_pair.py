"""A stereo pair of raw images with RPCs that disagree: adjusted together over a DEM, without a reference."""

import tempfile
from pathlib import Path

import numpy as np
from scene import BLUE, ORANGE, orthorectified, outline, panels, read, save, show, write_dem, write_raw

import pcwlad_geo

ERRORS_PX = np.array([[2.6, -1.8], [-2.2, 2.4]])
LEANS = ((0.02, 0.006), (-0.015, 0.01))  # px per metre of height: what one sees from the left, the other...
PART = (slice(110, 190), slice(120, 200))

with tempfile.TemporaryDirectory() as folder:
    dem = write_dem(Path(folder) / "dem.tif")
    raw = [
        write_raw(Path(folder) / f"pass_{number}.tif", dem, lean, error)
        for number, (lean, error) in enumerate(zip(LEANS, ERRORS_PX, strict=True), start=1)
    ]
    block = pcwlad_geo.stack(raw, out_dir=Path(folder) / "block", dem=dem, dem_vertical=0, jobs=1)
    after = [read(image.registered) for image in block.images]
    before = [orthorectified(path, dem, block.images[0].registered) for path in raw]

shifts = np.array([image.shift_px for image in block.images])
titles = ["before: image 2 (orange) over image 1", "after: adjusted together", "error of each RPC, px"]
figure, axes = panels(titles)
for axis, (first, second) in zip(axes, (before, after), strict=False):
    show(axis, first, PART)
    outline(axis, second)
for one, color, name in ((ERRORS_PX - ERRORS_PX.mean(axis=0), BLUE, "true"), (shifts, ORANGE, "measured")):
    size = 11 if name == "true" else 4
    axes[2].plot(*one.T, "o", ms=size, mfc="none" if size > 9 else color, mec=color, label=name)
left_px = float(np.hypot(*(shifts[1] - shifts[0] - ERRORS_PX[1] + ERRORS_PX[0])))
label = f"columns; the pair is right to {left_px:.3f} px"
axes[2].set(xlabel=label, ylabel="rows", xlim=(-4, 4), ylim=(4, -4), aspect="equal")
axes[2].legend(fontsize=8)
save(figure, __file__)
