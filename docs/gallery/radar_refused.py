"""Radar over an optical image of a coast with nothing on it but forest and sea: refused, with the reason."""

import tempfile
from pathlib import Path

import numpy as np
from scene import ndimage, panels, read, save, show, write_values

import pcwlad_geo

SIDE, OFF_PX = 320, (6.3, -4.4)
row, col = np.indices((SIDE, SIDE)) + 0.5
rng = np.random.default_rng(2)
is_sea = col > 150 + 0.25 * row
sea_seen = col - OFF_PX[0] > 150 + 0.25 * (row - OFF_PX[1])
forest = ndimage.gaussian_filter(rng.standard_normal((SIDE, SIDE)), 1.5)
red = np.where(is_sea, 3000.0, 9000 + 4000 * forest) + 60 * rng.standard_normal((SIDE, SIDE))
power = np.where(sea_seen, 10**-1.9, 10**-0.85) * rng.gamma(4, 1 / 4, (SIDE, SIDE))  # four looks
with tempfile.TemporaryDirectory() as folder:
    optical = write_values(Path(folder) / "red.tif", red.astype("float32"))
    radar = write_values(Path(folder) / "radar.tif", (10 * np.log10(power)).astype("float32"))
    outcome = "registered"
    try:
        pcwlad_geo.register(optical, radar, out_dir=Path(folder) / "out")
    except pcwlad_geo.RegistrationRejectedError as error:
        outcome = "refused: " + str(error).partition(": ")[0]
    images = read(optical), read(radar)
figure, axes = panels(["reference: red light", "target: radar, 4 looks"], height=4.6)
for axis, image in zip(axes, images, strict=True):
    show(axis, image, np.s_[60:220, 90:250])
figure.supxlabel(outcome, fontsize=9, wrap=True)
save(figure, __file__)
