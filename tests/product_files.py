"""Tiny products with the real names: a Landsat Collection 2 scene, a Sentinel-2 SAFE."""

from __future__ import annotations

import json
import tarfile
import zipfile
from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray

from pcwlad_geo.raster import Grid
from tests.scenes import make_grid, render

LANDSAT = "LC08_L1TP_198030_20200809_20200918_02_T1"
SAFE = "S2B_MSIL2A_20230809T100559_N0509_R022_T32TQM_20230809T133200.SAFE"
SHIFT_M = (39.0, 27.0)
"""What is at a place is shown so far east and south of it (target products)."""
CLEAR, CLOUD = 21824, 22280
COLLECTION_1 = ("BQA", 2720, 2800)
"""Name of the quality raster, and its words for clear ground and clouds."""
BEFORE_COLLECTIONS = ("BQA", 20480, 53248)
SIDE_M = 7200.0


def seen_by(
    grid: Grid, band: str, shift_m: tuple[float, float], *, noise: float = 1.0
) -> NDArray[np.float64]:
    """Render what a target shows that is displaced by metres (east, south)."""
    size_m = grid.transform.a
    return render(grid, band, displacement_px=(shift_m[0] / size_m, shift_m[1] / size_m), noise=noise)


def grid_of(size_m: float, corner_m: tuple[float, float] = (0.0, 0.0)) -> Grid:
    side = round(SIDE_M / size_m)
    return make_grid((side, side), pixel_m=size_m, offset_m=corner_m)


def write_landsat(
    folder: Path,
    *,
    shift_m: tuple[float, float] = (0.0, 0.0),
    name: str = LANDSAT,
    cloud: tuple[slice, slice] | None = None,
    bands: tuple[str, ...] = ("B4", "B8", "B10"),
    metadata: str = "txt",
    quality_values: tuple[str, int, int] = ("QA_PIXEL", CLEAR, CLOUD),
    collection: str | None = "02",
) -> Path:
    """Write a scene: B8 of 15 m with its corner 7.5 m off, TIRS bands as the negative of the others."""
    scene = folder / name
    scene.mkdir(parents=True)
    for band in bands:
        grid = grid_of(15.0, (7.5, -7.5)) if band == "B8" else grid_of(30.0)
        kind = "thermal" if band.endswith(("B10", "B11")) else "red"
        numbers = np.clip(np.rint(seen_by(grid, kind, shift_m) * 100 + 5000), 1, 65535)
        save(scene / f"{name}_{band}.TIF", numbers.astype("uint16"), grid, nodata=0)
    quality_name, clear, clouded = quality_values
    quality = np.full(grid_of(30.0).shape, clear, "uint16")
    if cloud is not None:
        quality[cloud] = clouded
    save(scene / f"{name}_{quality_name}.TIF", quality, grid_of(30.0), nodata=1)
    numbers_of = [band.removeprefix("SR_").removeprefix("ST_")[1:] for band in bands]
    listed = {f"FILE_NAME_BAND_{n}": f"{name}_{band}.TIF" for n, band in zip(numbers_of, bands, strict=True)}
    listed |= {"FILE_NAME_QUALITY_L1_PIXEL": f"{name}_QA_PIXEL.TIF"}
    level_1 = name.replace("L2SP", "L1TP").replace("_T1", "_RT")
    other = {"FILE_NAME_BAND_1": f"{level_1}_B1.TIF"} if level_1 != name else {}
    if collection is not None:
        other |= {"COLLECTION_NUMBER": collection}
    (scene / f"{name}_MTL.{metadata}").write_text(landsat_metadata(listed, other, metadata))
    return scene


def landsat_metadata(listed: dict[str, str], other: dict[str, str], kind: str) -> str:
    groups = {"PRODUCT_CONTENTS": listed, "LEVEL1_PROCESSING_RECORD": other}
    if kind == "json":
        return json.dumps({"LANDSAT_METADATA_FILE": groups})
    if kind == "xml":
        inner = "".join(
            f"<{group}>" + "".join(f"<{k}>{v}</{k}>" for k, v in items.items()) + f"</{group}>"
            for group, items in groups.items()
        )
        return f"<LANDSAT_METADATA_FILE>{inner}</LANDSAT_METADATA_FILE>"
    lines = ["GROUP = LANDSAT_METADATA_FILE"]
    for group, items in groups.items():
        lines += [
            f"  GROUP = {group}",
            *(f'    {k} = "{v}"' for k, v in items.items()),
            f"  END_GROUP = {group}",
        ]
    return "\n".join([*lines, "END_GROUP = LANDSAT_METADATA_FILE", "END"])


