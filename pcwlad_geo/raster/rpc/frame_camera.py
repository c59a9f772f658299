"""The camera of a scanned photograph: pixels to calibrated image coordinates, pose by tie points, an RPC."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import Final

import cv2
import numpy as np
import pyproj

from pcwlad_geo.errors import InputError
from pcwlad_geo.estimation.transforms import AffineTransform
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.raster.rpc.dem import Vertical, open_dem
from pcwlad_geo.raster.rpc.model import RpcModel
from pcwlad_geo.raster.rpc.rational import fit_rpc
from pcwlad_geo.text import read_text
from pcwlad_geo.types import Float64


@dataclass(frozen=True, slots=True)
class FrameParameters:
    """How a pose is found, and how well marks and an RPC have to fit."""

    least_points: int = 8
    """Fewest tie points with heights."""
    most_off_px: float = 4.0
    """Distance from which a tie point counts as wrong."""
    least_share: float = 0.5
    """Least share of the tie points that agree with a pose."""
    most_mark_mm: float = 0.5
    """Largest distance of a mark from the affine of all."""
    nodes: tuple[int, int] = (15, 5)
    """Places along an axis of the image, and heights, to which an RPC is fitted."""
    margin_m: float = 100.0
    """Height of the ground of the RPC above and below that of the tie points."""
    most_misfit_px: float = 0.05
    """Largest distance of the RPC from the camera."""


FRAME_CAMERAS: Final = FrameParameters()
"""Those in use."""
_COLUMNS: Final = ("col", "row", "x_mm", "y_mm", "focal_mm")


@dataclass(frozen=True, slots=True, eq=False)
class FrameCamera:
    """The interior orientation of a scan: image coordinates with y down about the principal point."""

    focal_mm: float
    to_mm: AffineTransform
    """From px (col, row), corner-based, to mm."""

    @staticmethod
    def of_file(path: str | PathLike[str]) -> FrameCamera:
        """Read marks or corners from a table (CSV) with col, row, x_mm, y_mm (up) and focal_mm.

        Raises `InputError` if it cannot be read, or has fewer than three marks, or they do not fit.
        """
        try:
            rows = list(csv.DictReader(read_text(Path(path), most=LIMITS.options_bytes).splitlines()))
            values = np.array([[float(row[name]) for name in _COLUMNS] for row in rows]).reshape(-1, 5)
        except (OSError, UnicodeError, KeyError, ValueError, TypeError) as error:
            raise InputError(
                f"{path} is no table of marks with the columns {', '.join(_COLUMNS)} ({error}): correct it"
            ) from error
        at_px, mm, focal_mm = values[:, :2], values[:, 2:4] * [1, -1], values[:, 4]
        rank = np.linalg.matrix_rank(at_px - at_px[:1], tol=1.0)
        if not (np.isfinite(values).all() and rank == 2 and focal_mm[0] > 0 and np.ptp(focal_mm) == 0):
            raise InputError(
                f"{path} holds {len(values)} marks: three that are no line are needed, and one focal length"
            )
        to_mm = AffineTransform.fit(at_px, mm)
        off_mm = float(np.hypot(*(to_mm(at_px) - mm).T).max())
        if off_mm > FRAME_CAMERAS.most_mark_mm:
            raise InputError(f"{path}: a mark lies {off_mm:.2f} mm from where the others put it: correct it")
        return FrameCamera(float(focal_mm[0]), to_mm)

    def rpc(
        self,
        at_px: Float64,
        lon_lat: Float64,
        shape: tuple[int, int],
        dem: str | PathLike[str],
        vertical: Vertical,
    ) -> RpcModel:
        """Return the camera as an RPC, its pose by (n, 2) `at_px` that show (n, 2) `lon_lat` on a DEM.

        The `shape` is that of the scan. Raises `InputError` if the DEM cannot be used, or no pose fits.
        """
        (west, south), (east, north) = lon_lat.min(axis=0).tolist(), lon_lat.max(axis=0).tolist()
        height = open_dem(fspath(dem), vertical, (west, south, east, north)).at(lon_lat)
        known = np.isfinite(height)
        ground = np.column_stack([lon_lat, height])[known]
        if len(ground) < FRAME_CAMERAS.least_points:
            raise InputError(
                f"{len(ground)} tie points lie on the DEM {dem}, and a camera's pose needs "
                f"{FRAME_CAMERAS.least_points}: give a DEM of all the ground"
            )
        metres, middle = _to_metres(ground), _to_metres(ground).mean(axis=0)
        pose = self._pose(metres - middle, self.to_mm(at_px[known]))
        return self._as_rpc(pose, middle, ground, shape)

    def _pose(self, metres: Float64, mm: Float64) -> tuple[Float64, Float64]:
        """Return rotation vector and translation by (n, 3) places and (n, 2) image coordinates."""
        pitch_mm = float(np.sqrt(abs(np.linalg.det(self.to_mm.rows[:, :2]))))
        solved, turn, moved, inliers = cv2.solvePnPRansac(
            metres, mm, self._matrix, None, flags=cv2.SOLVEPNP_SQPNP, confidence=0.999,
            iterationsCount=500, reprojectionError=FRAME_CAMERAS.most_off_px * pitch_mm,
        )  # fmt: skip
        if not solved or inliers is None or len(inliers) < FRAME_CAMERAS.least_share * len(mm):
            raise InputError(
                "no pose of the camera fits the tie points: check the marks, their focal length and the DEM"
            )
        use = inliers[:, 0]
        turn, moved = cv2.solvePnPRefineLM(metres[use], mm[use], self._matrix, None, turn, moved)
        return np.asarray(turn), np.asarray(moved)

    @property
    def _matrix(self) -> Float64:
        return np.diag([self.focal_mm, self.focal_mm, 1.0])

    def _as_rpc(
        self, pose: tuple[Float64, Float64], middle: Float64, ground: Float64, shape: tuple[int, int]
    ) -> RpcModel:
        """Return the RPC of a pose, fitted to places all over the image at the heights of the ground."""
        low, high = ground.min(axis=0), ground.max(axis=0)
        rows, cols = shape
        sides, levels = FRAME_CAMERAS.nodes
        height = np.linspace(low[2] - FRAME_CAMERAS.margin_m, high[2] + FRAME_CAMERAS.margin_m, levels)
        reach = np.maximum(high[:2] - low[:2], 1e-6)
        axes = [np.linspace(low[k] - reach[k], high[k] + reach[k], 4 * sides) for k in (0, 1)]
        places = np.stack(np.meshgrid(*axes, height, indexing="ij"), axis=-1).reshape(-1, 3)
        mm = cv2.projectPoints(_to_metres(places) - middle, *pose, self._matrix, None)[0][:, 0]
        seen_px = self.to_mm.apply_inverse(mm.astype(np.float64))
        margin = 0.1 * np.array([cols, rows])
        inside = ((seen_px > -margin) & (seen_px < np.array([cols, rows]) + margin)).all(axis=1)
        places, seen_px = places[inside], seen_px[inside]
        box = (places.min(axis=0) + places.max(axis=0)) / 2, np.ptp(places, axis=0) / 2
        rpc, misfit_px = fit_rpc(places, seen_px, box)
        if not misfit_px < FRAME_CAMERAS.most_misfit_px:
            raise InputError(f"an RPC misses the camera by {misfit_px:.2g} px: its ground is too wide")
        return rpc


def _to_metres(ground: Float64) -> Float64:
    """Return (n, 3) earth-centred coordinates of longitudes, latitudes and heights."""
    to_xyz = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
    return np.column_stack(to_xyz.transform(*ground.T))
