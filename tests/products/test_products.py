from __future__ import annotations

import tarfile
import zipfile
from pathlib import Path

import numpy as np
import pytest
import rasterio

from pcwlad_geo.errors import InputError
from pcwlad_geo.products.finding import find_product, native_px_m, of_one_product, stem_of
from pcwlad_geo.products.names import rasters_of
from pcwlad_geo.products.product import Product
from pcwlad_geo.raster import describe, file_name
from tests.product_files import (
    BEFORE_COLLECTIONS,
    COLLECTION_1,
    LANDSAT,
    SAFE,
    packed,
    write_landsat,
    write_safe,
)


def product(path: Path) -> Product:
    found = find_product(path)
    assert found is not None
    return found


def names(found: Product) -> list[str]:
    return [band.name for band in found.bands]


@pytest.mark.parametrize("metadata", ["txt", "json", "xml"])
def test_landsat_folder_and_mtl(metadata: str, tmp_path: Path) -> None:
    scene = write_landsat(tmp_path, metadata=metadata)
    for path in (scene, scene / f"{LANDSAT}_MTL.{metadata}"):
        found = product(path)
        assert found.kind == "Landsat Collection 2 L1TP"
        assert names(found) == ["B4", "B8", "B10"]
        assert found.band("b4").uri == str(scene / f"{LANDSAT}_B4.TIF")
        assert found.band("B04") == found.band("B4")
        assert found.mask == str(scene / f"{LANDSAT}_QA_PIXEL.TIF")
        assert [band.name for band in found.others(found.band("B10"))] == ["B4", "B8"]
        assert stem_of(path) == LANDSAT


def test_landsat_level_2_takes_bands_by_either_name(tmp_path: Path) -> None:
    """Its MTL lists the files of the level 1 as well: these do not count as missing."""
    name = LANDSAT.replace("L1TP", "L2SP")
    found = product(write_landsat(tmp_path, name=name, bands=("SR_B4", "ST_B10")))
    assert names(found) == ["SR_B4", "ST_B10"]
    assert found.band("B10") == found.band("ST_B10")
    assert found.missing == ()


@pytest.mark.parametrize(
    ("name", "collection", "words", "kind"),
    [
        (LANDSAT.replace("_02_T1", "_01_T1"), "01", COLLECTION_1, "Landsat Collection 1 L1TP"),
        ("LC81980302020222LGN00", None, BEFORE_COLLECTIONS, "pre-Collection Landsat"),
        ("crop", None, BEFORE_COLLECTIONS, "pre-Collection Landsat"),
        ("my.crop", "01", COLLECTION_1, "Landsat Collection 1"),
        ("x", "02", ("QA_PIXEL", 21824, 22280), "Landsat Collection 2"),
    ],
)
@pytest.mark.parametrize("ending", ["", ".zip"])
def test_older_and_renamed_scenes_are_products(
    name: str, collection: str | None, words: tuple[str, int, int], kind: str, ending: str, tmp_path: Path
) -> None:
    given = {"name": name, "collection": collection, "quality_values": words}
    scene = write_landsat(tmp_path, bands=("B4", "B8", "B9", "B10"), **given)
    found = product(packed(scene, ending) if ending else scene)
    assert (found.kind, names(found), found.missing) == (kind, ["B4", "B8", "B9", "B10"], ())
    assert [band.name for band in found.showing_ground()] == ["B4", "B8", "B10"]
    assert found.mask is not None
    assert file_name(found.mask) == f"{name}_{words[0]}.TIF"
    info = describe(found.band("B4").opened_as(), mask=found.mask)
    assert (info.mask_kind, info.nodata) == (words[0], 0)
    assert product(scene / f"{name}_MTL.txt").kind == kind
    (scene / f"{name}_B8.TIF").unlink()
    assert product(scene).missing == (("B8",) if name.startswith("L") else ())


def test_an_mtl_alone_makes_no_product(tmp_path: Path) -> None:
    """Others name texts so too; a folder of rasters stays one, without its quality rasters."""
    for name in ("site_MTL.txt", "site.tif", "other_B4.tif", "other_BQA.tif", "T32TQM_SCL.tif"):
        (tmp_path / name).touch()
    assert find_product(tmp_path) is None
    assert rasters_of(tmp_path) == [str(tmp_path / name) for name in ("other_B4.tif", "site.tif")]


