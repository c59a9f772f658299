"""Compile the inner loops of `kernels/` into the package: what hatchling calls, and whoever changes them.

Usage::

    python scripts/build_kernels.py [--into FOLDER] [TARGET ...]

They are plain C that calls nothing: no Python, no library of the system. So one file serves every Python of a
platform, and a compiler for another platform needs nothing of it. The compiler is `CC`, or `cc`, `gcc` or
`clang`; where none of these is, and for every TARGET but this platform, it is that of the package ziglang,
which is LLVM's for all platforms. A TARGET is `x86_64-linux`, `aarch64-macos` and the like, or `all`.
"""

from __future__ import annotations

import argparse
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[1]
SOURCES: Final = ROOT / "kernels"
INTO: Final = ROOT / "pcwlad_geo" / "matching" / "kernels"

# AVX2 makes windows twice as fast; AVX-512 gains little beside it
INSTRUCTION_SETS: Final = {"x86_64": {"x86_64_v2": "x86-64-v2", "x86_64_v3": "x86-64-v3"}}
"""By processor: what a file is named by, and what compilers call the set of instructions."""
SUFFIXES: Final = {"macos": ".dylib", "windows": ".dll"}
"""By system; `.so` elsewhere."""
ALL: Final = tuple(
    f"{processor}-{system}" for system in ("linux", "macos", "windows") for processor in ("x86_64", "aarch64")
)
"""Targets of the wheel for everybody."""

# no memset or other call is made of a loop: there is no library to call
FLAGS: Final = [
    *("-std=gnu11", "-O3", "-fPIC", "-fvisibility=hidden", "-ffreestanding"),
    *("-fno-math-errno", "-fno-trapping-math", "-ffp-contract=fast", "-Wall", "-Wextra", "-Wno-psabi"),
]
REORDERED: Final = {"local_surfaces.c"}
"""Files whose sums compilers may reorder, to make vectors of them: nothing there is infinite or NaN."""


def this_platform() -> str:
    """Return the target that this Python runs on."""
    machine = platform.machine().lower()
    system = {"darwin": "macos", "win32": "windows"}.get(sys.platform, sys.platform)
    return f"{ {'amd64': 'x86_64', 'arm64': 'aarch64'}.get(machine, machine) }-{system}"


def native_compiler() -> list[str] | None:
    """Return the command of the system's compiler, None where there is none that this understands."""
    if os.environ.get("CC"):
        return shlex.split(os.environ["CC"])
    if sys.platform == "win32":  # not that of Microsoft, which has no vectors of this kind
        return None
    return next(([name] for name in ("cc", "gcc", "clang") if shutil.which(name)), None)


def requirements(targets: Sequence[str]) -> list[str]:
    """Return which packages a build for these targets needs."""
    return (
        ["ziglang"] if any(target != this_platform() or not native_compiler() for target in targets) else []
    )


def compiler_for(target: str) -> list[str]:
    """Return the command of a compiler for a target."""
    native = native_compiler()
    if target == this_platform() and native:
        return native
    if find_spec("ziglang") is None:
        raise SystemExit(
            f"no C compiler for {target}: pip install ziglang, or name a compiler for this platform in CC"
        )
    return [sys.executable, "-m", "ziglang", "cc", "-target", target]


def build(target: str, folder: Path) -> list[Path]:
    """Compile every version of the kernels of a target into a folder and return the files."""
    processor, system = target.split("-")
    compiler = compiler_for(target)
    made = []
    for name, instructions in INSTRUCTION_SETS.get(processor, {processor: ""}).items():
        flags = FLAGS
        if instructions and "ziglang" in compiler:  # which has its own spelling
            flags = [*FLAGS, f"-mcpu={instructions.replace('-', '_')}"]
        elif instructions:
            flags = [*FLAGS, f"-march={instructions}"]
        file = folder / f"kernels_{system}_{name}{SUFFIXES.get(system, '.so')}"
        with tempfile.TemporaryDirectory(dir=folder) as scratch:
            objects = []
            for source in sorted(SOURCES.glob("*.c")):
                objects.append(str(Path(scratch) / f"{source.stem}.o"))
                reordered = ["-ffast-math"] if source.name in REORDERED else []
                _run([*compiler, *flags, *reordered, "-c", str(source), "-o", objects[-1]])
            whole = Path(scratch) / file.name
            _run([*compiler, "-shared", "-nostdlib", *objects, "-o", str(whole)])
            whole.replace(file)  # a process that has loaded the old one keeps it
        made.append(file)
    return made


def _run(command: list[str]) -> None:
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{shlex.join(command)}\n{done.stdout}{done.stderr}")


def named(targets: Sequence[str]) -> list[str]:
    """Return the targets that are named on a command line: this platform by default, or all."""
    return [
        each for target in targets or [this_platform()] for each in (ALL if target == "all" else [target])
    ]


def main() -> None:
    """Compile what the command line asks for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--into", type=Path, default=INTO, metavar="FOLDER")
    parser.add_argument("targets", nargs="*", metavar="TARGET")
    arguments = parser.parse_args()
    for target in named(arguments.targets):
        for file in build(target, arguments.into):
            sys.stdout.write(f"{file}\n")


if __name__ == "__main__":
    main()
