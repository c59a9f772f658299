"""Quality of a stack: how well do its bands lie on each other? Nothing is corrected."""

import json
import tempfile
from pathlib import Path

from matplotlib.patches import Rectangle
from scene import panels, save, write_band

import pcwlad_geo

with tempfile.TemporaryDirectory() as folder:
    bands = {"red": (0.0, 0.0), "nir": (0.15, -0.1), "thermal": (0.5, 0.3)}
    files = [
        write_band(f"{folder}/{kind}.tif", kind, shift_px=shift, side=320) for kind, shift in bands.items()
    ]
    pcwlad_geo.qa(files, out_dir=Path(folder) / "qa")
    report = json.loads((Path(folder) / "qa" / "qa.json").read_text())

names = list(bands)
figure, (axis,) = panels(["CE90 of each pair, px; limit 0.5 px"])
figure.set_size_inches(4.6, 4.2)
axis.set(xlim=(-0.5, 2.5), ylim=(2.5, -0.5), xlabel="target", ylabel="reference")
axis.set_xticks(range(3), names)
axis.set_yticks(range(3), names, rotation=90, va="center")
for pair in report["pairs"]:
    at = names.index(pair["target"]), names.index(pair["reference"])
    ce90 = pair["displacement"]["px"]["radial"]["ce90"]
    color = "#bfe3c0" if ce90 <= 0.5 else "#f6b7a8"
    axis.add_patch(Rectangle((at[0] - 0.5, at[1] - 0.5), 1, 1, color=color))
    axis.text(*at, f"{ce90:.2f}", ha="center", va="center", fontsize=13)
save(figure, __file__)
