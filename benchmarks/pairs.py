"""The real image pairs, and files made from them."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning

Image = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Pair:
    """A pair of the paper."""

    name: str
    reference: Path
    target: Path
    """As the paper matched it: shifted by the truth, or another viewpoint."""
    registered: Path | None
    """The target before it was shifted."""
    truth_xy_px: tuple[float, float] | None
    """Target minus reference position; None: another viewpoint, only the epipolar geometry is known."""

    @property
    def peers(self) -> Path:
        """Folder with the points of the published methods."""
        return self.reference.parent / "peers"

    @property
    def truth(self) -> tuple[float, float]:
        """The known translation."""
        if self.truth_xy_px is None:
            raise ValueError(f"{self.name} has no known translation")
        return self.truth_xy_px

    @property
    def undisplaced(self) -> Path:
        """The target before it was shifted."""
        if self.registered is None:
            raise ValueError(f"{self.name} has no registered target")
        return self.registered


def landsat(data: Path) -> Pair:
    """Landsat 8 band 2 and band 10."""
    folder = data / "paper/landsat_sub1"
    target, registered = folder / "LC08B10offset_sub1.tif", folder / "LC08B10_sub1.tif"
    return Pair("landsat_sub1", folder / "LC08b2_sub1.tif", target, registered, (-1.4, -1.6))


def rgbnir(data: Path) -> Pair:
    """Close-range visible (red) and near-infrared images."""
    folder = data / "paper/rgbnir_sub1"
    target, registered = folder / "0000_niroffset.tiff", folder / "0000_nir.tiff"
    return Pair("rgbnir_sub1", folder / "0000_rgb.tiff", target, registered, (8.3, 3.6))


def uav(data: Path) -> Pair:
    """Visible and thermal images from a UAV, another viewpoint each."""
    folder = data / "paper/uav_1"
    target = folder / "DJI_20240707112019_0003_T.JPG"
    return Pair("uav_1", folder / "DJI_20240707112018_0002_Z.JPG", target, None, None)


def read(path: Path, band: int = 1) -> Image:
    """Return a band of a file."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path) as file:
            return np.asarray(file.read(band))


def read_masked(path: Path, band: int = 1) -> tuple[Image, NDArray[np.bool_], float | None]:
    """Return a band of a file, where it has data, and its nodata value."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path) as file:
            return np.asarray(file.read(band)), np.asarray(file.read_masks(band) > 0), file.nodata


def write(
    path: Path,
    image: Image,
    transform: Affine | None = None,
    crs: str | None = None,
    nodata: float | None = None,
) -> Path:
    """Write an image as a GeoTIFF of its own dtype; return its path."""
    rows, cols = image.shape
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(
            path,
            "w",
            driver="GTiff",
            width=cols,
            height=rows,
            count=1,
            dtype=image.dtype,
            crs=crs,
            nodata=nodata,
            transform=transform or Affine.identity(),
        ) as file:
            file.write(image, 1)
    return path


def as_uint8(values: Image) -> Image:
    """Round and clip to 0–255."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def with_noise(image: Image, sigma: float, seed: int) -> Image:
    """Add Gaussian noise to an image of 0–255."""
    return as_uint8(image + np.random.default_rng(seed).normal(0.0, sigma, image.shape))


def with_gamma(image: Image, gamma: float) -> Image:
    """Bend the radiometry of an image of 0–255."""
    return as_uint8(255.0 * (image / 255.0) ** gamma)
