"""Hyperspectral scenes of EnMAP and DESIS: bands by wavelength, masks, the two instruments.

All files are written by the tests from the published descriptions of the formats: they cannot show whether a
delivered scene has more, nor how far its instruments really lie apart.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rasterio

import pcwlad_geo
from pcwlad_geo.errors import InputError, SettingsError
from pcwlad_geo.multi.qa.bands import expand
from pcwlad_geo.multi.stack.inputs import listed
from pcwlad_geo.options import Settings
from pcwlad_geo.products.finding import find_product, of_one_product
from pcwlad_geo.products.product import Product
from pcwlad_geo.raster import describe, file_name
from pcwlad_geo.registration import resolve
from tests.delivered_files import CLOUD, DESIS, ENMAP, write_desis, write_enmap
from tests.product_files import packed

SMALL = {"template": 61, "window": 41, "features": 100}
Writer = Callable[..., Path]
BOTH = [
    pytest.param(write_enmap, f"{ENMAP}-QL_QUALITY_CLOUD.TIF", "QL_QUALITY_CLOUD", id="EnMAP"),
    pytest.param(write_desis, f"{DESIS}-QL_QUALITY-2.tif", "QL_QUALITY-2", id="DESIS"),
]


def product(path: Path) -> Product:
    found = find_product(path)
    assert found is not None
    return found


def chosen(path: Path, choice: int | str) -> list[int]:
    return [part.band for part in resolve(path, path, Settings(tgt_band=choice, ref_band=1)).tgt_bands.parts]


@pytest.mark.parametrize(("write", "mask", "kind"), BOTH)
def test_a_folder_an_archive_and_single_files_are_one_product(
    write: Writer, mask: str, kind: str, tmp_path: Path
) -> None:
    folder = write(tmp_path / "a b")
    image = next(folder.glob("*SPECTRAL_IMAGE*"))
    metadata = next(folder.glob("*METADATA*"))
    for path in (folder, packed(folder, ".zip"), packed(folder, ".tar"), metadata, image):
        found = product(path)
        assert found.band("B2").wavelength_nm == 660.0
        assert found.mask is not None
        assert file_name(found.mask) == mask
        info = describe(found.band("B2").opened_as(), band=2, mask=found.mask)
        assert (info.mask_kind, info.nodata) == (kind, -32768)
        assert chosen(path, "B3") == chosen(path, 3) == chosen(path, "668nm") == [3]


def test_wavelengths_choose_the_nearest_band_or_those_between(tmp_path: Path) -> None:
    folder = write_enmap(tmp_path)
    assert chosen(folder, "664nm") == [2]
    assert chosen(folder, "600-900nm") == [2, 3, 4]
    assert chosen(folder, "pca:600-1700nm") == [2, 3, 4, 6]  # water vapour darkens 1400 nm
    assert chosen(folder, "pca") == [1, 2, 3, 4, 6]
    assert chosen(folder, "550nm,B4") == [1, 4]
    assert chosen(folder, "1400nm") == [5]  # named on purpose
    assert [band.number for band in expand(f"{folder}:550nm,600-700nm")] == [1, 2, 3]
    with pytest.raises(InputError, match=r"no band at 700nm: it holds 6 from 550 to 1650 nm"):
        chosen(folder, "700nm")
    with pytest.raises(InputError, match=r"no band at 900-1600nm"):
        chosen(folder, "900-1600nm")
    with pytest.raises(SettingsError, match="665nm"):
        Settings(tgt_band="665 nanometres")


@pytest.mark.parametrize(("write", "mask", "kind"), BOTH)
def test_it_registers_whole_and_without_what_the_masks_exclude(
    write: Writer, mask: str, kind: str, tmp_path: Path
) -> None:
    shift_px = (1.3, -0.8)
    reference, target = write(tmp_path / "ref"), write(tmp_path / "tgt", shift_px=shift_px)
    out = tmp_path / "out"
    options = {"ref_band": "pca:540-700nm", "tgt_band": "665nm", "out_dir": out}
    found = pcwlad_geo.register(reference, target, **options, **SMALL)
    assert found.target.mask_kind == kind
    assert found.warnings == ()
    points = found.tie_points.select("fit", "check", "unused")
    moved = np.median(points.target_px - points.reference_px, axis=0)
    assert moved == pytest.approx(shift_px, abs=0.1)
    col, row = points.target_px.T
    excluded = [CLOUD]
    if write is write_enmap:
        excluded += [(slice(60, 130), slice(110, 130)), (slice(200, 240), slice(200, 240))]
    for rows, cols in excluded:
        assert not ((col > cols.start) & (col < cols.stop) & (row > rows.start) & (row < rows.stop)).any()
    (cube,) = out.glob("*_registered.tif")
    spectra = next(target.glob("*SPECTRAL_IMAGE*"))
    with rasterio.open(cube) as made, rasterio.open(spectra) as delivered:
        assert (made.count, made.dtypes, made.nodata) == (delivered.count, delivered.dtypes, -32768)
    with rasterio.open(next(out.glob("*_corrected.vrt"))) as moved_only, rasterio.open(spectra) as delivered:
        assert (moved_only.read() == delivered.read()).all()  # spectra as they were delivered


def test_instruments_that_lie_apart_are_not_corrected_as_one(tmp_path: Path) -> None:
    """Level 1B: each has its own pixels, and a band of one tells nothing of the place of the other."""
    scene = ENMAP.replace("L2A", "L1B")
    folder = write_enmap(tmp_path, scene=scene, images=("SPECTRAL_IMAGE_VNIR", "SPECTRAL_IMAGE_SWIR"))
    found = product(folder)
    assert [(band.name, band.number) for band in found.bands[2:4]] == [("B3", 3), ("B4", 1)]
    assert found.band("B3").uri.endswith("VNIR.TIF")
    assert [band.name for band in found.chosen("1650nm")] == ["B6"]
    inputs = resolve(folder, folder, Settings(ref_band="665nm", tgt_band="1650nm"), all_bands=True)
    assert inputs.other_bands == ()
    assert any("have pixels of their own" in note for note in inputs.notes)
    assert inputs.settings.tgt_mask is None
    with pytest.raises(InputError, match="say which band by name"):
        resolve(folder, folder, Settings())
    alone = product(folder / f"{scene}-SPECTRAL_IMAGE_SWIR.TIF")
    assert [band.number for band in alone.chosen("pca")] == [1, 3]
    (folder / f"{scene}-SPECTRAL_IMAGE_VNIR.TIF").unlink()
    with pytest.raises(InputError, match=rf"lacks {scene}-SPECTRAL_IMAGE_VNIR\.TIF: add it"):
        find_product(folder)


@pytest.mark.parametrize("ending", ["", ".zip"])
@pytest.mark.parametrize(
    ("removed", "message"),
    [
        ("-METADATA.XML", rf"lacks {ENMAP}-METADATA\.XML, which tells the wavelengths"),
        ("-SPECTRAL_IMAGE.TIF", rf"parts of a scene of EnMAP without its image: add {ENMAP}-SPECTRAL_IMAGE"),
        ("-QL_QUALITY_CIRRUS.TIF", rf"no quality raster \({ENMAP}-QL_QUALITY_CIRRUS\.TIF\)"),
    ],
)
def test_what_is_missing_is_named(removed: str, message: str, ending: str, tmp_path: Path) -> None:
    folder = write_enmap(tmp_path)
    (folder / f"{ENMAP}{removed}").unlink()
    given = packed(folder, ending) if ending else folder
    if "CIRRUS" in removed:
        assert [note for note in product(given).notes(masked=False) if re.search(message, note)]
        return
    with pytest.raises(InputError, match=message):
        resolve(given, given, Settings())


def test_damaged_scenes_are_refused(tmp_path: Path) -> None:
    folder = write_enmap(tmp_path)
    metadata = folder / f"{ENMAP}-METADATA.XML"
    text = metadata.read_text()
    metadata.write_text(text.replace("1650.0", "far"))
    with pytest.raises(InputError, match=r"METADATA.XML of .* cannot be understood"):
        find_product(folder)
    first = '<bandID number="1"><wavelengthCenterOfBand>550.0</wavelengthCenterOfBand>'
    metadata.write_text(text.replace(first, '<bandID number="1">'))
    with pytest.raises(InputError, match=r"METADATA.XML describes 5 bands, and the images of .* hold 6"):
        find_product(folder)


def test_an_image_without_its_metadata_is_a_raster_as_before(tmp_path: Path) -> None:
    folder = write_enmap(tmp_path)
    image = folder / f"{ENMAP}-SPECTRAL_IMAGE.TIF"
    (folder / f"{ENMAP}-METADATA.XML").unlink()
    assert find_product(image) is None
    assert chosen(image, "pca:1-3") == [1, 2, 3]


def test_scenes_of_a_stack_keep_their_masks(tmp_path: Path) -> None:
    folders = [write_desis(tmp_path, scene=DESIS.replace("20220404", f"2022040{day}")) for day in (4, 5)]
    images = list(listed(folders, "665nm"))
    assert [(image.date, image.describe().band) for image in images] == [("2022-04-04", 2), ("2022-04-05", 2)]
    assert {image.describe().mask_kind for image in images} == {"QL_QUALITY-2"}
    files = [str(next(folder.glob("*SPECTRAL_IMAGE*"))) for folder in folders]
    assert not of_one_product(*files)