def test_a_folder_of_jpegs_holds_frames_unless_it_holds_rasters(tmp_path: Path) -> None:
    for name in ("DJI_0002.JPG", "DJI_0001.jpg", "notes.txt"):
        (tmp_path / name).touch()
    assert rasters_of(tmp_path) == [str(tmp_path / name) for name in ("DJI_0001.jpg", "DJI_0002.JPG")]
    (tmp_path / "mosaic.tif").touch()
    assert rasters_of(tmp_path) == [str(tmp_path / "mosaic.tif")]


def test_bands_of_one_product_are_known_by_their_names(tmp_path: Path) -> None:
    crop = write_landsat(tmp_path, name="crop", collection=None, quality_values=BEFORE_COLLECTIONS)
    four, ten = (str(crop / f"crop_B{number}.TIF") for number in (4, 10))
    assert of_one_product(four, f"vrt://{ten}?a_nodata=0")
    assert not of_one_product(four, str(tmp_path / "crop_B10.TIF"))
    (crop / "crop_MTL.txt").unlink()
    assert not of_one_product(four, ten)
    assert of_one_product(f"a/{LANDSAT}_B4.TIF", f"/vsitar/b.tar/{LANDSAT}_ST_B10.TIF")
    assert of_one_product("LE71980302000222LGN00_B4.TIF", "b/LE71980302000222LGN00_B6_VCID_1.TIF")
    assert of_one_product("T32TQM_20230809T100559_B04_10m.jp2", "T32TQM_20230809T100559_B8A_20m.jp2")
    assert not of_one_product(f"{LANDSAT}_B4.TIF", f"{LANDSAT.replace('20200809', '20200825')}_B4.TIF")
    assert not of_one_product(f"{LANDSAT}_B4.TIF", f"{LANDSAT}_QA_PIXEL.TIF")
    assert not of_one_product("site_B4.tif", "site_B5.tif")


def test_native_pixels_of_older_names() -> None:
    sizes = [native_px_m(f"LC81980302020222LGN00_B{band}", None) for band in (4, 8, 10)]
    assert sizes == [30.0, 15.0, 100.0]


def test_landsat_7_has_two_bands_6(tmp_path: Path) -> None:
    name = "LE07_L1TP_198030_20000809_20200918_02_T1"
    found = product(write_landsat(tmp_path, name=name, bands=("B4", "B6_VCID_1", "B6_VCID_2")))
    assert names(found) == ["B4", "B6_VCID_1", "B6_VCID_2"]
    with pytest.raises(InputError, match=r"band B6 of .* is missing"):
        found.band("B6")


