"""A package from outside adds a satellite and a format: the one that the documentation shows."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rasterio

import pcwlad_geo
from pcwlad_geo import plugins
from pcwlad_geo.cli.app import run
from pcwlad_geo.errors import InputError
from pcwlad_geo.options import Settings
from pcwlad_geo.products.finding import find_product, native_px_m, of_one_product
from pcwlad_geo.registration import resolve
from pcwlad_geo.tiepoints.readers import FORMATS, read_point_file
from tests.cli.process import run_cli
from tests.scenes import make_grid, render

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

REPOSITORY = Path(__file__).resolve().parents[2]
PAGE = REPOSITORY / "docs" / "howto" / "write_a_plugin.md"
SHIFT_PX = (1.4, -0.8)
SMALL = ("--jobs", "1", "--features", "100", "--template", "61", "--window", "41", "--no-report")


def install(folder: Path, modules: dict[str, str], points: dict[str, dict[str, str]]) -> None:
    """Put modules and the metadata of a package "desert" into a folder, as an installer does."""
    about = folder / "desert-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: desert\nVersion: 1.0\n")
    lines = []
    for group, values in points.items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in values.items())]
    (about / "entry_points.txt").write_text("\n".join(lines))
    for name, text in modules.items():
        (folder / f"{name}.py").write_text(text, encoding="utf-8")


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder from which packages are imported in this test alone."""
    folder = tmp_path / "site"
    monkeypatch.syspath_prepend(str(folder))
    plugins._plugins.cache_clear()
    yield folder
    plugins._plugins.cache_clear()
    for name in ("desert_sat", "desert_points", "desert_broken"):
        sys.modules.pop(name, None)


@pytest.fixture
def desert(site: Path) -> None:
    """The package of the page, installed."""
    text = PAGE.read_text(encoding="utf-8")
    satellite, points = re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    project = tomllib.loads(re.findall(r"^```toml\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)[0])
    modules = {"desert_sat": satellite, "desert_points": points}
    assert project["tool"]["setuptools"]["py-modules"] == [*modules], "two modules are not found by pip alone"
    install(site, modules, project["project"]["entry-points"])


def write_scene(folder: Path, shift_px: tuple[float, float] = (0.0, 0.0)) -> Path:
    folder.mkdir()
    grid = make_grid((240, 240))
    for band, kind in (("RED", "red"), ("NIR", "thermal")):
        values = render(grid, kind, displacement_px=shift_px, noise=1.0) * 100 + 5000
        _save(folder / f"DS1_20240501_{band}.tif", np.clip(np.rint(values), 1, 65535).astype("uint16"))
    clear = np.ones((240, 240), dtype="uint8")
    clear[:20] = 0
    _save(folder / "DS1_20240501_CLEAR.tif", clear)
    return folder


def _save(path: Path, numbers: np.ndarray) -> None:
    grid = make_grid((240, 240))
    profile = {"driver": "GTiff", "count": 1, "dtype": numbers.dtype, "height": 240, "width": 240}
    with rasterio.open(path, "w", crs=grid.crs, transform=grid.transform, **profile) as file:
        file.write(numbers, 1)


@pytest.mark.usefixtures("desert")
def test_the_satellite_and_the_format_of_the_page_work(tmp_path: Path) -> None:
    """On the command line, which writes and reads the format, and in Python."""
    scene, target = write_scene(tmp_path / "ref"), write_scene(tmp_path / "tgt", SHIFT_PX)
    bands = ["--ref-band", "RED", "--tgt-band", "RED"]
    out = tmp_path / "out"
    assert run(["match", str(scene), str(target), *bands, "-o", str(out), *SMALL]) == 0
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert report["reference"]["mask"] == str(scene / "DS1_20240501_CLEAR.tif")
    assert report["statistics"]["native_px_m"] == 10.0
    file = out / "DS1_20240501_RED.desert"
    points = read_point_file(file)
    assert np.median(points.target - points.reference, axis=0) == pytest.approx(SHIFT_PX, abs=0.1)
    fitted = pcwlad_geo.register(
        scene, target, ref_band="RED", tgt_band="RED", tie_points=file, out_dir=tmp_path / "again",
        model="shift", no_report=True, jobs=1,
    )  # fmt: skip
    assert fitted.outputs["desert"] == tmp_path / "again" / file.name
    assert fitted.outputs["desert"].is_file()
    assert fitted.correction is not None
    assert fitted.correction.forward(np.zeros((1, 2)))[0] == pytest.approx(SHIFT_PX, abs=0.1)


@pytest.mark.usefixtures("desert")
def test_what_the_names_of_the_satellite_say(tmp_path: Path) -> None:
    scene = write_scene(tmp_path / "scene")
    product = find_product(scene)
    assert product is not None
    assert (product.kind, [band.name for band in product.bands]) == ("DesertSat", ["RED", "NIR"])
    with rasterio.open(product.band("nir").opened_as()) as opened:
        assert opened.nodata == 0
    assert of_one_product(str(scene / "DS1_20240501_RED.tif"), str(scene / "DS1_20240501_NIR.tif"))
    assert not of_one_product(str(scene / "DS1_20240501_RED.tif"), str(scene / "DS1_20240502_NIR.tif"))
    assert native_px_m("DS1_20240501_RED", None) == 10.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("import absent", r"cannot be loaded \(ModuleNotFoundError: No module named 'absent'\)"),
        ("1 / 0", r"cannot be loaded \(ZeroDivisionError"),
        ("THING = 5", "is a int instead of a"),
        ("", "cannot be loaded .AttributeError"),
    ],
)
def test_an_object_that_cannot_be_used_is_a_warning(text: str, said: str, site: Path, tmp_path: Path) -> None:
    point = {"broken": "desert_broken:THING"}
    install(site, {"desert_broken": text}, {"pcwlad_geo.products": point, "pcwlad_geo.formats": point})
    scene = write_scene(tmp_path / "scene")
    file = str(scene / "DS1_20240501_RED.tif")
    words = rf"broken of the package desert \(entry point pcwlad_geo.{{}}\) is not used: .*{said}"
    for warning, group in zip(resolve(file, file, Settings()).notes, ("products", "formats"), strict=True):
        assert re.search(words.format(group), warning)
    with pytest.raises(InputError, match=words.format("products")):
        resolve(scene, file, Settings(ref_band="RED"))
    (tmp_path / "points.desert").write_text("desert points\n")
    with pytest.raises(InputError, match=words.format("formats")):
        read_point_file(tmp_path / "points.desert")


