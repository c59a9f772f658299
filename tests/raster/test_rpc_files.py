from pathlib import Path

import numpy as np
import pytest
import rasterio

from pcwlad_geo.errors import InputError
from pcwlad_geo.raster.rpc.domain import check_domain
from pcwlad_geo.raster.rpc.files import RpcSource, parse_rpc_text, read_rpc, write_rpc_text
from pcwlad_geo.raster.rpc.model import RpcModel
from tests.rpc_scene import SHAPE, make_rpc, of_a_product, renormalised, write_image

PIXELS = np.ones(SHAPE, np.uint8)


def apart_px(first: RpcModel, second: RpcModel) -> float:
    ground = np.array([[first.long_off + 0.01, first.lat_off - 0.02, 380.0]])
    return float(np.abs(first.to_px(ground) - second.to_px(ground)).max())


def test_the_tag_is_read(tmp_path: Path) -> None:
    image = write_image(tmp_path / "image.tif", PIXELS, make_rpc())
    source = read_rpc(str(image))
    assert source is not None
    assert apart_px(source.rpc, make_rpc()) < 1e-9
    assert source.warnings == ()
    assert "tag" in source.origin


def test_none_where_there_is_none(tmp_path: Path) -> None:
    assert read_rpc(str(write_image(tmp_path / "image.tif", PIXELS, None))) is None


@pytest.mark.parametrize(("option", "name"), [("RPB", "image.RPB"), ("RPCTXT", "image_RPC.TXT")])
def test_sidecars_of_gdal_are_read(tmp_path: Path, option: str, name: str) -> None:
    write_image(tmp_path / "image.tif", PIXELS, make_rpc(), **{option: "YES", "PROFILE": "BASELINE"})
    assert apart_px(parse_rpc_text(tmp_path / name), make_rpc()) < 1e-6
    source = read_rpc(str(tmp_path / "image.tif"))
    assert source is not None
    assert source.origin == str(tmp_path / name)
    assert source.warnings == ()


@pytest.mark.parametrize("name", ["image.RPB", "image_RPC.TXT", "image_rpc.txt"])
def test_a_stale_sidecar_is_used_as_gdal_does_and_told(tmp_path: Path, name: str) -> None:
    option = "RPB" if name.endswith("RPB") else "RPCTXT"
    other = write_image(tmp_path / "other.tif", PIXELS, make_rpc(samp_off=170.0), **{option: "YES"})
    image = write_image(tmp_path / "image.tif", PIXELS, make_rpc())
    (other.with_suffix(".RPB") if option == "RPB" else tmp_path / "other_RPC.TXT").rename(tmp_path / name)
    source = read_rpc(str(image))
    assert source is not None
    with rasterio.open(image) as file:
        assert source.rpc.samp_off == file.rpcs.samp_off
    (warning,) = source.warnings
    assert name in warning
    assert "tag" in warning
    assert "10.5 px" in warning
    used = "tag" if source.rpc.samp_off == make_rpc().samp_off else name
    assert warning.endswith("delete or rewrite it")
    assert f"the one in {source.origin} is used" in warning
    assert used in source.origin


def test_a_sidecar_that_says_the_same_is_no_matter(tmp_path: Path) -> None:
    image = write_image(tmp_path / "image.tif", PIXELS, make_rpc(), RPCTXT="YES", RPB="YES")
    source = read_rpc(str(image))
    assert source is not None
    assert source.warnings == ()


def test_gdal_reads_the_text_that_we_write_to_the_last_bit(tmp_path: Path) -> None:
    rpc = make_rpc(samp_off=12.123456789012345, line_scale=1234.5678901234567)
    write_image(tmp_path / "image.tif", PIXELS, None)
    write_rpc_text(rpc, tmp_path / "image_RPC.TXT")
    with rasterio.open(tmp_path / "image.tif") as file:
        found = file.rpcs
    assert found.samp_off == rpc.samp_off
    assert found.line_scale == rpc.line_scale
    assert tuple(found.line_num_coeff) == rpc.line_num_coeff
    assert parse_rpc_text(tmp_path / "image_RPC.TXT") == rpc


def test_a_sidecar_beside_a_format_that_gdal_looks_not_for_it_counts(tmp_path: Path) -> None:
    from rasterio.shutil import copy

    write_image(tmp_path / "image.tif", PIXELS, None)
    copy(str(tmp_path / "image.tif"), str(tmp_path / "seen.vrt"), driver="VRT")
    write_rpc_text(make_rpc(), tmp_path / "seen_RPC.TXT")
    source = read_rpc(str(tmp_path / "seen.vrt"))
    assert source is not None
    assert source.rpc == make_rpc()


def test_an_incomplete_sidecar_is_an_error(tmp_path: Path) -> None:
    image = write_image(tmp_path / "image.tif", PIXELS, make_rpc())
    write_rpc_text(make_rpc(), tmp_path / "image_RPC.TXT")
    text = (tmp_path / "image_RPC.TXT").read_text()
    (tmp_path / "image_RPC.TXT").write_text(
        text.replace("LINE_OFF", "LINE_ODD").replace("SAMP_NUM_COEFF_7", "X")
    )
    with pytest.raises(InputError, match=r"image_RPC\.TXT lacks LINE_OFF, SAMP_NUM_COEFF"):
        read_rpc(str(image))


@pytest.mark.parametrize("shape", [(900, 320), (300, 700)])
def test_an_image_far_beyond_its_rpc_is_an_error(shape: tuple[int, int]) -> None:
    with pytest.raises(InputError, match="a cropped or a decimated image"):
        check_domain(RpcSource(make_rpc(), "the tag", ()), "image.tif", shape)


def test_an_image_of_its_rpc_and_a_crop_of_it_are_not() -> None:
    check_domain(RpcSource(make_rpc(), "the tag", ()), "image.tif", SHAPE)
    cropped = make_rpc(samp_off=make_rpc().samp_off - 100, line_off=make_rpc().line_off - 100)
    check_domain(RpcSource(cropped, "the tag", ()), "image.tif", (100, 100))


def test_a_scale_of_zero_is_an_error() -> None:
    with pytest.raises(InputError, match="scale of zero"):
        check_domain(RpcSource(make_rpc(lat_scale=0.0), "the tag", ()), "image.tif", SHAPE)


def test_a_part_cut_from_a_product_is_judged_by_its_place() -> None:
    rpc = of_a_product(make_rpc())
    assert rpc.line_off < -20 * rpc.line_scale
    check_domain(RpcSource(rpc, "the tag", ()), "part.tif", SHAPE)
    check_domain(RpcSource(rpc, "the tag", ()), "part.tif", SHAPE, (100.0, 700.0))


def test_an_image_beside_what_its_rpc_describes_is_an_error_that_can_be_overruled() -> None:
    # the offsets are those of the image, the ground is not
    source = RpcSource(renormalised(make_rpc(), [3.0, 0.0, 0.0], [1.0, 1.0, 1.0]), "the tag", ())
    with pytest.raises(InputError, match=r"describes longitude .* and puts image\.tif .*--trust-rpc"):
        check_domain(source, "image.tif", SHAPE)
    check_domain(source, "image.tif", SHAPE, trusted=True)


def test_an_image_that_its_rpc_folds_is_an_error() -> None:
    bent = tuple(4.0 if term == 7 else value for term, value in enumerate(make_rpc().samp_num_coeff))
    with pytest.raises(InputError, match="no plausible ground"):
        check_domain(RpcSource(make_rpc(samp_num_coeff=bent), "the tag", ()), "image.tif", SHAPE)
