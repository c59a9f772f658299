"""Two images of different places: refused, with the reason, instead of a wrong raster."""

import tempfile
from pathlib import Path

from scene import panels, read, save, show, write_band

import pcwlad_geo

with tempfile.TemporaryDirectory() as folder:
    red = write_band(f"{folder}/red.tif", side=320)
    elsewhere = write_band(f"{folder}/thermal.tif", "thermal", side=320, seed=12)
    outcome = "registered"
    try:
        pcwlad_geo.register(red, elsewhere, out_dir=Path(folder) / "out")
    except pcwlad_geo.RegistrationRejectedError as error:
        outcome = "refused: " + str(error).partition(": ")[0]
    images = read(red), read(elsewhere)

figure, axes = panels(["reference", "target: another place"], height=4.6)
for axis, image in zip(axes, images, strict=True):
    show(axis, image)
figure.supxlabel(outcome, fontsize=9, wrap=True)
save(figure, __file__)
