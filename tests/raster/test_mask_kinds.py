from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.crs import CRS
from rasterio.warp import transform as transform_points

from pcwlad_geo.errors import InputError
from pcwlad_geo.options import Settings
from pcwlad_geo.raster.grid import Grid, Window
from pcwlad_geo.raster.masks import accepted, kind_of
from pcwlad_geo.raster.pixels import valid_in_mask_file
from pcwlad_geo.raster.source import describe
from pcwlad_geo.registration import register_pair
from tests.delivered_files import HLS, MAJA
from tests.scenes import make_grid, render
from tests.scenes import write as write_scene

UTM = CRS.from_epsg(32633)
TRANSFORM = Affine(10, 0, 500_000, 0, -10, 5_000_000)
LANDSAT = "LC08_L1TP_198030_20200809_20200918_02_T1_QA_PIXEL.TIF"
SCL = "T32TQM_20200809T100559_SCL_20m.jp2"
CLASSI = "MSK_CLASSI_B00.jp2"
CLEAR, WATER, SNOW = 21824, 21952, 30048
"""Words of QA_PIXEL as the product's guide lists them."""
FILL, CLOUD, SHADOW, CIRRUS, DILATED = 1, 22280, 23888, 54596, 21826


def write(path: Path, bands: np.ndarray, transform: Affine = TRANSFORM, crs: CRS | None = UTM) -> Path:
    bands = bands[None] if bands.ndim == 2 else bands
    count, rows, cols = bands.shape
    lossless = {"QUALITY": "100", "REVERSIBLE": "YES"} if path.suffix == ".jp2" else {}
    with rasterio.open(
        path,
        "w",
        driver="JP2OpenJPEG" if path.suffix == ".jp2" else "GTiff",
        count=count,
        height=rows,
        width=cols,
        dtype=bands.dtype,
        transform=transform,
        crs=crs,
        **lossless,
    ) as dataset:
        dataset.write(bands)
    return path


@pytest.mark.parametrize(
    ("uri", "descriptions", "dtypes", "kind"),
    [
        (f"/a/{LANDSAT}", [None], ["uint16"], "QA_PIXEL"),
        (f"C:\\a\\{LANDSAT.lower()}", [None], ["uint16"], "QA_PIXEL"),
        ("LC08_L1TP_198030_20200809_20200918_01_T1_BQA.TIF", [None], ["uint16"], "BQA"),
        ("l8_bqa.tif", [None], ["uint16"], "BQA"),
        (f"/vsizip//a/b.zip/IMG_DATA/R20m/{SCL}", [None], ["uint8"], "SCL"),
        ("https://host/S2B_32TQM_20200809_0_L2A/SCL.tif", [None], ["uint8"], "SCL"),
        (f"GRANULE/X/QI_DATA/{CLASSI}", [None] * 3, ["uint8"] * 3, "MSK_CLASSI"),
        ("crop.tif", ["QA_PIXEL"], ["uint16"], "QA_PIXEL"),
        ("crop.tif", ["SCL"], ["uint8"], "SCL"),
        ("scl_mask.tif", [None], ["uint8"], "zeros"),
        ("muscl.tif", [None], ["uint8"], "zeros"),
        ("cloud_free.tif", ["mask"], ["float32"], "zeros"),
    ],
)
def test_the_kind_is_told_by_name_or_description(
    uri: str, descriptions: list[str | None], dtypes: list[str], kind: str
) -> None:
    assert kind_of(uri, descriptions, dtypes) == kind


@pytest.mark.parametrize(
    ("name", "dtypes"), [(LANDSAT, ["float32"]), (SCL, ["float64"]), (CLASSI, ["uint8"])]
)
def test_a_quality_raster_of_impossible_bands_is_refused(name: str, dtypes: list[str]) -> None:
    with pytest.raises(InputError, match=r"named like a .* rename a mask of your own"):
        kind_of(name, [None] * len(dtypes), dtypes)