@pytest.mark.parametrize("ending", [".tar", ".tar.gz", ".zip"])
def test_packed_products_open_in_place(ending: str, tmp_path: Path) -> None:
    scene = write_landsat(tmp_path / "a b", bands=("B4", "B10"))
    found = product(packed(scene, ending, with_folder=False))
    assert names(found) == ["B4", "B10"]
    assert found.missing == ()
    with (
        rasterio.open(found.band("B10").opened_as()) as inside,
        rasterio.open(scene / f"{LANDSAT}_B10.TIF") as plain,
    ):
        assert (inside.read() == plain.read()).all()
    assert found.mask is not None
    assert file_name(found.mask) == f"{LANDSAT}_QA_PIXEL.TIF"
    # the way of a mask through pathlib must leave it as it is
    assert str(Path(found.mask)) == found.mask


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A SAFE folder and the folder of a Landsat scene."""
    folder = tmp_path_factory.mktemp("folders")
    return write_safe(folder / "s", level="L2A"), write_landsat(folder / "l", bands=("B4", "B10"))


@pytest.mark.parametrize("ending", [".tar", ".tar.gz"])
@pytest.mark.parametrize("prefix", ["", "./", "home/somebody/"])
@pytest.mark.parametrize("header", [tarfile.PAX_FORMAT, tarfile.GNU_FORMAT, tarfile.USTAR_FORMAT])
def test_products_packed_by_tarfile_open(
    header: int, prefix: str, ending: str, folders: tuple[Path, Path], tmp_path: Path
) -> None:
    """Folders are members too, and names of more than 100 characters stand where GDAL does not look."""
    for folder, band in zip(folders, ("B04", "B10"), strict=True):
        archive = tmp_path / f"{folder.name}{ending}"
        with tarfile.open(archive, "w:gz" if ending == ".tar.gz" else "w", format=header) as tar:
            tar.add(folder, f"{prefix}{folder.name}")
        packed_up, as_it_was = product(archive), product(folder)
        assert names(packed_up) == names(as_it_was)
        assert packed_up.missing == ()
        assert packed_up.mask is not None
        assert as_it_was.mask is not None
        for inside, outside in (
            (packed_up.band(band).opened_as(), as_it_was.band(band).opened_as()),
            (packed_up.mask, as_it_was.mask),
        ):
            assert file_name(inside) == file_name(outside)
            with rasterio.open(inside) as file, rasterio.open(outside) as plain:
                np.testing.assert_array_equal(file.read(), plain.read())
                assert (file.transform, file.scales, file.nodata) == (
                    plain.transform,
                    plain.scales,
                    plain.nodata,
                )
        assert describe(packed_up.band(band).opened_as(), mask=packed_up.mask).mask_kind in (
            "SCL",
            "QA_PIXEL",
        )


@pytest.mark.parametrize("level", ["L1C", "L2A"])
@pytest.mark.parametrize("ending", ["", ".zip"])
def test_sentinel2_finds_the_finest_bands_and_the_mask(level: str, ending: str, tmp_path: Path) -> None:
    safe = write_safe(tmp_path, level=level, sizes=(("B04", 10), ("B04", 20), ("B8A", 20), ("B01", 60)))
    found = product(packed(safe, ending) if ending else safe)
    assert found.kind == f"Sentinel-2 {level}"
    assert names(found) == ["B01", "B04", "B8A"]
    assert found.band("B4") == found.band("b04")
    size = "_10m" if level == "L2A" else ""
    assert file_name(found.band("B4").uri) == f"T32TQM_20230809T100559_B04{size}.jp2"
    assert found.mask is not None
    expected = "T32TQM_20230809T100559_SCL_20m.jp2" if level == "L2A" else "MSK_CLASSI_B00.jp2"
    assert file_name(found.mask) == expected
    if level == "L2A":
        coarse = found.band("B04_20m")
        assert file_name(coarse.uri) == "T32TQM_20230809T100559_B04_20m.jp2"
        assert [band.name for band in found.others(coarse)] == ["B01", "B8A"]


@pytest.mark.parametrize(("offset", "level"), [(-1000, "L2A"), (-1000, "L1C"), (0, "L1C")])
def test_sentinel2_nodata_is_zero_of_the_stored_numbers(offset: int, level: str, tmp_path: Path) -> None:
    """Numbers from 1 to 999 are dark pixels of negative reflectance, not nodata."""
    band = product(write_safe(tmp_path, level=level, offset=offset)).band("B04")
    with rasterio.open(band.opened_as()) as opened, rasterio.open(band.uri) as plain:
        assert plain.nodata is None
        assert (opened.nodata, opened.scales, opened.offsets) == (0, (1e-4,), (offset / 1e4,))
        values = opened.read(1)
        assert (values == plain.read(1)).all()
        assert ((values > 0) & (values < 1000)).sum() > 100
        assert ((opened.read_masks(1) == 0) == (values == 0)).all()
    assert file_name(band.opened_as()) == file_name(band.uri)


@pytest.mark.parametrize("folder", ["a b", "a&b#c", "a%20b", "ä=+,'", ":c"])
def test_odd_paths_keep_nodata(folder: str, tmp_path: Path) -> None:
    band = product(write_safe(tmp_path / folder)).band("B04")
    with rasterio.open(band.opened_as()) as opened:
        assert opened.nodata == 0


def test_a_question_mark_would_lose_nodata(tmp_path: Path) -> None:
    band = product(write_safe(tmp_path / "a?b")).band("B04")
    with pytest.raises(InputError, match=r"holds a '\?'.*rename it"):
        band.opened_as()


def test_the_shadows_that_macos_packs_are_no_bands(tmp_path: Path) -> None:
    safe = write_safe(tmp_path)
    for band in sorted(safe.rglob("*_B0*.jp2")):
        shadow = tmp_path / "__MACOSX" / band.relative_to(tmp_path)
        shadow.parent.mkdir(parents=True, exist_ok=True)
        shadow.with_name(f"._{band.name}").write_bytes(b"shadow")
    archive = tmp_path / "mac.zip"
    with zipfile.ZipFile(archive, "w") as made:
        for path in sorted(tmp_path.rglob("*")):
            if path.is_file() and path != archive:
                made.write(path, path.relative_to(tmp_path).as_posix())
    found = product(archive)
    assert [file_name(band.uri) for band in found.bands] == [
        file_name(band.uri) for band in product(safe).bands
    ]


def test_the_metadata_file_stands_for_its_folder(tmp_path: Path) -> None:
    safe = write_safe(tmp_path)
    assert names(product(safe / "MTD_MSIL2A.xml")) == names(product(safe))
    assert stem_of(safe / "MTD_MSIL2A.xml") == stem_of(safe) == SAFE.removesuffix(".SAFE")


def test_missing_bands_are_told(tmp_path: Path) -> None:
    scene = write_landsat(tmp_path)
    (scene / f"{LANDSAT}_B8.TIF").unlink()
    found = product(scene)
    assert found.band("B4").name == "B4"
    with pytest.raises(InputError, match=r"band B8 of .* is missing: it holds B4, B10; .*list B8 besides"):
        found.band("B8")
    with pytest.raises(InputError, match=r"lacks bands that its metadata list: B8; complete it"):
        found.others(found.band("B10"))
    safe = write_safe(tmp_path)
    next(safe.rglob("*_B05_20m.jp2")).unlink()
    assert product(safe).missing == ("B05",)


def test_bands_have_names(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"say which band by name .*it holds B4, B8, B10"):
        product(write_landsat(tmp_path)).band(1)


def test_what_is_no_product(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for path in (tmp_path / "empty", tmp_path / "absent", "vrt://a.tif?bands=1", "/vsicurl/http://a/b.zip"):
        assert find_product(path) is None
    archive = packed(write_safe(tmp_path), ".zip")
    archive.write_bytes(archive.read_bytes()[:-100])
    with pytest.raises(InputError, match="cannot be read: it may be damaged"):
        find_product(archive)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "a.txt").write_text("a")
    with pytest.raises(InputError, match="holds no Landsat and no Sentinel product"):
        find_product(packed(tmp_path / "other", ".tar"))


def test_several_products_and_another_collection_are_refused(tmp_path: Path) -> None:
    scene = write_landsat(tmp_path, bands=("B4",))
    other = write_landsat(tmp_path, bands=("B4",), name=LANDSAT.replace("20200809", "20200825"))
    for path in other.iterdir():
        path.rename(scene / path.name)
    with pytest.raises(InputError, match=r"holds 2 Landsat scenes .*give the MTL file of one"):
        find_product(scene)
    assert names(product(scene / f"{LANDSAT}_MTL.txt")) == ["B4"]
    later = write_landsat(tmp_path, bands=("B4",), name=LANDSAT.replace("_02_T1", "_03_T1"))
    with pytest.raises(InputError, match="no product of Landsat Collection 1 or 2"):
        find_product(later)
    safe = write_safe(tmp_path)
    granule = next((safe / "GRANULE").iterdir())
    second = granule.with_name("L2A_T32TQN_A033557_20230809T100559")
    (second / "IMG_DATA").mkdir(parents=True)
    next(granule.rglob("*_B04_10m.jp2")).rename(second / "IMG_DATA" / "T32TQN_20230809T100559_B04_10m.jp2")
    with pytest.raises(InputError, match="holds 2 granules"):
        find_product(safe)


def test_products_of_both_kinds_in_one_folder_are_refused(tmp_path: Path) -> None:
    write_landsat(tmp_path, bands=("B4",))
    write_safe(tmp_path)
    with pytest.raises(InputError, match="a Landsat and a Sentinel-2 product: give the folder of one"):
        find_product(tmp_path)


def test_damaged_metadata_are_told(tmp_path: Path) -> None:
    safe = write_safe(tmp_path)
    (safe / "MTD_MSIL2A.xml").write_text("<a>")
    with pytest.raises(InputError, match=r"MTD_MSIL2A\.xml of .* cannot be understood"):
        find_product(safe)


def test_a_band_that_declares_its_nodata_is_opened_as_it_is(tmp_path: Path) -> None:
    band = product(write_landsat(tmp_path, bands=("B4",))).band("B4")
    assert band.opened_as() == band.uri
