"""STAC items as input: a search of an API on this machine, files by ranges, signed addresses, pairs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcwlad_geo.cli.app import run as run_command
from pcwlad_geo.errors import ExecutionError, InputError, SettingsError, TrustError
from pcwlad_geo.job import register
from pcwlad_geo.multi.stack.run import stack
from pcwlad_geo.multi.stack.search import stac_images
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Trust
from pcwlad_geo.registration import resolve
from tests.scenes import make_grid, render, write
from tests.stac_server import stac_api

SMALL = make_grid((200, 220))
FEW: Any = {"features": 60, "window": 41, "template": 61, "model": "shift", "jobs": 1}
SHIFTS_PX = np.array([[0.0, 0.0], [1.7, -2.4], [-0.6, 1.3]])
COLLECTION = {0: "scenes", 1: "scenes", 2: "scenes", 3: "others"}


def item(number: int, href: str, **assets: Any) -> dict[str, Any]:
    return {
        "type": "Feature",
        "stac_version": "1.0.0",
        "id": f"scene{number}",
        "collection": COLLECTION[number],
        "geometry": {"type": "Point", "coordinates": [15.0, 41.5]},
        "bbox": [14.9, 41.4, 15.1, 41.6],
        "properties": {"datetime": f"2024-0{number + 5}-03T10:00:00Z", "eo:cloud_cover": 10.0 * number},
        "links": [{"rel": "self", "href": f"HERE/api/items/scene{number}"}],
        "assets": {
            "red": {"href": href, "type": "image/tiff; application=geotiff", "eo:bands": [{"name": "B04"}]},
            "thumbnail": {"href": "HERE/no.png", "type": "image/png", "roles": ["thumbnail"]},
            **assets,
        },
    }


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with images, and the items of an API and of files that name them."""
    folder = tmp_path_factory.mktemp("stac")
    rng = np.random.default_rng(2)
    for number, shift in enumerate(SHIFTS_PX):
        shown = render(SMALL, displacement_px=shift, noise=0.0) + 2.0 * rng.standard_normal(SMALL.shape)
        write(folder / f"red{number}.tif", shown, SMALL, driver="COG")
        (folder / f"item{number}.json").write_text(json.dumps(item(number, f"./red{number}.tif")))
    items = [item(number, f"HERE/red{number}.tif") for number in range(3)]
    (folder / "items.json").write_text(json.dumps([*items, item(3, "file:///etc/passwd")]))
    collection = {"type": "FeatureCollection", "features": [item(n, f"red{n}.tif") for n in range(3)]}
    (folder / "collection.json").write_text(json.dumps(collection))
    return folder


def shifts_of(out: Path) -> Any:
    numbers = json.loads((out / "stack.json").read_text())
    return np.array([image["shift_px"] for image in numbers["images"]])


def test_a_search_is_adjusted_as_a_stack_of_its_images(folder: Path, tmp_path: Path) -> None:
    pytest.importorskip("pystac_client")
    (tmp_path / "signing_of_test.py").write_text("def sign(url):\n    return url.split('?')[0] + '?key=1'\n")
    with stac_api(folder, tmp_path / "log", signature="key=1") as here, pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(tmp_path)
        search = f"{here}/api/search?collections=scenes"
        status = run_command(
            ["stack", "--stac", search, "--allow-remote", "--band", "B04", "-o", str(tmp_path / "out")]
            + ["--sign", "signing_of_test:sign", "--progress", "none"]
            + [word for name, value in FEW.items() for word in (f"--{name}", str(value))]
        )
    assert status == 0
    np.testing.assert_allclose(shifts_of(tmp_path / "out"), SHIFTS_PX, atol=0.06)
    requests = (tmp_path / "log").read_text()
    assert requests.count("/api/search") == 2  # two pages
    assert "GET /red1.tif?key=1 bytes=0-16383" in requests
    assert "no.png" not in requests
    written = [path.read_text() for path in (tmp_path / "out").rglob("*.json")]
    assert written
    assert not any("key=1" in text for text in written)
    first = json.loads((tmp_path / "out/stack.json").read_text())["images"][0]
    assert first["given"]["item"] == f"{here}/api/items/scene0"


def test_an_item_collection_needs_no_server(folder: Path, tmp_path: Path) -> None:
    stack(
        [],
        stac=folder / "collection.json",
        band="red",
        out_dir=tmp_path / "out",
        max_pairs=2,
        no_report=True,
        **FEW,
    )
    np.testing.assert_allclose(shifts_of(tmp_path / "out"), SHIFTS_PX, atol=0.06)


