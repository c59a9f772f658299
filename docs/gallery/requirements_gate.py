"""A gate before delivery: a pair that does not meet what is required gets a report and no raster."""

import tempfile
from pathlib import Path

from scene import ORANGE, panels, save, write_band

import pcwlad_geo

LIMITS = ["coverage>=0.9", "CE90<=0.5px"]
with tempfile.TemporaryDirectory() as folder:
    red = write_band(f"{folder}/red.tif")
    done = {}
    for name, clouds in (("clear", 0.0), ("half under clouds", 0.5)):
        thermal = write_band(f"{folder}/{name}.tif", "thermal", shift_px=(1.4, -0.8), clouds=clouds)
        out = Path(folder) / f"{name} out"
        try:
            result = pcwlad_geo.register(red, thermal, require=LIMITS, features=1000, out_dir=out)
        except pcwlad_geo.RequirementError as error:
            result = error.registration
        raster = list(out.glob("*_registered.tif"))
        done[name] = result, "raster written" if raster else "no raster: exit status 4"

figure, (axis,) = panels(["coverage of the scene by tie points; required: 0.9"], height=2.4)
figure.set_size_inches(6.5, 2.2)
for place, (result, outcome) in enumerate(done.values()):
    coverage = next(r.value for r in result.requirements if "coverage" in r.requirement.text)
    axis.barh(place, coverage, color=ORANGE)
    axis.text(0.02, place, f"{coverage:.2f}: {outcome}", va="center")
axis.set_yticks(range(len(done)), list(done))
axis.axvline(0.9, color="black", ls="--")
axis.set(xlim=(0, 1))
save(figure, __file__)
