"""The container: what its files say, and its entry point as it is started there."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

REPOSITORY = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(REPOSITORY / "scripts"))
import rehearse_container as rehearsal  # noqa: E402

LINES = list(rehearsal.instructions((REPOSITORY / "Dockerfile").read_text(encoding="utf-8")))
COMPOSE = yaml.safe_load((REPOSITORY / "compose.yaml").read_text(encoding="utf-8"))


def every(name: str) -> list[str]:
    return [rest for instruction, rest in LINES if instruction == name]


def test_every_line_is_an_instruction_that_is_known() -> None:
    known = {"ARG", "FROM", "LABEL", "RUN", "COPY", "ENV", "USER", "WORKDIR", "ENTRYPOINT", "CMD"}
    assert {name for name, _ in LINES} == known
    assert all(json.loads(rest) for name, rest in LINES if name in ("ENTRYPOINT", "CMD"))


def test_it_does_not_run_as_root() -> None:
    last = LINES.index(("FROM", every("FROM")[-1]))
    (user,) = [place for place, (name, _) in enumerate(LINES) if name == "USER" and place > last]
    assert LINES[user][1] not in ("root", "0")
    assert [name for name, _ in LINES[user + 1 :] if name == "USER"] == []
    warmed = next(place for place, (name, rest) in enumerate(LINES) if name == "RUN" and " demo " in rest)
    assert warmed > user, "the user who runs it tries it"


def test_what_is_copied_is_there_and_let_in() -> None:
    let_in = rehearsal.context()
    copied = [shlex.split(rest) for rest in every("COPY") if "--from" not in rest]
    sources = [next(word for word in words if not word.startswith("--")) for words in copied]
    assert set(sources) - {"."} <= set(let_in)
    for needed in ("pyproject.toml", "README.md", "LICENSE", "docs/rig.schema.json", "docs/pcwlad-geo.1"):
        assert needed in let_in
    for called in (
        "scripts/index_readme.py",
        "hatch_build.py",
        "scripts/build_kernels.py",
        "kernels/windows.c",
    ):
        assert called in let_in, "hatchling calls it"
    assert "pcwlad_geo/cli/sample/landsat_b4.tif" in let_in
    assert not [name for name in let_in if name.startswith(("tests", "fuzz", ".git"))]


@pytest.fixture
def started(tmp_path: Path) -> Path:
    """A folder with programs that tell how the entry point starts them."""
    for program in ("pcwlad-geo", "dask"):
        script = tmp_path / program
        script.write_text(f'#!/bin/sh\necho {program} "$@"\n')
        script.chmod(0o755)
    return tmp_path


def start(folder: Path, *arguments: str) -> str:
    return subprocess.run(
        ["/bin/sh", str(REPOSITORY / "container" / "entrypoint"), *arguments],
        cwd=folder,
        env={"PATH": f"{folder}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=True,
    ).stdout


@pytest.mark.skipif(sys.platform == "win32", reason="the container runs Linux")
def test_commands_go_to_the_program_and_dask_is_itself(started: Path) -> None:
    assert start(started, "register", "a b.tif", "c.tif") == "pcwlad-geo register a b.tif c.tif\n"
    assert start(started, "dask", "scheduler") == "dask scheduler\n"
    assert start(started) == "pcwlad-geo\n"


def test_the_cluster_has_a_scheduler_two_workers_and_one_folder() -> None:
    services = COMPOSE["services"]
    assert services.keys() == {"scheduler", "worker", "pcwlad-geo"}
    assert services["worker"]["deploy"]["replicas"] == 2
    assert services["worker"]["command"][-1] == "tcp://scheduler:8786"
    assert services["scheduler"]["command"][:4] == ["dask", "scheduler", "--port", "8786"]
    assert services["worker"]["depends_on"] == {"scheduler": {"condition": "service_healthy"}}
    check = services["scheduler"]["healthcheck"]
    assert "('127.0.0.1', 8786)" in check["test"][-1], "the port of the command"
    assert check["retries"] * float(check["interval"].rstrip("s")) >= 60.0
    for service in services.values():
        assert service["read_only"] is True
        assert service["tmpfs"] == ["/tmp"]
        assert [volume.rpartition(":")[2] for volume in service["volumes"]] == ["/data"]
        assert "ports" not in service


@pytest.mark.parametrize("service", ["scheduler", "worker"])
def test_dask_knows_its_options(service: str) -> None:
    command = pytest.importorskip(f"distributed.cli.dask_{service}").main
    words = COMPOSE["services"][service]["command"][2:]
    command.make_context(service, words)  # raises on an option that it does not know