@pytest.mark.parametrize(
    ("answer", "said"),
    [("1 / 0", "ZeroDivisionError"), ("'a product'", "its answer 'a product' is no Product")],
)
def test_a_function_that_fails_is_one_error(answer: str, said: str, site: Path, tmp_path: Path) -> None:
    text = f"""
from pcwlad_geo.products import ProductKind
THING = ProductKind("broken", lambda name: True, lambda tree: {answer})
"""
    install(site, {"desert_broken": text}, {"pcwlad_geo.products": {"broken": "desert_broken:THING"}})
    with pytest.raises(InputError, match=rf"broken of the package desert .*{said}.*uninstall it"):
        find_product(write_scene(tmp_path / "scene"))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ("recognises=lambda source: 1 / 0", "ZeroDivisionError"),
        ("read=lambda source: 'points'", "its answer 'points' is no PointFile"),
        ("write=lambda *_: 1 / 0", "ZeroDivisionError"),
    ],
)
def test_a_format_that_fails_is_one_line_on_the_command_line(
    changes: str, said: str, desert: None, site: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with (site / "desert_points.py").open("a", encoding="utf-8") as file:
        file.write(f"\nfrom dataclasses import replace\nDESERT_POINTS = replace(DESERT_POINTS, {changes})\n")
    assert run(by_points(tmp_path)) == InputError.exit_status
    line = capsys.readouterr().err.strip().splitlines()[-1]
    named = r"desert of the package desert \(entry point pcwlad_geo.formats\) failed"
    assert re.search(f"{named} .*{said}.*uninstall it", line)


def by_points(folder: Path) -> list[str]:
    """Return a command that registers a scene by a file of the format of the page."""
    scene, target = write_scene(folder / "ref"), write_scene(folder / "tgt", SHIFT_PX)
    places = np.stack(np.meshgrid(*[np.linspace(20.0, 220.0, 6)] * 2), axis=-1).reshape(-1, 2)
    rows = np.column_stack([places, places + SHIFT_PX])
    lines = ["desert points", *(" ".join(map(str, row)) for row in rows.tolist())]
    (folder / "points.desert").write_text("\n".join(lines), encoding="utf-8")
    bands = ["--ref-band", "RED", "--tgt-band", "RED", "--model", "shift", *SMALL]
    points = str(folder / "points.desert")
    return ["register", str(scene), str(target), *bands, "--tie-points", points, "-o", str(folder / "out")]


def test_another_process_has_the_package_from_its_path(
    desert: None, site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a shell has it: nothing of the package is imported before the command line runs."""
    paths = (str(site), str(REPOSITORY), os.environ.get("PYTHONPATH"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, paths)))
    result = run_cli(tmp_path, by_points(tmp_path))
    assert result.returncode == 0, result.stderr
    written = (tmp_path / "out" / "DS1_20240501_RED.desert").read_text(encoding="utf-8").splitlines()
    assert written[0] == "desert points"
    numbers = np.array([line.split() for line in written[1:]], dtype=float)
    assert numbers.shape == (36, 4)
    assert numbers[:, 2:] - numbers[:, :2] == pytest.approx(np.tile(SHIFT_PX, (36, 1)), abs=1e-3)


def test_nothing_is_searched_for_before_it_is_needed(monkeypatch: pytest.MonkeyPatch) -> None:
    plugins._plugins.cache_clear()
    monkeypatch.setattr(plugins, "_plugins", None)  # a call would fail
    assert run(["--help"]) == 0
    assert next(iter(FORMATS)).name == "correction"
