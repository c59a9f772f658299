"""Tiny products of Planet, HLS and MAJA with the real names, band types, nodata and masks.

Their layout follows the published descriptions of the formats. They cannot show what real files have beyond
these: compression, overviews, the geometry of the sensor, and errors of the masks.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pcwlad_geo.raster import Grid
from tests.product_files import save, seen_by
from tests.scenes import make_grid

PLANET = "20230615_153012_45_2486"
HLS = "HLS.L30.T32TQM.2020222T100559.v2.0"
MAJA = "SENTINEL2A_20200809-101559-455_L2A_T32TQM_C_V2-2"
SIDE_PX = 240
CLOUD = (slice(60, 130), slice(40, 110))


def grid_of(size_m: float, side_px: int = SIDE_PX) -> Grid:
    return make_grid((side_px, side_px), pixel_m=size_m)


def numbers(grid: Grid, band: str, shift_px: tuple[float, float]) -> NDArray[np.int16]:
    """Return reflectance in ten thousandths of what lies so many px east and south of its place."""
    size_m = grid.transform.a
    shift_m = shift_px[0] * size_m, shift_px[1] * size_m
    seen = seen_by(grid, band, shift_m, noise=0.0 if any(shift_m) else 1.0)  # not the noise of the other
    return np.clip(np.rint(seen * 20 + 1500), 1, 9999).astype("int16")


def write_planet(
    folder: Path,
    *,
    shift_px: tuple[float, float] = (0.0, 0.0),
    scene: str = PLANET,
    image: str = "AnalyticMS_SR_8b_clip",
) -> Path:
    """Write an order: the image, UDM2 with a cloud, and both files of metadata."""
    place = folder / "PSScene"
    place.mkdir(parents=True, exist_ok=True)
    grid = grid_of(3.0)
    bands = np.stack([numbers(grid, "red", shift_px).astype("uint16")] * 8)
    bands[:, :20] = 0
    save(place / f"{scene}_3B_{image}.tif", bands, grid, nodata=0)
    mask = np.zeros((8, *grid.shape), "uint8")
    mask[0], mask[6] = 1, 90
    mask[0][CLOUD], mask[5][CLOUD] = 0, 1
    mask[7][:20] = 1
    save(place / f"{scene}_3B_udm2_clip.tif", mask, grid)
    (place / f"{scene}_3B_AnalyticMS_8b_metadata_clip.xml").write_text("<ps:EarthObservation/>")
    (place / f"{scene}_metadata.json").write_text("{}")
    return folder


def write_hls(
    folder: Path, *, shift_px: tuple[float, float] = (0.0, 0.0), scene: str = HLS, bands: str = "B04 B09 B10"
) -> Path:
    """Write a granule: bands, Fmask with a cloud, an angle, and the metadata that list the bands."""
    place = folder / scene
    place.mkdir(parents=True)
    grid = grid_of(30.0)
    for band in bands.split():
        values = numbers(grid, "thermal" if band == "B10" else "red", shift_px)
        values[:20] = -9999
        save(place / f"{scene}.{band}.tif", values, grid, nodata=-9999)
    quality = np.full(grid.shape, 0b01000000, "uint8")
    quality[CLOUD], quality[:20] = 0b11000010, 255
    save(place / f"{scene}.Fmask.tif", quality, grid, nodata=255)
    save(place / f"{scene}.SAA.tif", np.full(grid.shape, 15000, "uint16"), grid, nodata=40000)
    urls = "".join(f"<URL>https://data.invalid/{scene}/{scene}.{band}.tif</URL>" for band in bands.split())
    (place / f"{scene}.cmr.xml").write_text(f"<Granule><OnlineAccessURLs>{urls}</OnlineAccessURLs></Granule>")
    return place


def write_maja(folder: Path, *, shift_px: tuple[float, float] = (0.0, 0.0), scene: str = MAJA) -> Path:
    """Write a product: two bands of 10 m and one of 20 m, with and without slopes, and MASKS."""
    place = folder / scene
    (place / "MASKS").mkdir(parents=True)
    listed = []
    for band, size_m in (("B4", 10.0), ("B8", 10.0), ("B8A", 20.0)):
        grid = grid_of(size_m, round(SIDE_PX * 10 / size_m))
        values = numbers(grid, "red", (shift_px[0] * 10 / size_m, shift_px[1] * 10 / size_m))
        values[: round(200 / size_m)] = -10000
        for kind in ("FRE", "SRE"):
            listed.append(f"{scene}_{kind}_{band}.tif")
            save(place / listed[-1], values, grid)
    clouds = np.zeros(grid_of(10.0).shape, "uint8")
    clouds[CLOUD] = 0b00001011
    save(place / "MASKS" / f"{scene}_CLM_R1.tif", clouds, grid_of(10.0))
    save(place / "MASKS" / f"{scene}_MG2_R1.tif", clouds, grid_of(10.0))
    images = "".join(f"<IMAGE>{name}</IMAGE>" for name in listed)
    (place / f"{scene}_MTD_ALL.xml").write_text(
        f"<Muscate_Metadata_Document>{images}</Muscate_Metadata_Document>"
    )
    return place


ENMAP = "ENMAP01-____L2A-DT0000004950_20221103T162438Z_001_V010110_20221118T145147Z-Y0146_X0311"
DESIS = "DESIS-HSI-L2A-DT0707652640_011-20220404T193259-V0220"
ECOSTRESS = "ECOv002_L2T_LSTE_35698_014_32TQM_20241022T103923_0713_01"
WAVELENGTHS = (550.0, 660.0, 670.0, 850.0, 1400.0, 1650.0)


def write_enmap(
    folder: Path,
    *,
    shift_px: tuple[float, float] = (0.0, 0.0),
    scene: str = ENMAP,
    images: tuple[str, ...] = ("SPECTRAL_IMAGE",),
) -> Path:
    """Write a scene of six bands, of which that in the water vapour has no data, with its three masks.

    With two `images`, those of the instruments, each has half of the bands.
    """
    place = folder / scene
    place.mkdir(parents=True)
    grid = grid_of(30.0)
    bands = np.stack([numbers(grid, "red", shift_px)] * len(WAVELENGTHS))
    bands[4], bands[:, :20] = -32768, -32768
    for image, part in zip(images, np.split(bands, len(images)), strict=True):
        save(place / f"{scene}-{image}.TIF", part, grid)
    for name, area in (
        ("CLOUD", CLOUD),
        ("CLOUDSHADOW", (slice(60, 130), slice(110, 130))),
        ("CIRRUS", (slice(200, 240), slice(200, 240))),
    ):
        mask = np.zeros(grid.shape, "uint8")
        mask[area] = 2
        save(place / f"{scene}-QL_QUALITY_{name}.TIF", mask, grid)
    described = "".join(
        f'<bandID number="{number}"><wavelengthCenterOfBand>{middle}</wavelengthCenterOfBand>'
        f"<FWHMOfBand>7.5</FWHMOfBand><GainOfBand>0.0001</GainOfBand></bandID>"
        for number, middle in enumerate(WAVELENGTHS, start=1)
    )
    (place / f"{scene}-METADATA.XML").write_text(
        f"<level_X><specific><backgroundValue>-32768</backgroundValue>"
        f"<bandCharacterisation>{described}</bandCharacterisation></specific></level_X>"
    )
    return place


def write_desis(folder: Path, *, shift_px: tuple[float, float] = (0.0, 0.0), scene: str = DESIS) -> Path:
    """Write a scene of three bands, with the mask of ten."""
    place = folder / scene
    place.mkdir(parents=True)
    grid = grid_of(30.0)
    bands = np.stack([numbers(grid, "red", shift_px)] * 3)
    bands[:, :20] = -32768
    save(place / f"{scene}-SPECTRAL_IMAGE.tif", bands, grid)
    mask = np.zeros((10, *grid.shape), "uint8")
    mask[1], mask[8], mask[5][CLOUD] = 1, 20, 1
    save(place / f"{scene}-QL_QUALITY-2.tif", mask, grid)
    described = "".join(
        f"<band><bandNumber>{number}</bandNumber><wavelengthWidthOfBand>3.5</wavelengthWidthOfBand>"
        f"<wavelengthCenterOfBand>{middle}</wavelengthCenterOfBand></band>"
        for number, middle in enumerate(WAVELENGTHS[:3], start=1)
    )
    (place / f"{scene}-METADATA.xml").write_text(
        f'<hsi xmlns:x="http://www.dlr.de/dims"><specific><backgroundValue>-32768</backgroundValue>'
        f"<bandCharacterisation>{described}</bandCharacterisation></specific></hsi>"
    )
    return place


def write_ecostress(
    folder: Path, *, shift_px: tuple[float, float] = (0.0, 0.0), scene: str = ECOSTRESS
) -> Path:
    """Write a tile of 70 m: temperature in kelvin with gaps at the top, emissivity, and masks."""
    place = folder / scene
    place.mkdir(parents=True)
    grid = grid_of(70.0)
    kelvin = (280 + numbers(grid, "red", shift_px) / 100).astype("float32")
    kelvin[:20] = np.nan
    save(place / f"{scene}_LST.tif", kelvin, grid, nodata=np.nan)
    save(place / f"{scene}_EmisWB.tif", (kelvin / 400).astype("float32"), grid, nodata=np.nan)
    clouds = np.zeros(grid.shape, "uint8")
    clouds[CLOUD] = 1
    for name in ("cloud", "water", "QC"):
        save(place / f"{scene}_{name}.tif", clouds, grid)
    return place
