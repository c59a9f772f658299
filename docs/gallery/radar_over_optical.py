"""Radar over an optical image: speckle, and another backscatter of each land cover; their borders agree."""

import tempfile
from pathlib import Path

import numpy as np
from scene import ground, outline, panels, read, save, show, write_band, write_values

import pcwlad_geo

OFF_PX, SIDE = (6.3, -4.4), 400
BACKSCATTER_DB = np.array([-12, -14, -8.5, -10, -3, -19, -23])  # from crop to road and water
TOWN = np.s_[110:230, 90:210]

with tempfile.TemporaryDirectory() as folder:
    optical, radar = write_band(Path(folder) / "red.tif"), Path(folder) / "radar.tif"
    centres = (np.arange(2 * SIDE) + 0.5) / 2
    cover = ground((centres - OFF_PX[0])[None] * 30.0, -(centres - OFF_PX[1])[:, None] * 30.0, 11).cover
    power = (10 ** (BACKSCATTER_DB[cover] / 10)).reshape(SIDE, 2, SIDE, 2).mean(axis=(1, 3))
    speckled = power * np.random.default_rng(1).gamma(4, 1 / 4, power.shape)  # four looks
    write_values(radar, (10 * np.log10(speckled)).astype("float32"))
    result = pcwlad_geo.register(optical, radar, out_dir=Path(folder) / "out")
    seen = [read(path, like=optical) for path in (radar, Path(folder) / "out" / "radar_registered.tif")]
    red = read(optical)

points = result.tie_points.select("fit", "check")
error = points.displacement_px - OFF_PX
rmse = np.sqrt((error**2).sum(axis=1).mean())
figure, axes = panels(
    [f"before: {np.hypot(*OFF_PX):.1f} px off", f"after: {len(points)} points, {rmse:.2f} px"]
)
for axis, image in zip(axes, seen, strict=True):
    show(axis, image, TOWN)
    outline(axis, red, 0.45)
figure.supxlabel("grey: radar, 4 looks; orange: edges of the red band", fontsize=9)
save(figure, __file__)
