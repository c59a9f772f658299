"""Two terrain models of one ground: registered by their relief; what is left is the bias of their heights."""

import tempfile
from pathlib import Path

import numpy as np
from scene import ground, panels, read, save, write_values

import pcwlad_geo

OFF_PX, BIAS_M, NOISE_M, SIDE, PIXEL_M = (-3.0, -5.0), 7.0, 0.5, 400, 30.0


def write_heights(path: Path, off_px: tuple = (0.0, 0.0), bias_m: float = 0.0, seed: int = 0) -> Path:
    """Write the heights of the landscape, seen `off_px` (col, row) beside where the file says."""
    at = np.arange(SIDE) + 0.5
    x, y = (at - off_px[0])[None] * PIXEL_M, -(at - off_px[1])[:, None] * PIXEL_M
    noise = np.random.default_rng(seed).normal(0, NOISE_M, (SIDE, SIDE))
    heights = ground(x, y, 11).height + bias_m + noise
    return write_values(path, heights.astype("float32"), pixel_m=PIXEL_M, nodata=-9999.0)


with tempfile.TemporaryDirectory() as folder:
    old = write_heights(Path(folder) / "old.tif")
    new = write_heights(Path(folder) / "new.tif", OFF_PX, BIAS_M, seed=1)
    pcwlad_geo.register(old, new, out_dir=Path(folder) / "out")
    after = Path(folder) / "out" / "new_registered.tif"
    differences = [read(path, like=old) - read(old) for path in (new, after)]

titles = [
    f"{name}: median {np.nanmedian(difference):.1f} m, scatter {np.nanstd(difference):.1f} m"
    for name, difference in zip(("before", "after"), differences, strict=True)
]
figure, axes = panels(titles)
for axis, difference in zip(axes, differences, strict=True):
    drawn = axis.imshow(difference, cmap="RdBu", vmin=BIAS_M - 15, vmax=BIAS_M + 15)
    axis.set(xticks=[], yticks=[])
figure.colorbar(drawn, ax=axes, label="new minus old heights, m", shrink=0.7)
save(figure, __file__)
