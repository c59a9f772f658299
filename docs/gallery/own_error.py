"""The tool's own error on a pair: the target is moved by known amounts and matched again."""

import tempfile
from pathlib import Path

import numpy as np
from scene import BLUE, ORANGE, panels, read, save, show, write_band

import pcwlad_geo

with tempfile.TemporaryDirectory() as folder:
    red = write_band(f"{folder}/red.tif", side=320)
    thermal = write_band(f"{folder}/thermal.tif", "thermal", side=320, shift_px=(0.4, -0.3))
    proof = pcwlad_geo.prove(red, thermal, out_dir=Path(folder) / "proof", search_radius=8)
    image = read(red)

title = f"error of each match: 90 % within {proof.ce90_px:.3f} px"
figure, (errors, along, where) = panels([title, "mean error by fraction of a pixel", "RMSE by place, px"])
errors_px = np.array([error for point in proof.map for error in point.errors_px])
limit, turn = 2.2 * proof.ce90_px, np.linspace(0, 2 * np.pi, 200)
errors.plot(*errors_px.T, ".", ms=3, color="0.5")
errors.plot(proof.ce90_px * np.cos(turn), proof.ce90_px * np.sin(turn), color=ORANGE)
errors.set(xlim=(-limit, limit), ylim=(limit, -limit), aspect="equal", xlabel="column, px", ylabel="row, px")

along.axhline(0, color="0.8")
for axis, (name, colour) in enumerate((("column", BLUE), ("row", ORANGE))):
    means = [entry.mean_px[axis] for entry in proof.phases]
    along.plot([entry.phase for entry in proof.phases], means, "o-", color=colour, label=name)
along.set(ylim=(-limit, limit), xlabel="fraction of the displacement, px")
along.legend(frameon=False)

show(where, image)
size = [np.sqrt(np.mean(np.square(point.errors_px))) for point in proof.map]
places = np.array([point.reference_px for point in proof.map])
points = where.scatter(*places.T, c=size, cmap="plasma", s=26, edgecolors="white")
figure.colorbar(points, ax=where, shrink=0.8)
save(figure, __file__)