@pytest.mark.parametrize(
    "name",
    [
        LANDSAT.replace("QA_PIXEL", "QA_RADSAT"),
        "LC08_L2SP_198030_20200809_20200918_02_T1_SR_QA_AEROSOL.TIF",
        "MSK_CLDPRB_20m.jp2",
        "MSK_QUALIT_B04.jp2",
        "T32TQM_20200809T100559_CLD_20m.jp2",
    ],
)
def test_other_quality_rasters_are_refused(name: str) -> None:
    """Cloud probabilities are 0 where there is none: as a mask of zeros they would keep the clouds only."""
    with pytest.raises(InputError, match="whose values are not read"):
        kind_of(name, [None], ["uint8"])


def test_landsat_words() -> None:
    words = np.array([[[CLEAR, WATER, SNOW, FILL, CLOUD, SHADOW, CIRRUS, DILATED]]], "uint16")
    assert accepted("QA_PIXEL", words).tolist() == [[True] * 3 + [False] * 5]


@pytest.mark.parametrize("bit", range(16))
def test_landsat_bits(bit: int) -> None:
    assert accepted("QA_PIXEL", np.full((1, 1, 1), 1 << bit, "uint16")).item() == (bit > 4)


# clear, saturated, water or snow; then fill, dropped or hidden, clouds, shadow, cirrus
@pytest.mark.parametrize(
    ("kept", "excluded"),
    [
        ((2720, 2724, 3744, 2732), (1, 2722, 2800, 2752, 6816, 2976)),  # Collection 1
        ((20480, 20512, 23552, 16384), (1, 20482, 20484, 53248, 36864, 28672, 61440, 24576)),  # before
    ],
)
def test_older_landsat_words(kept: tuple[int, ...], excluded: tuple[int, ...]) -> None:
    words = np.array([[[*kept, *excluded]]], "uint16")
    assert accepted("BQA", words).tolist() == [[True] * len(kept) + [False] * len(excluded)]


def test_scene_classes() -> None:
    kept = accepted("SCL", np.arange(12, dtype="uint8").reshape(1, 1, 12))
    assert np.flatnonzero(kept[0]).tolist() == [2, 4, 5, 6, 7, 11]


def test_classi_rejects_clouds_and_cirrus_not_snow(tmp_path: Path) -> None:
    raster = write(tmp_path / "a.tif", np.ones((2, 4), "uint8"))
    bands = np.zeros((3, 2, 4), "uint8")
    bands[0, 0, 0] = bands[1, 0, 1] = bands[2, 0, 2] = 1
    info = describe(raster, mask=write(tmp_path / CLASSI, bands))
    assert info.mask_kind == "MSK_CLASSI"
    valid = valid_in_mask_file(info, Window(0, 0, 2, 4))
    assert np.argwhere(~valid).tolist() == [[0, 0], [0, 1]]


def test_a_coarser_mask_counts_where_the_pixel_centres_lie(tmp_path: Path) -> None:
    """A 60 m mask on 10 m pixels, its corner 20 m off: no interpolation between classes."""
    raster = write(tmp_path / "a.tif", np.ones((24, 24), "uint8"))
    bands = np.zeros((3, 4, 5), "uint8")
    bands[0, 1, 2] = 1
    shifted = Affine(60, 0, 500_000 - 20, 0, -60, 5_000_000)
    info = describe(raster, mask=write(tmp_path / CLASSI, bands, shifted))
    expected = np.ones((24, 24), bool)
    expected[6:12, 10:16] = False
    assert (valid_in_mask_file(info, Window(0, 0, 24, 24)) == expected).all()
    assert (valid_in_mask_file(info, Window(5, 9, 9, 3)) == expected[5:14, 9:12]).all()