def test_two_items_are_a_pair(folder: Path, tmp_path: Path) -> None:
    status = run_command(
        ["register", str(folder / "item0.json"), str(folder / "item1.json"), "-o", str(tmp_path / "out")]
        + ["--ref-asset", "red", "--tgt-asset", "B04", "--progress", "none", "--no-report"]
        + [word for name, value in FEW.items() for word in (f"--{name}", str(value))]
    )
    assert status == 0
    report = json.loads((tmp_path / "out/report.json").read_text())
    np.testing.assert_allclose(report["displacement_px"]["median"], SHIFTS_PX[1], atol=0.06)
    assert (tmp_path / "out/red1_registered.tif").is_file()
    assert not any("corrected" in warning for warning in report["warnings"])
    several = item(1, str(folder / "red1.tif"), nir={"href": "nir1.tif", "type": "image/tiff"})
    (tmp_path / "several.json").write_text(json.dumps(several))
    choice = Settings(ref_band="red", tgt_band="red")
    inputs = resolve(folder / "item0.json", tmp_path / "several.json", choice, all_bands=True)
    assert any("only the asset of the band is corrected" in note for note in inputs.notes)
    with pytest.raises(InputError, match=r"band nir of .*item0.json \(STAC item\) is missing: it holds red"):
        register(folder / "item0.json", folder / "item1.json", ref_band="nir", tgt_band="red")
    with pytest.raises(InputError, match="say which band by name"):
        register(folder / "item0.json", folder / "item1.json")


def test_the_quality_raster_of_an_item_is_its_mask(folder: Path, tmp_path: Path) -> None:
    shown = render(SMALL, noise=1.0)
    write(tmp_path / "red.tif", shown, SMALL)
    write(tmp_path / "X_SCL.tif", np.full(SMALL.shape, 9.0), SMALL, dtype="uint8")  # all clouds
    masked = item(0, "red.tif", scl={"href": "X_SCL.tif", "roles": ["data"]})
    (tmp_path / "item.json").write_text(json.dumps(masked))
    with pytest.raises(InputError, match=r"no valid pixel \(nodata, masks\)"):
        register(folder / "item0.json", tmp_path / "item.json", ref_band="red", tgt_band="red", **FEW)


def test_what_no_server_may_name_or_be_asked_is_refused(folder: Path, tmp_path: Path) -> None:
    pytest.importorskip("pystac_client")
    remote = Trust(remote=True)
    with stac_api(folder, tmp_path / "log") as here:
        search = f"{here}/api/search"
        with pytest.raises(TrustError, match="--allow-remote"):
            stac_images(f"{search}?collections=scenes", 1, Trust())
        assert not (tmp_path / "log").exists()
        with pytest.raises(InputError, match="has the images none"):  # a file of this machine
            stac_images(f"{search}?collections=others", 1, remote)
        with pytest.raises(InputError, match="finds no item: check its collections"):
            stac_images(f"{search}?collections=none", 1, remote)
        with pytest.raises(InputError, match="has the images red: give --band"):
            stac_images(f"{search}?collections=scenes", "nir", remote)
        with pytest.raises(ExecutionError, match="cannot be searched"):
            stac_images(f"{here}/nothing/search?collections=scenes", 1, remote)
        for address, message in [
            (f"{here}/api?collections=scenes", "is no search: give API/search"),
            (f"{search}?colections=scenes", "has the parameter colections"),
            (f"{search}?bbox=a,b", "bbox, limit and max_items are numbers"),
        ]:
            with pytest.raises(SettingsError, match=message):
                stac_images(address, 1, remote)
    with pytest.raises(InputError, match="neither a file nor the address of a search"):
        stac_images(tmp_path / "gone.json", 1, remote)


def test_what_cannot_sign_is_named(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bad_signing.py").write_text("def sign(url):\n    return None\ndef fail(url):\n    1 / 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    for name, error, message in [
        ("bad_signing:sign", InputError, "signs .* as a NoneType: it must return an address"),
        ("bad_signing:fail", InputError, "cannot sign .*ZeroDivisionError"),
        ("bad_signing:none", SettingsError, "sign = 'bad_signing:none' cannot be imported"),
        ("nothing", SettingsError, "a function's name"),
    ]:
        with pytest.raises(error, match=message):
            register(
                folder / "red0.tif",
                "http://127.0.0.1:9/a.tif",
                out_dir=tmp_path / "o",
                sign=name,
                allow_remote=True,
            )
    (tmp_path / "c.toml").write_text("sign = 'bad_signing:sign'")
    status = run_command(["register", "a.tif", "b.tif", "--config", str(tmp_path / "c.toml")])
    assert status == 2
