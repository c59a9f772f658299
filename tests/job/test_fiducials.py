"""A scanned photograph of a frame camera over relief, which the scanner has stretched and sheared.

The camera is simulated in earth-centred coordinates, without distortion of the lens, grain and film.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyproj
import pytest
from affine import Affine
from scipy.interpolate import RectBivariateSpline

import pcwlad_geo
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import WGS84, Grid, open_raster, transform_xy
from pcwlad_geo.raster.rpc.files import parse_rpc_text
from pcwlad_geo.raster.rpc.frame_camera import FrameCamera
from tests.scenes import CRS_OF_SCENE, Array, make_grid, render, write
from tests.swaths import seen_by

REFERENCE = make_grid((330, 330))
SHAPE, FOCAL_MM, FRAME_MM = (300, 300), 153.0, 230.0
SCANNED = np.array([[1.012, 0.008], [-0.004, 0.995]])
"""What the scanner makes of px about the middle."""
QUICK: Any = {"features": 300, "jobs": 1, "no_report": True}
TO_XYZ = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)


def height_m(xy: Array) -> Array:
    east, north = ((xy - REFERENCE.to_xy(np.array([[165.0, 165.0]]))) / 1000.0).T
    return np.asarray(500 + 220 * np.sin(east / 1.1) * np.cos(north / 1.3))


def xyz(xy: Array, height: Array) -> Array:
    return np.column_stack(TO_XYZ.transform(*transform_xy(xy, CRS_OF_SCENE, WGS84).T, height))


@dataclass(frozen=True, slots=True)
class Photograph(Grid):
    """The truth: a camera 6 km above the ground, turned by 25 degrees and tilted by 2."""

    def to_px(self, xy: Array) -> Array:
        middle = REFERENCE.to_xy(np.array([[165.0, 165.0]]))
        east, north = (
            xyz(middle + step, np.zeros(1)) - xyz(middle, np.zeros(1)) for step in ([1, 0], [0, 1])
        )
        down = np.cross(north / np.linalg.norm(north), east / np.linalg.norm(east))
        axes = np.vstack([east / np.linalg.norm(east), -north / np.linalg.norm(north), down])
        turn = cv2.Rodrigues(np.array([0.02, -0.03, 0.0]))[0] @ cv2.Rodrigues(np.array([0, 0, 0.44]))[0]
        seen = (xyz(xy, height_m(xy)) - xyz(middle, np.array([6000.0]))) @ (turn @ axes).T
        mm = FOCAL_MM * seen[:, :2] / seen[:, 2:]
        return np.asarray((mm * SHAPE[0] / FRAME_MM) @ SCANNED.T + 150.0)

    def to_xy(self, pixel_xy_px: Array) -> Array:
        nodes = np.linspace(-5.0, 305.0, 40)
        at = np.stack(np.meshgrid(nodes, nodes), -1).reshape(-1, 2)
        xy = REFERENCE.to_xy(at)
        for _ in range(3):
            slopes = [(self.to_px(xy + step) - self.to_px(xy)) / 10 for step in ([10.0, 0], [0, 10.0])]
            xy = xy + np.linalg.solve(np.stack(slopes, axis=2), (at - self.to_px(xy))[:, :, None])[:, :, 0]
        col, row = pixel_xy_px.T
        splines = [RectBivariateSpline(nodes, nodes, part.reshape(40, 40)) for part in xy.T]
        return np.column_stack([spline(row, col, grid=False) for spline in splines])


SCAN = Photograph(SHAPE, REFERENCE.transform, REFERENCE.crs)


def marks(path: Path, *, fiducials: bool) -> Path:
    """Write the marks of the camera, or the corners of the scan as if the scanner had done nothing."""
    mm = np.array([[-106.0, -106], [106, -106], [106, 106], [-106, 106], [0, 110]])
    px = (mm * [1, -1] * SHAPE[0] / FRAME_MM) @ (SCANNED if fiducials else np.eye(2)).T + 150.0
    rows = [",".join(map(repr, row)) for row in np.column_stack([px, mm, np.full(5, FOCAL_MM)]).tolist()]
    path.write_text("\n".join(["col,row,x_mm,y_mm,focal_mm", *rows]))
    return path


def test_fiducials_make_a_camera_of_a_stretched_scan(tmp_path: Path) -> None:
    reference = write(tmp_path / "reference.tif", render(REFERENCE), REFERENCE)
    scan = write(tmp_path / "scan.tif", seen_by(SCAN), Grid(SHAPE, Affine.identity(), None))
    grid = Grid((200, 200), make_grid(pixel_m=80.0, offset_m=(-3000, 3000)).transform, CRS_OF_SCENE)
    centres = np.stack(np.meshgrid(np.arange(200) + 0.5, np.arange(200) + 0.5), -1).reshape(-1, 2)
    heights = height_m(grid.to_xy(centres)).reshape(200, 200)
    heights_file = write(tmp_path / "dem.tif", heights, grid, dtype="float32")
    options: Any = {"dem": heights_file, "dem_vertical": 0.0, **QUICK}
    at = np.random.default_rng(0).uniform(20, 280, (300, 2))
    xy = SCAN.to_xy(at)
    error_px = []
    for fiducials in (False, True):
        table = marks(tmp_path / "marks.csv", fiducials=fiducials)
        out = tmp_path / f"out{fiducials}"
        pcwlad_geo.register(reference, scan, fiducials=table, out_dir=out, **options)
        rpc = parse_rpc_text(out / "scan_camera_RPC.TXT")
        places = np.column_stack([transform_xy(xy, CRS_OF_SCENE, WGS84), height_m(xy)])
        error_px.append(np.sqrt((np.hypot(*(rpc.to_px(places) - at).T) ** 2).mean()))
    assert error_px[1] < 0.5
    assert error_px[0] > 3 * error_px[1]
    options |= {"trust_vrt": True, "out_dir": tmp_path / "stack"}
    stacked = pcwlad_geo.stack([out / "scan_camera.vrt", reference], **options)
    (photograph,) = (image for image in stacked.images if image.rpc is not None)
    with open_raster(str(photograph.registered)) as file:
        image, on = file.read(1), Grid(file.shape, file.transform, file.crs)
    shown = image > 0
    assert np.corrcoef(image[shown], render(on)[shown])[0, 1] > 0.97


def test_what_marks_cannot_be_is_told(tmp_path: Path) -> None:
    table = marks(tmp_path / "marks.csv", fiducials=True)
    with pytest.raises(SettingsError, match="fiducials give a camera its pose by heights"):
        Settings(fiducials=table)
    text = table.read_text()
    for changed, message in (
        (text.replace("focal_mm", "f"), "no table of marks with the columns col, row, x_mm, y_mm, focal_mm"),
        ("\n".join(text.split("\n")[:3]), "holds 2 marks: three that are no line are needed"),
        (text.replace(",-106.0,", ",-100.0,", 1), r"a mark lies \d.\d+ mm from where the others put it"),
    ):
        table.write_text(changed)
        with pytest.raises(InputError, match=message):
            FrameCamera.of_file(table)
