"""Clouds: a mask keeps them out of the matching, and the report says where nothing is known."""

import tempfile
from pathlib import Path

import numpy as np
import rasterio
from scene import ORANGE, cloud_cover, panels, read, save, show, write_band

import pcwlad_geo

SIDE, SHARE = 400, 0.3

with tempfile.TemporaryDirectory() as folder:
    red = write_band(f"{folder}/red.tif", side=SIDE)
    thermal = write_band(f"{folder}/thermal.tif", "thermal", side=SIDE, shift_px=(1.4, -0.8), clouds=SHARE)
    mask = Path(folder) / "mask.tif"  # 0 = excluded
    with rasterio.open(red) as like, rasterio.open(mask, "w", **{**like.profile, "nodata": None}) as file:
        file.write(np.where(cloud_cover(SIDE, SHARE), 0, 1).astype("uint16"), 1)
    points = pcwlad_geo.match(red, thermal, tgt_mask=mask).select("matched")
    image = read(thermal)

figure, axes = panels(["thermal band; dark: cold clouds", f"{len(points)} tie points, none on a cloud"])
show(axes[0], image)
show(axes[1], np.where(cloud_cover(SIDE, SHARE), np.nan, image))
axes[1].set_facecolor("#b9d2e8")
axes[1].plot(*points.target_px.T, ".", color=ORANGE, ms=3)
figure.supxlabel("blue: excluded by the mask", fontsize=9)
save(figure, __file__)