def write_safe(
    folder: Path,
    *,
    level: str = "L2A",
    shift_m: tuple[float, float] = (0.0, 0.0),
    offset: int = -1000,
    cloud: tuple[slice, slice] | None = None,
    sizes: tuple[tuple[str, int], ...] = (("B04", 10), ("B05", 20), ("B01", 60)),
) -> Path:
    """Write a product; the top rows of every band are 0 (outside of the swath), its darkest pixels 1.

    `cloud` is in px of 20 m.
    """
    safe = folder / SAFE.replace("L2A", level)
    granule = safe / "GRANULE" / f"{level}_T32TQM_A033557_20230809T100559"
    (granule / "QI_DATA").mkdir(parents=True)
    listed = []
    for band, size in sizes:
        grid = grid_of(float(size))
        numbers = np.clip(np.rint(seen_by(grid, "red", shift_m) * 20 - 1500), 1, 65535)
        numbers[: 600 // size] = 0
        part = (
            f"R{size}m/T32TQM_20230809T100559_{band}_{size}m"
            if level == "L2A"
            else f"T32TQM_20230809T100559_{band}"
        )
        listed.append(f"GRANULE/{granule.name}/IMG_DATA/{part}")
        path = granule / "IMG_DATA" / f"{part}.jp2"
        path.parent.mkdir(parents=True, exist_ok=True)
        save(path, numbers.astype("uint16"), grid)
    if level == "L2A":
        classes = np.full(grid_of(20.0).shape, 4, "uint8")
        if cloud is not None:
            classes[cloud] = 9
        path = granule / "IMG_DATA" / "R20m" / "T32TQM_20230809T100559_SCL_20m.jp2"
        path.parent.mkdir(parents=True, exist_ok=True)
        save(path, classes, grid_of(20.0))
    masks = np.zeros((3, *grid_of(60.0).shape), "uint8")
    if cloud is not None:
        masks[0] = np.kron(np.eye(1), np.zeros(grid_of(60.0).shape))
        masks[0][tuple(slice(part.start // 3, part.stop // 3) for part in cloud)] = 1
    save(granule / "QI_DATA" / "MSK_CLASSI_B00.jp2", masks, grid_of(60.0))
    (safe / f"MTD_MSI{level}.xml").write_text(safe_metadata(level, listed, offset))
    return safe


def safe_metadata(level: str, listed: list[str], offset: int) -> str:
    images = "".join(f"<IMAGE_FILE>{name}</IMAGE_FILE>" for name in listed)
    tag, prefix = ("BOA_ADD_OFFSET", "BOA_") if level == "L2A" else ("RADIO_ADD_OFFSET", "")
    offsets = "".join(f'<{tag} band_id="{number}">{offset}</{tag}>' for number in range(13))
    quantification = f'<{prefix}QUANTIFICATION_VALUE unit="none">10000</{prefix}QUANTIFICATION_VALUE>'
    return (
        f'<n1:Level_Product xmlns:n1="https://psd-14.sentinel2.eo.esa.int/PSD/User_Product.xsd"><n1:General_Info>'
        f"<Granule_List><Granule>{images}</Granule></Granule_List>{quantification}{offsets}"
        "</n1:General_Info></n1:Level_Product>"
    )


def save(path: Path, values: NDArray[np.generic], grid: Grid, **profile: object) -> Path:
    """Write bands without loss, as JPEG 2000 or GeoTIFF by the name."""
    bands = values[None] if values.ndim == 2 else values
    lossless = {"QUALITY": "100", "REVERSIBLE": "YES"} if path.suffix == ".jp2" else {}
    size = {"count": len(bands), "height": bands.shape[1], "width": bands.shape[2]}
    with rasterio.open(
        path,
        "w",
        driver="JP2OpenJPEG" if path.suffix == ".jp2" else "GTiff",
        dtype=bands.dtype,
        crs=grid.crs,
        transform=grid.transform,
        **size,
        **lossless,
        **profile,
    ) as file:
        file.write(bands)
    return path


def packed(folder: Path, ending: str, *, with_folder: bool = True) -> Path:
    """Pack a product folder into an archive beside it."""
    archive = folder.with_name(folder.name + ending)
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    base = folder.parent if with_folder else folder
    if ending == ".zip":
        with zipfile.ZipFile(archive, "w") as made:
            for path in files:
                made.write(path, path.relative_to(base).as_posix())
    else:
        with tarfile.open(archive, "w:gz" if ending.endswith("gz") else "w") as tar:
            for path in files:
                tar.add(path, path.relative_to(base).as_posix())
    return archive
