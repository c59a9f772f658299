"""Do what the Dockerfile says in the root of a Debian system, without a daemon, and try what came of it.

    debootstrap --variant=minbase --include=python3,python3-venv,python3-pip,ca-certificates trixie ROOT
    python3 scripts/rehearse_container.py ROOT

Every COPY and RUN line is carried out below ROOT, by root, in its order, both stages in one root: all that an
image is built of but its base, python:slim, for which Debian's Python stands in. Then the entry point runs
the demonstration as a user whom the image does not know, and who can write nothing but /tmp, and registers
its pair once more on the scheduler and the workers of compose.yaml. What pip is to use is given as PIP_... in
the environment. Needs PyYAML, and below ROOT a /proc, and a /dev with null, urandom and a shm for everybody.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import yaml

REPOSITORY = Path(__file__).resolve().parents[1]
STRANGER = 54321
"""A user and a group that nothing belongs to."""


def instructions(text: str) -> Iterator[tuple[str, str]]:
    """Yield the instructions of a Dockerfile, each on one line."""
    joined = re.sub(r"\\\n", " ", re.sub(r"^#.*\n", "", text, flags=re.M))
    for line in filter(None, map(str.strip, joined.splitlines())):
        name, _, rest = line.partition(" ")
        yield name, " ".join(rest.split())


def entered(root: Path, user: int, folder: str = "/") -> Callable[[], None]:
    """Return what makes a process that starts one of the root, and of a user."""

    def enter() -> None:
        os.chroot(root)
        os.chdir(folder)
        os.setgroups([])
        os.setgid(user)
        os.setuid(user)

    return enter


def run(root: Path, command: list[str], variables: dict[str, str], user: int = 0, folder: str = "/") -> None:
    """Run a command below the root, as a user."""
    subprocess.run(command, env=variables, preexec_fn=entered(root, user, folder), check=True)


def copy(root: Path, words: list[str]) -> None:
    """Carry a COPY instruction out."""
    modes = [word.partition("=")[2] for word in words if word.startswith("--chmod=")]
    source, place = (word for word in words if not word.startswith("--"))
    target = root / place.lstrip("/")
    if any(word.startswith("--from=") for word in words):
        return  # both stages are one root
    for name in context() if source == "." else [source]:
        copied = target / name if source == "." else target
        copied.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(REPOSITORY / name, copied)
    for mode in modes:
        target.chmod(int(mode, 8))


def context() -> list[str]:
    """Return the tracked files that .dockerignore lets in; all such files where git tracks none."""
    lines = (REPOSITORY / ".dockerignore").read_text(encoding="utf-8").splitlines()
    let_in = [line[1:] for line in lines if line.startswith("!")]
    if not (REPOSITORY / ".git").exists():
        found = [path for name in let_in for top in REPOSITORY.glob(name) for path in (top, *top.rglob("*"))]
        return [str(path.relative_to(REPOSITORY)) for path in found if path.is_file()]
    command = ["git", "-C", str(REPOSITORY), "ls-files", "--", *let_in]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()


def build(root: Path) -> dict[str, str]:
    """Carry all instructions out, and return the environment of the image."""
    variables = {"PATH": "/usr/local/bin:/usr/bin:/bin:/usr/sbin:/sbin", "PIP_BREAK_SYSTEM_PACKAGES": "1"}
    variables |= {name: value for name, value in os.environ.items() if name.startswith("PIP_")}
    user, users = 0, {"pcwlad": 1000}
    for name, rest in instructions((REPOSITORY / "Dockerfile").read_text(encoding="utf-8")):
        if name in ("RUN", "COPY"):
            print(f"{name} {rest}", flush=True)
        if name == "RUN":
            run(root, ["/bin/sh", "-c", rest], variables, user)
        elif name == "COPY":
            copy(root, shlex.split(rest))
        elif name == "ENV":
            given = dict(word.split("=", 1) for word in shlex.split(rest))
            variables |= {key: value.replace("$PATH", variables["PATH"]) for key, value in given.items()}
        elif name == "USER":
            user = users[rest]
    return variables


def cluster(root: Path, entry: list[str], variables: dict[str, str], pair: list[str]) -> None:
    """Register a pair on what compose.yaml starts, here on this machine's own address."""
    services = yaml.safe_load((REPOSITORY / "compose.yaml").read_text(encoding="utf-8"))["services"]
    names = ["scheduler", *["worker"] * services["worker"]["deploy"]["replicas"]]
    commands = [
        [word.replace("//scheduler:", "//127.0.0.1:") for word in services[name]["command"]] for name in names
    ]
    address = commands[-1][-1]
    with ExitStack() as stack:
        for words in commands:
            print(*entry, *words, flush=True)
            command = ["/usr/bin/env", *entry, *words]
            how = {"env": variables, "preexec_fn": entered(root, STRANGER), "stderr": subprocess.DEVNULL}
            process = stack.enter_context(subprocess.Popen(command, **how))
            stack.callback(process.terminate)
        order = ["register", *pair, "-o", "/tmp/pcwlad-geo-cluster", "--overwrite", "--progress", "none"]
        order = ["/usr/bin/env", *entry, *order, "--scheduler", address]
        until_it_passes(services["scheduler"]["healthcheck"], root, variables)
        run(root, order, variables, STRANGER)


def until_it_passes(check: Mapping[str, Any], root: Path, variables: dict[str, str]) -> None:
    """Do the check of a service as often as compose does, until it passes."""
    how = {"env": variables, "preexec_fn": entered(root, STRANGER), "stderr": subprocess.DEVNULL}
    for _ in range(check["retries"]):
        if subprocess.run(["/usr/bin/env", *check["test"][1:]], check=False, **how).returncode == 0:
            return
        time.sleep(float(check["interval"].rstrip("s")))
    sys.exit("the scheduler does not answer")


def main() -> int:
    """Build, and try the demonstration with nothing but /tmp to write to."""
    root = Path(sys.argv[1]).resolve()
    python = root / "usr" / "local" / "bin" / "python"
    if not python.exists():
        python.symlink_to("/usr/bin/python3")
    variables = build(root)
    (entry,) = (
        json.loads(rest)
        for name, rest in instructions((REPOSITORY / "Dockerfile").read_text(encoding="utf-8"))
        if name == "ENTRYPOINT"
    )
    demo = [*entry, "demo", "/tmp/pcwlad-geo-demo", "--overwrite", "--progress", "none"]
    print(*demo, flush=True)
    run(root, ["/usr/bin/env", *demo], variables, STRANGER)
    pair = [f"/tmp/pcwlad-geo-demo/landsat_{band}.tif" for band in ("b4", "b10")]
    cluster(root, entry, variables, pair)
    folders = ("pcwlad-geo-demo/registered", "pcwlad-geo-cluster")
    tables = [root / "tmp" / name / "tiepoints.csv" for name in folders]
    same = tables[0].read_bytes() == tables[1].read_bytes()
    print("the cluster finds the same tie points" if same else "the cluster finds other tie points")
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
