"""Check what is in a wheel and in a source distribution.

Usage: python .ci/distributions.py FOLDER

FOLDER holds one of each, as `python -m build` leaves them there. The exit status is 1 where something is
missing, or there and not wanted.
"""

from __future__ import annotations

import re
import sys
import tarfile
import zipfile
from pathlib import Path

IN_WHEEL = (
    "pcwlad_geo/py.typed",
    "pcwlad_geo/__init__.pyi",
    "pcwlad_geo/cli/sample/landsat_b4.tif",
    "pcwlad_geo/cli/sample/landsat_b10.tif",
    "pcwlad_geo/report/templates/report.html.j2",
    "pcwlad_geo/multi/templates/qa.html.j2",
    "pcwlad_geo/multi/templates/watch.html.j2",
    *(
        f"pcwlad_geo/schemas/{name}.schema.json"
        for name in ("report", "qa", "stack", "stac", "rig", "proof", "watch", "correction")
    ),
)
IN_SOURCE = (
    *(name for name in IN_WHEEL if "schemas" not in name),
    "LICENSE",
    "README.md",
    "pyproject.toml",
    "docs/pcwlad-geo.1",
    "constraints.txt",
    "docs/report.schema.json",
    "sample_data/landsat_b4.tif",
    "sample_data/landsat_b10.tif",
    "tests/conftest.py",
    "hatch_build.py",
    "kernels/kernels.h",
    "scripts/build_kernels.py",
    "benchmarks/tables.py",
    "qgis_plugin/build.py",
)
"""The tests need what stands at the end."""
RELATIVE_LINK = re.compile(r"\]\((?![a-z]+:|#)[^)\s]+\)")
"""In the README on the package index it would lead nowhere."""
MOST_BYTES = {".whl": 2_000_000, ".gz": 20_000_000}


def main() -> int:
    """Print what is wrong, and how large both are."""
    folder = Path(sys.argv[1])
    (wheel,), (source,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    with zipfile.ZipFile(wheel) as archive:
        in_wheel = archive.namelist()
        (metadata,) = (archive.read(name).decode() for name in in_wheel if name.endswith("/METADATA"))
    with tarfile.open(source) as tar:
        in_source = [name.partition("/")[2] for name in tar.getnames()]
    wrong = [f"{wheel.name} lacks {name}" for name in IN_WHEEL if name not in in_wheel]
    kernels = [name for name in in_wheel if name.startswith("pcwlad_geo/matching/kernels/kernels_")]
    for_everybody = wheel.name.endswith("-py3-none-any.whl")
    wrong += [] if len(kernels) >= (9 if for_everybody else 1) else [f"{wheel.name} lacks kernels"]
    man_page = ".data/data/share/man/man1/pcwlad-geo.1"
    wrong += [] if any(name.endswith(man_page) for name in in_wheel) else [f"{wheel.name} lacks {man_page}"]
    wrong += [f"{source.name} lacks {name}" for name in IN_SOURCE if name not in in_source]
    wrong += [
        f"{wheel.name} holds {name}"
        for name in in_wheel
        if not name.startswith(("pcwlad_geo/", "pcwlad_geo-")) or "__pycache__" in name
    ]
    wrong += [f"{source.name} holds {name}" for name in in_source if "__pycache__" in name]
    readme = metadata.partition("\n\n")[2]
    wrong += [] if readme.startswith("# ") else [f"{wheel.name} lacks the README"]
    wrong += [f"{wheel.name} has a README with {link}" for link in RELATIVE_LINK.findall(readme)]
    for file in (wheel, source):
        size, most = file.stat().st_size, MOST_BYTES[file.suffix]
        print(f"{file.name}: {size / 1e6:.1f} MB")
        wrong += [f"{file.name} is larger than {most / 1e6:.0f} MB"] if size > most else []
    print(*wrong, sep="\n", end="\n" if wrong else "")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
