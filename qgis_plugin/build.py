"""Builds the zip of the plugin that QGIS installs: ``python3 qgis_plugin/build.py [ZIP]``."""

from __future__ import annotations

import configparser
import os
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
from help_page import PAGE, page

HERE = Path(__file__).resolve().parent
PLUGIN = HERE / "pcwlad_geo_qgis"
SUFFIXES = {".py", ".txt", ".svg", ".ts", ".qm", ".ui", ".qml", ""}
"""Of the files that belong to the plugin; the licence has none."""
SITE = "PCWLAD_GEO_SITE"
"""Variable with the address of the project and of its maintainers, such as `https://host/project me@host`."""


def build(place: Path) -> list[str]:
    """Write the zip and return the names in it: translations where lrelease is installed, a page of help."""
    files = {
        str(path.relative_to(HERE)): path
        for path in sorted(PLUGIN.rglob("*"))
        if path.is_file() and path.suffix in SUFFIXES and "__pycache__" not in path.parts
    }
    place.parent.mkdir(parents=True, exist_ok=True)
    with (
        tempfile.TemporaryDirectory() as folder,
        zipfile.ZipFile(place, "w", zipfile.ZIP_DEFLATED) as archive,
    ):
        for name, path in files.items():
            if path.name == "metadata.txt":
                text = with_changes(path.read_text(encoding="utf-8"))
                archive.writestr(name, published(text, os.environ.get(SITE, "")))
                continue
            archive.write(path, name)
            if path.suffix == ".ts" and (compiled := _compile(path, Path(folder))):
                archive.write(compiled, str(Path(name).with_suffix(".qm")))
        site = os.environ.get(SITE, "").split(" ")[0]
        home = f"{site.rstrip('/')}/" if site else metadata()["homepage"]
        html, pictures = page(PAGE.read_text(encoding="utf-8"), home)
        written = Path(folder) / "index.html"
        written.write_text(html, encoding="utf-8")
        for path in (written, *(PAGE.parent / picture for picture in pictures)):
            archive.write(path, f"{PLUGIN.name}/manual/{path.name}")
        return archive.namelist()


def with_changes(text: str) -> str:
    """Return the metadata with what CHANGELOG.md says of the plugin in its newest version."""
    changes = (HERE.parent / "CHANGELOG.md").read_text(encoding="utf-8")
    _, version, newest = re.split(r"^## \[(.+?)\].*$", changes, maxsplit=2, flags=re.M)[:3]
    items = re.findall(r"^- \*\*QGIS\.\*\* (.*?)(?=^- |^#|\Z)", newest, re.M | re.S)
    plain = re.sub(
        r"\[(?:docs/\S*|([^]]*))\]\([^)]*\)", r"\1", " ".join(items)
    )  # a page is named, or said in words
    plain = " ".join(plain.split()) or "nothing new in the plugin; its engine is of this version"
    return re.sub(r"^changelog=.*$", lambda _: f"changelog={version}: {plain}", text, flags=re.M)


def published(text: str, site: str) -> str:
    """Return the metadata with the addresses of a `SITE`; as it is without one.

    Then only versions before a release (`1.0.0rc1`) are experimental.
    """
    if not site:
        return text
    address, _, email = site.partition(" ")
    address, version = address.rstrip("/"), metadata()["version"]
    values = {"homepage": f"{address}/", "repository": address, "tracker": f"{address}/issues"}
    values.update(email=email.strip(), experimental=str(re.search(r"[a-z]", version) is not None))
    for name, value in values.items():
        text = re.sub(rf"^{name}=.*$", lambda _, line=f"{name}={value}": line, text, flags=re.M)
    return text


def _compile(translation: Path, folder: Path) -> Path | None:
    lrelease = shutil.which("lrelease") or shutil.which("lrelease-qt5") or shutil.which("lrelease6")
    if lrelease is None:
        return None
    compiled = folder / translation.with_suffix(".qm").name
    run = subprocess.run(
        [lrelease, str(translation), "-qm", str(compiled)], capture_output=True, check=False, text=True
    )
    return compiled if run.returncode == 0 else None


def metadata() -> configparser.SectionProxy:
    """Return what metadata.txt says."""
    parser = configparser.ConfigParser(interpolation=None)
    parser.read(PLUGIN / "metadata.txt", encoding="utf-8")
    return parser["general"]


def main() -> None:
    """Build the zip where the command line says, in dist/ by default."""
    default = HERE.parent / "dist" / f"pcwlad_geo_qgis-{metadata()['version']}.zip"
    place = Path(sys.argv[1]) if len(sys.argv) > 1 else default
    names = build(place)
    translated = sorted(Path(name).stem for name in names if name.endswith(".qm"))
    print(f"{place}: {len(names)} files; translations: {', '.join(translated) or 'none (no lrelease)'}")


if __name__ == "__main__":
    main()