def test_a_mask_of_another_crs_counts_where_the_pixel_centres_lie(tmp_path: Path) -> None:
    raster = write(tmp_path / "a.tif", np.ones((40, 40), "uint8"))
    x, y = transform_points(UTM, "EPSG:32634", [500_200.0], [4_999_800.0])
    other = Affine(25, 0, x[0] - 25 * 40, 0, -25, y[0] + 25 * 40)
    classes = np.random.default_rng(1).choice(np.array([4, 9], "uint8"), (80, 80))
    mask = write(tmp_path / "x_SCL_20m.tif", classes, other, CRS.from_epsg(32634))
    col, row = np.meshgrid(np.arange(40) + 0.5, np.arange(40) + 0.5)
    there = transform_points(
        UTM, "EPSG:32634", (500_000 + 10 * col).ravel().tolist(), (5_000_000 - 10 * row).ravel().tolist()
    )
    mask_col, mask_row = Grid((80, 80), other, None).to_px(np.column_stack(there[:2])).T
    expected = classes[np.floor(mask_row).astype(int), np.floor(mask_col).astype(int)] == 4
    found = valid_in_mask_file(describe(raster, mask=mask), Window(0, 0, 40, 40)).ravel()
    # GDAL interpolates the transformation to 0.02 px: only centres as near to an edge may differ
    edge = np.abs(np.stack([mask_col, mask_row]) % 1 - 0.5).max(axis=0) > 0.5 - 0.03
    assert 200 < expected.sum() < 1400
    assert (found == expected)[~edge].all()


def test_a_quality_raster_of_another_size_without_georeferencing_is_refused(tmp_path: Path) -> None:
    raster = write(tmp_path / "a.tif", np.ones((8, 8), "uint8"))
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning):
        mask = write(tmp_path / LANDSAT, np.full((9, 8), CLEAR, "uint16"), Affine.identity(), None)
    with pytest.raises(InputError, match=r"8 x 9 pixels.*8 x 8.*no georeferencing"):
        describe(raster, mask=mask)


def test_clouds_hold_no_tie_points(tmp_path: Path) -> None:
    grid = make_grid((200, 200))
    reference = write_scene(tmp_path / "ref.tif", render(grid), grid)
    target = write_scene(tmp_path / "tgt.tif", 255 - render(grid, displacement_px=(1.3, -0.6)), grid)
    cloud = np.full((200, 200), CLEAR)
    cloud[60:140, 90:] = CLOUD
    mask = write_scene(tmp_path / LANDSAT, cloud.astype("uint16"), grid)
    settings = Settings(template=61, window=41, features=100, tgt_mask=mask)
    found = register_pair(reference, target, settings)
    assert found.status == "registered"
    at = found.tie_points.select("fit", "check", "unused").target_px
    assert len(at) > 20
    assert (cloud[tuple(np.floor(at[:, ::-1]).astype(int).T)] == CLEAR).all()


def test_bits_and_classes_of_hls_maja_and_planet() -> None:
    bits = np.array([[[1 << bit for bit in range(8)]]], "uint8")
    assert accepted("Fmask", bits).tolist() == [[False] * 4 + [True] * 4]
    for kind, values, kept in (  # of swaths
        ("CloudMask", [0, 1, 0b11, 0b101, 0b100001], [False, True, False, False, True]),
        ("Integer_Cloud_Mask", [255, 0, 1, 2, 3], [False, False, False, True, True]),
    ):
        assert accepted(kind, np.array([[values]], "uint8")).tolist() == [kept]
    assert accepted("CLM", np.array([[[0, 1, 16, 128]]], "uint8")).tolist() == [[True, False, False, False]]
    shadow, heavy_haze, cloud = (np.array([[0, *row]], "uint8") for row in np.eye(3, 5, dtype="uint8"))
    older = np.array([[0, 0, 0, 0, 1, 2]], "uint8")  # fill; the older mask's cloud, which may be snow
    kept = accepted("UDM2", np.stack([shadow, heavy_haze, cloud, older]))
    assert kept.tolist() == [[True, False, False, False, False, True]]


def test_only_masks_of_these_formats_are_read_as_such() -> None:
    """Fmask of other programs has classes, and 8 bands are the least of UDM2."""
    assert kind_of("LC08_Fmask.tif", [None], ["uint8"]) == "zeros"
    with pytest.raises(InputError, match="named like a UDM2 raster, which has 8 whole-number bands"):
        kind_of("x_udm2.tif", [None], ["uint8"])
    for name in (f"{HLS}.SZA.tif", f"{MAJA}_MG2_R1.tif", "20180605_092324_0f2b_3B_AnalyticMS_DN_udm.tif"):
        with pytest.raises(InputError, match="whose values are not read"):
            kind_of(name, [None], ["uint8"])
