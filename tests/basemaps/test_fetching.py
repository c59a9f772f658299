"""A target on a web map: a server on this machine gives parts of a raster, whose result is known."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
import rasterio.warp

import pcwlad_geo
from pcwlad_geo.basemaps import fetching
from pcwlad_geo.basemaps.services import find_service
from pcwlad_geo.cli.app import run
from pcwlad_geo.errors import TrustError
from pcwlad_geo.events import Event, Progress
from pcwlad_geo.job import match_files
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Grid
from pcwlad_geo.registration import prepare_pair
from tests.basemaps.server import ZOOM, MapServer, capabilities, map_grid, serving
from tests.scenes import make_grid, render, write

PHOTO: Any = {"template": 61, "window": 41, "features": 60, "model": "shift"}
SMALL: Any = {**PHOTO, "prealign": "georef"}
QUICK: Any = {**SMALL, "no_report": True}
OPTIONS = ["--template", "61", "--window", "41", "--features", "60", "--model", "shift", "--allow-remote"]
OPTIONS += ["--prealign", "georef"]
TARGET = make_grid((250, 260), pixel_m=28.6, offset_m=(9_000, 8_000))
SHIFT_PX = np.array([3.4, -2.7])
PLACE = TARGET.transform.to_gdal()


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """The raster that is served, the target, and the same without georeferencing."""
    folder, grid = tmp_path_factory.mktemp("map"), map_grid()
    pixels = np.clip(render(grid, noise=0.5), 1, 254).astype(np.uint8)
    reference = folder / "reference.tif"
    profile = {"driver": "GTiff", "count": 1, "dtype": "uint8", "crs": grid.crs, "transform": grid.transform}
    with rasterio.open(reference, "w", height=768, width=768, **profile) as file:
        file.write(pixels, 1)
    seen = render(TARGET, "thermal", displacement_px=SHIFT_PX)
    return reference, write(folder / "photo.tif", seen, TARGET), write(folder / "plain.tif", seen, None)


@pytest.fixture
def server(
    files: tuple[Path, Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[MapServer]:
    monkeypatch.chdir(tmp_path)
    with serving(files[0]) as server:
        yield server


def place_of(folder: str) -> np.ndarray:
    """Return the corners of the corrected target, map coordinates."""
    with rasterio.open(next(Path(folder).glob("*_corrected.vrt"))) as file:
        return Grid(file.shape, file.transform, file.crs).to_xy(np.array([[0.0, 0.0], [260.0, 250.0]]))


def test_tiles_of_a_raster_give_the_result_of_the_raster(
    files: tuple[Path, Path, Path], server: MapServer
) -> None:
    reference, target, _ = files
    by_file = pcwlad_geo.register(reference, target, out_dir="file", **QUICK)
    by_map = pcwlad_geo.register(server.xyz, target, out_dir="map", allow_remote=True, **SMALL)
    off_px = (place_of("map") - place_of("file")) / 28.6
    assert np.hypot(*off_px.T).max() <= 0.1
    for found in (by_file, by_map):
        np.testing.assert_allclose(np.median(found.tie_points.displacement_px, axis=0), SHIFT_PX, atol=0.15)
    assert max(server.asked.values()) == 1
    assert server.most_at_once <= 4
    assert all(agent.startswith("pcwlad-geo/") for agent in server.agents)
    place = Path("map/basemap.tif").absolute()
    assert by_map.reference.uri == str(place)
    report = json.loads(Path("map/report.json").read_text(encoding="utf-8"))
    assert (report["reference"]["path"], report["inputs"][0]["path"]) == (str(place), str(place))
    assert "basemap.tif" in report["outputs"]
    basemap = report["reference"]["basemap"]
    assert basemap["name"] == f"{server.address}/tiles/{{z}}/{{x}}/{{y}}.png"
    assert basemap["pixel_m"] == pytest.approx(28.6, rel=0.01)
    assert Path("map/report.html").read_text(encoding="utf-8").count("relative to the basemap") == 1
    assert not any(b"secret" in file.read_bytes() for file in Path("map").iterdir())
    (again,) = pcwlad_geo.warp("map", [target], out_dir="warped")
    assert again.exists()


def test_the_command_says_once_what_the_accuracy_is_relative_to(
    files: tuple[Path, Path, Path], server: MapServer, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["register", server.xyz, str(files[1]), "-o", "map", *OPTIONS, "--ref-zoom", str(ZOOM)]) == 0
    text = capsys.readouterr().out
    assert text.count("relative to the basemap") == 1
    assert "(28.7 m a pixel, fetched 20" in text
    assert (
        run(["register", server.xyz, str(files[1]), "-o", "map", *OPTIONS, "--overwrite", "--no-report"]) == 0
    )


def test_a_wms_is_fetched_too(files: tuple[Path, Path, Path], server: MapServer) -> None:
    left, top = map_grid().to_xy(np.array([[0.0, 0.0]]))[0].tolist()
    right, bottom = map_grid().to_xy(np.array([[1024.0, 1024.0]]))[0].tolist()
    box = ",".join(map(repr, [left, bottom, right, top]))
    name = f"WMS:{server.address}/wms?LAYERS=ortho&SRS=EPSG:3857&BBOX={box}"
    found = match_files(name, files[1], out_dir="map", allow_remote=True, **QUICK)
    np.testing.assert_allclose(np.median(found.tie_points.displacement_px, axis=0), SHIFT_PX, atol=0.15)
    assert all("REQUEST=GetMap" in path and "WIDTH=512" in path for path in server.asked)
    assert found.reference.basemap.name == f"{server.address}/wms (ortho)"
    corners = {"UpperLeftX": left, "UpperLeftY": top, "LowerRightX": right, "LowerRightY": bottom}
    described = (
        f"<GDAL_WMS><Service name='WMS'><ServerUrl>{server.address}/wms?</ServerUrl><Layers>ortho</Layers>"
        "<SRS>EPSG:3857</SRS></Service><DataWindow>"
        + "".join(f"<{tag}>{value}</{tag}>" for tag, value in corners.items())
        + "</DataWindow></GDAL_WMS>"
    )
    Path("wms.xml").write_text(described, encoding="utf-8")
    before = set(server.asked)
    match_files("wms.xml", files[1], out_dir="again", allow_remote=True, **QUICK)
    assert {path.partition("BBOX")[2] for path in set(server.asked)} == {
        path.partition("BBOX")[2] for path in before
    }


def test_a_wmts_is_fetched_by_its_capabilities(files: tuple[Path, Path, Path], server: MapServer) -> None:
    name = f"WMTS:{server.address}/wmts.xml,layer=ortho"
    found = pcwlad_geo.register(name, files[1], out_dir="map", allow_remote=True, **QUICK)
    by_tiles = pcwlad_geo.register(server.xyz, files[1], out_dir="tiles", allow_remote=True, **QUICK)
    assert found.reference.basemap.name == f"{server.address}/wmts.xml (Orthophoto)"
    assert server.asked["/wmts.xml"] == 1
    tiles = {path for path in server.asked if path.startswith(f"/ortho/default/2020/google/z{ZOOM}/")}
    assert len(tiles) == sum(path.startswith(f"/tiles/{ZOOM}/") for path in server.asked) > 1
    np.testing.assert_allclose(place_of("map"), place_of("tiles"), atol=0.01 * 28.6)
    np.testing.assert_allclose(np.median(found.tie_points.displacement_px, axis=0), SHIFT_PX, atol=0.15)
    assert by_tiles.reference.basemap.pixel_m == pytest.approx(found.reference.basemap.pixel_m)
    with pytest.raises(pcwlad_geo.InputError, match="no such layer; give layer=ortho"):
        match_files(f"{name}2", files[1], out_dir="none", allow_remote=True, **QUICK)
    server.trouble = "refused"
    with pytest.raises(pcwlad_geo.InputError, match=r"wmts\.xml cannot be fetched"):
        match_files(name, files[1], out_dir="none", allow_remote=True, **QUICK)
    assert not Path("none").exists()


def test_the_error_on_a_web_map_is_proved(
    files: tuple[Path, Path, Path], server: MapServer, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["prove", server.xyz, str(files[1]), "-o", "proof", *OPTIONS, "--ref-zoom", str(ZOOM)]
    assert run([word for word in command if word != "--allow-remote"]) == 2
    assert "give --allow-remote" in " ".join(capsys.readouterr().err.split())
    assert not Path("proof").exists()
    assert run(command) == 0
    numbers = json.loads(Path("proof/proof.json").read_text(encoding="utf-8"))
    assert numbers["outputs"] == ["basemap.tif", "proof.html", "proof.json"]
    assert numbers["reference"]["path"] == str(Path("proof/basemap.tif").absolute())
    assert numbers["reference"]["basemap"]["name"].startswith(server.address)
    assert numbers["rmse_px"] < 0.3
    assert "secret" not in Path("proof/proof.json").read_text(encoding="utf-8")


def test_a_stack_is_on_a_web_map(files: tuple[Path, Path, Path], server: MapServer) -> None:
    other_px = np.array([-1.6, 2.2])
    other = write(Path("other.tif"), render(TARGET, "red", displacement_px=other_px), TARGET)
    options: Any = {**QUICK, "out_dir": "stack", "allow_remote": True, "jobs": 1}
    result = pcwlad_geo.stack([server.xyz, files[1], other], **options)
    assert (result.datum, result.images[-1].name) == ("basemap", "basemap")
    shifts_px = [image.shift_px for image in result.images]
    np.testing.assert_allclose(shifts_px[:2], [SHIFT_PX, other_px], atol=0.15)
    assert [warning.count("relative to the basemap") for warning in result.warnings].count(1) == 1
    assert max(server.asked.values()) == 1
    with rasterio.open("stack/photo_registered.tif") as file, rasterio.open("stack/basemap.tif") as basemap:
        assert (file.crs, file.transform) == (basemap.crs, basemap.transform)
    asked = server.asked.copy()
    again = pcwlad_geo.stack([files[1], other], reference=server.xyz, **options)
    assert server.asked == asked
    assert [image.shift_px for image in again.images] == shifts_px


def test_a_web_map_of_a_stack_that_cannot_be_had(files: tuple[Path, Path, Path], server: MapServer) -> None:
    other = write(Path("other.tif"), render(TARGET, "red"), TARGET)
    with pytest.raises(TrustError, match="--allow-remote"):
        pcwlad_geo.stack([server.xyz, files[1], other], out_dir="stack", **SMALL)
    options: Any = {**SMALL, "out_dir": "stack", "allow_remote": True}
    with pytest.raises(pcwlad_geo.InputError, match=r"plain has no geotransform.*--place"):
        pcwlad_geo.stack([server.xyz, files[1], files[2]], **options)
    with pytest.raises(pcwlad_geo.InputError, match="are two web maps"):
        pcwlad_geo.stack([server.xyz, "xyz:http://b/{z}/{x}/{y}.png", files[1], other], **options)
    server.trouble = "refused"
    with pytest.raises(pcwlad_geo.InputError, match="it refuses this program"):
        pcwlad_geo.stack([server.xyz, files[1], other], **options)
    assert not Path("stack").exists()
    server.trouble = ""
    Path("stack").mkdir()
    own = write(Path("stack/basemap.tif"), np.ones((9, 9), np.uint8), TARGET)
    before = own.read_bytes()
    with pytest.raises(pcwlad_geo.OutputError, match=r"basemap\.tif"):
        pcwlad_geo.stack([server.xyz, files[1], other], **options)
    assert own.read_bytes() == before


def test_where_to_look_must_be_said_for_a_photo(files: tuple[Path, Path, Path], server: MapServer) -> None:
    photo = files[2]
    with pytest.raises(pcwlad_geo.InputError, match=r"no georeferencing.*--extent.*--place.*EPSG:3857"):
        pcwlad_geo.register(server.xyz, photo, out_dir="map", allow_remote=True, **SMALL)
    assert not server.asked
    corners = map_grid().to_xy(np.array([[100.0, 650.0], [650.0, 100.0]]))
    extent: Any = tuple(corners.ravel().tolist())
    found = pcwlad_geo.register(
        server.xyz, photo, out_dir="map", allow_remote=True, extent=extent, ref_zoom=ZOOM, **PHOTO
    )
    assert found.prealignment.method in ("search", "pose")
    off_m = np.array([28.6, -28.6]) * SHIFT_PX
    truth = rasterio.warp.transform(
        TARGET.crs, "EPSG:3857", *(TARGET.to_xy(TARGET.middle_px) - off_m)[0][:, None]
    )
    with rasterio.open("map/plain_registered.tif") as file:
        assert file.crs.to_epsg() == 3857
    points = found.tie_points
    near = np.hypot(*(points.target_px - TARGET.middle_px).T).argmin()
    assert np.hypot(*(points.xy[near] - np.ravel(truth))) < 260 * 38


@pytest.mark.parametrize(
    ("trouble", "said"),
    [
        ("refused", r"refuses this program \(HTTP 403\)"),
        ("half", r"of 9 tiles 6 are missing \(HTTP 404\)"),
        ("black", "tiles 9 are of one colour"),
        ("html", r"9 are no images \(but '<html><body>log in"),
        ("vrt", r"9 are no images \(but '<VRTDataset"),
        ("slow", "no answer"),
    ],
)
def test_a_map_that_is_not_there_is_told_and_leaves_nothing(
    trouble: str,
    said: str,
    files: tuple[Path, Path, Path],
    server: MapServer,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    server.trouble, patience_s = trouble, 0.3 if trouble == "slow" else 20.0
    monkeypatch.setattr(
        fetching, "FETCHING", fetching.FETCHING._replace(timeout_s=patience_s, tries=1, most_late=0)
    )
    with pytest.raises(pcwlad_geo.InputError, match=said):
        pcwlad_geo.register(server.xyz, files[1], out_dir="map", allow_remote=True, ref_zoom=ZOOM, **SMALL)
    assert list(Path().iterdir()) == []


def test_a_map_that_ends_at_a_coarser_zoom_is_taken_there(
    files: tuple[Path, Path, Path], server: MapServer
) -> None:
    grid = make_grid((340, 340), pixel_m=14.3, offset_m=(10_500, 9_500))
    fine = write(Path("fine.tif"), render(grid), grid)
    found = match_files(server.xyz, fine, out_dir="map", allow_remote=True, **QUICK)
    assert found.reference.basemap.pixel_m == pytest.approx(28.6, rel=0.01)
    assert any(path.startswith(f"/tiles/{ZOOM + 1}/") for path in server.asked)


def test_cancelled_while_it_is_slow_nothing_is_left(
    files: tuple[Path, Path, Path], server: MapServer
) -> None:
    server.trouble = "slow"
    seen: list[Progress] = []

    def cancel(event: Event) -> None:
        if isinstance(event, Progress) and event.stage == "fetching":
            seen.append(event)
            if len(seen) > 2:
                raise pcwlad_geo.CancelledError("enough")

    with pytest.raises(pcwlad_geo.CancelledError):
        pcwlad_geo.register(
            server.xyz, files[1], out_dir="map", allow_remote=True, ref_zoom=ZOOM, on_event=cancel, **SMALL
        )
    assert seen[0].total >= 4
    assert list(Path().iterdir()) == []


def test_what_cannot_be_fetched_is_refused_before(files: tuple[Path, Path, Path], server: MapServer) -> None:
    target = files[1]
    with pytest.raises(pcwlad_geo.InputError, match="give --allow-remote"):
        pcwlad_geo.register(server.xyz, target, out_dir="map", **SMALL)
    for name, said in (
        (f"xyz:{server.address}/{{z}}/{{x}}.png", r"with \{z\}, \{x\} and \{y\}"),
        ("xyz:ftp://host/{z}/{x}/{y}", "no address of a server"),
        (f"WMS:{server.address}/wms?SRS=EPSG:3857", "LAYERS="),
        (f"WMS:{server.address}/wms?LAYERS=a&SRS=EPSG:0", "not understood"),
        ("<GDAL_WMS><Service name='Worse'/></GDAL_WMS>", "'Worse'"),
    ):
        with pytest.raises(pcwlad_geo.InputError, match=said):
            pcwlad_geo.register(name, target, out_dir="map", allow_remote=True, **SMALL)
    with pytest.raises(pcwlad_geo.InputError, match=r"tiles of zoom 20 .* at most 1024 .*--ref-zoom 19"):
        pcwlad_geo.register(server.xyz, target, out_dir="map", allow_remote=True, ref_zoom=20, **SMALL)
    assert not server.asked
    assert list(Path().iterdir()) == []


def test_capabilities_of_a_wmts_give_the_tiles_of_xyz() -> None:
    def read(address: str) -> bytes:
        assert address == "http://host/wmts.xml"
        return capabilities("http://host").encode()

    service = find_service("WMTS:http://host/wmts.xml,layer=ortho,tilematrixset=google", read)
    tiles = find_service("xyz:http://host/{z}/{x}/{y}.png", read)
    assert service.name == "http://host/wmts.xml (Orthophoto)"
    assert service.url(2, 1, 3) == "http://host/ortho/default/2020/google/z2/3/1.png"
    np.testing.assert_allclose(service.level(1).transform, tiles.level(1).transform, atol=1e-3)
    assert service.level(2).shape == tiles.level(2).shape
    for wrong, said in (
        ("layer=none", "no such layer; give layer=ortho"),
        ("tilematrixset=b", "tilematrixset=google"),
    ):
        with pytest.raises(pcwlad_geo.InputError, match=said):
            find_service(f"WMTS:http://host/wmts.xml,{wrong}", read)
    with pytest.raises(pcwlad_geo.InputError, match="no XML"):
        find_service("WMTS:http://host/wmts.xml", lambda address: b"<!DOCTYPE a><a/>")


def test_a_drawn_map_is_said_to_be_one(files: tuple[Path, Path, Path], tmp_path: Path) -> None:
    """QGIS writes these tags too."""
    place = tmp_path / "map.tif"
    place.write_bytes(files[0].read_bytes())
    with rasterio.open(place, "r+") as file:
        file.update_tags(BASEMAP_NAME="Streets", BASEMAP_KIND="map", BASEMAP_ATTRIBUTION="a mapper")
    pair = prepare_pair(place, files[1], Settings())
    assert any("Streets is a drawn map" in warning for warning in pair.warnings)
    assert pair.reference.basemap.text == "Streets (a mapper, 28.7 m a pixel)"
