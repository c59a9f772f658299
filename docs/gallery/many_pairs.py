"""Many pairs from one table: each gets its verdict, and the one that cannot be registered stops nothing."""

import csv
import tempfile
from pathlib import Path

from scene import ORANGE, panels, save, write_band

import pcwlad_geo

SCENES = {"April": (1.2, 0.4), "June": (-0.7, 0.9), "August": (0.3, -1.1), "another place": (0.0, 0.0)}

with tempfile.TemporaryDirectory() as folder:
    lines = ["reference,target"]
    write_band(f"{folder}/red.tif", side=320)
    for name, shift in SCENES.items():
        seed = 12 if name == "another place" else 11
        write_band(f"{folder}/{name}.tif", "thermal", shift_px=shift, side=320, seed=seed)
        lines.append(f"red.tif,{name}.tif")
    table = Path(folder) / "pairs.csv"
    table.write_text("\n".join(lines))
    pcwlad_geo.batch(table, out_dir=Path(folder) / "out")
    with (Path(folder) / "out" / "summary.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))

figure, (axis,) = panels(["RMSE at check points of each pair, px"], height=2.6)
figure.set_size_inches(6, 2.6)
for place, row in enumerate(rows):
    rmse = float(row["rmse_px"] or 0)
    axis.barh(place, rmse, color=ORANGE)
    text = f" {rmse:.2f} px" if row["status"] == "registered" else " refused: no raster"
    axis.text(rmse, place, text, va="center")
axis.set_yticks(range(len(SCENES)), list(SCENES))
axis.set(xlim=(0, 0.3), ylim=(3.6, -0.6))
save(figure, __file__)
