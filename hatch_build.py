"""What hatchling calls as it builds a wheel or installs a checkout: the kernels in C are compiled.

`PCWLAD_GEO_KERNELS` names targets of `scripts/build_kernels.py`, with spaces between; by default it is this
platform. With `all` the wheel is one for everybody.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import sysconfig
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGE = "pcwlad_geo/matching/kernels"


class BuildKernels(BuildHookInterface[Any]):
    """Compiles the kernels, into the wheel or beside the sources of a checkout."""

    def dependencies(self) -> list[str]:
        """Return what the build needs besides hatchling: a compiler where the system has none."""
        script, targets = self._script_and_targets()
        return list(script.requirements(targets))

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile; `version` is `editable` for a checkout, `standard` for a wheel."""
        script, targets = self._script_and_targets()
        if version == "editable":
            self._folder, into = None, Path(self.root) / PACKAGE
        else:
            self._folder = into = Path(tempfile.mkdtemp(prefix="pcwlad-geo-kernels-"))
        files = [file for target in targets for file in script.build(target, into)]
        if version != "editable":
            build_data["force_include"].update({str(file): f"{PACKAGE}/{file.name}" for file in files})
        if os.environ.get("PCWLAD_GEO_KERNELS") != "all":
            build_data["pure_python"] = False
            build_data["tag"] = f"py3-none-{sysconfig.get_platform().replace('-', '_').replace('.', '_')}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what has been compiled into the wheel."""
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)

    def _script_and_targets(self) -> tuple[ModuleType, list[str]]:
        place = Path(self.root) / "scripts" / "build_kernels.py"
        specification = importlib.util.spec_from_file_location("build_kernels", place)
        if specification is None or specification.loader is None:
            raise ImportError(f"cannot load {place}")
        script = importlib.util.module_from_spec(specification)
        specification.loader.exec_module(script)
        return script, script.named(os.environ.get("PCWLAD_GEO_KERNELS", "").split())
