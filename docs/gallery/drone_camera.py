"""A drone's camera with three lenses, learned from three captures: each becomes one raster."""

import sys
import tempfile
import warnings
from pathlib import Path

import numpy as np
import rasterio
from rasterio.errors import NotGeoreferencedWarning
from scene import REPOSITORY, panels, read, save, stretched

import pcwlad_geo

sys.path.insert(0, str(REPOSITORY))  # synthetic captures: lenses, heights and relief are known
from benchmarks.rig_scenes import Ground, flight, made_rig, write_capture

PART = np.s_[40:300, 140:500]
warnings.simplefilter("ignore", NotGeoreferencedWarning)

with tempfile.TemporaryDirectory() as folder:
    ground, lenses, raw = Ground.made(3, side=2048), made_rig(3)[1:4], Path(folder) / "raw"
    for number, flown in enumerate(flight(3, 3, ground, heights_m=(30.0, 60.0))):
        write_capture(raw, f"C_{number}", lenses, flown, ground, seed=number, height=True)
    rig = pcwlad_geo.rig_learn([raw], jobs=1)
    pcwlad_geo.rig_apply(rig, [raw], out_dir=Path(folder) / "bands", jobs=1)
    before = [read(raw / f"C_0_{number}.tif") for number in (3, 2, 1)]
    with rasterio.open(Path(folder) / "bands" / "C_0.tif") as file:
        after = [
            file.read(file.descriptions.index(name) + 1).astype(float) for name in ("NIR", "Red", "Green")
        ]

figure, axes = panels(["the raw frames", f"one raster; residual {rig.residual_px:.2f} px"])
for axis, bands in zip(axes, (before, after), strict=True):
    axis.imshow(np.dstack([stretched(band[PART]) for band in bands]))
    axis.set(xticks=[], yticks=[])
figure.supxlabel("near infrared, red and green of one capture", fontsize=9)
save(figure, __file__)
