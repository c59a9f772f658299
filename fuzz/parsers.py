"""Fuzz the parsers of our own, guided by the code that their input reaches where atheris is installed.

Usage::

    python fuzz/parsers.py [--only NAME] [--seconds N | --count N] [--seed S] [--plain]

Without atheris (`pip install 'pcwlad-geo[fuzz]'`; it needs Linux and a Python that it has a wheel for), or
with `--plain`, the mutators of the command line's fuzzer damage the same seeds, which is reproducible but not
guided. A parser may raise an error with a message, and nothing else. The exit status is 1 if one does
otherwise.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from random import Random
from typing import Final

REPOSITORY: Final = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(REPOSITORY))

DEFAULT_SECONDS: Final = 10.0
MAX_BYTES: Final = 20_000


def main(arguments: Sequence[str] | None = None) -> int:
    """Fuzz each parser, or one; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--only", metavar="NAME", help="this parser only")
    parser.add_argument("--seconds", type=float, default=DEFAULT_SECONDS, help="for each parser (10)")
    parser.add_argument("--count", type=int, help="inputs for each parser instead; implies --plain")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--plain", action="store_true", help="do without atheris")
    parser.add_argument("--guided-child", type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args(arguments)
    if asked.guided_child:
        _be_guided(asked.only, asked.guided_child, asked.seconds, asked.seed)
    guided = not asked.plain and asked.count is None
    if guided and importlib.util.find_spec("atheris") is None:
        print("atheris is not installed: plain mutations instead (pip install 'pcwlad-geo[fuzz]')")
        guided = False
    from fuzz.targets import targets

    names = [asked.only] if asked.only else list(targets())
    results = [_guided(name, asked) if guided else _plain(name, asked) for name in names]
    return int(any(results))


def _plain(name: str, asked: argparse.Namespace) -> bool:
    """Damage the seeds of a parser; return whether it has failed."""
    from fuzz.cases import damaged
    from fuzz.judge import plain
    from fuzz.mutators import raw, text, xml
    from fuzz.targets import complaint, targets

    target, since, number = targets()[name], time.monotonic(), 0
    found: dict[str, tuple[int, bytes]] = {}
    ways = (text.damage, text.damage, xml.damage, raw.damage)
    with warnings.catch_warnings(), _libraries_silent():
        warnings.simplefilter("ignore")
        while number < asked.count if asked.count else time.monotonic() - since < asked.seconds:
            random = Random(f"{name}/{asked.seed}/{number}")
            data = random.choice(target.seeds)
            for _ in range(random.choice((1, 1, 2, 4))):
                data = damaged(random, random.choice(ways), data)[0]
            said = complaint(target, data)
            if said is not None:
                found.setdefault(plain(said.splitlines()[0]), (number, data))
            number += 1
    rows = [(said, f"seed {asked.seed}, number {place}", data) for said, (place, data) in found.items()]
    _tell(name, f"{number} inputs", rows)
    return bool(found)


@contextmanager
def _libraries_silent() -> Iterator[None]:
    """Point standard error at nothing, as the command line does while it works."""
    sys.stderr.flush()
    kept, nothing = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nothing, 2)
    try:
        yield
    finally:
        sys.stderr.flush()
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nothing)


def _guided(name: str, asked: argparse.Namespace) -> bool:
    """Let atheris look for inputs in a process of its own, which ends at the first that fails."""
    with tempfile.TemporaryDirectory(prefix="pcwlad-geo-parsers-") as place:
        done = subprocess.run(
            [sys.executable, __file__, "--only", name, "--guided-child", place, "--seconds",
             str(asked.seconds),
             "--seed", str(asked.seed)],
            capture_output=True, text=True, check=False, timeout=asked.seconds * 4 + 300, errors="replace",
        )  # fmt: skip
        crashes = sorted(Path(place).glob("found-*"))
        said = [line for line in done.stderr.splitlines() if line.startswith("complaint: ")]
        executed = [line for line in done.stderr.splitlines() if line.startswith("Done ")]
        _tell(name, executed[-1].strip() if executed else "ended at the first failure",
              [(said[-1] if said else f"exit {done.returncode}", "found by atheris", each.read_bytes())
               for each in crashes])  # fmt: skip
    if not crashes and done.returncode != 0:
        print("\n".join(done.stderr.splitlines()[-5:]))
    return bool(crashes) or done.returncode != 0


def _be_guided(name: str, place: Path, seconds: float, seed: int) -> None:
    """Be the process in which atheris runs a parser; does not return."""
    import atheris

    with atheris.instrument_imports(include=["pcwlad_geo"]):
        from fuzz.targets import complaint, targets
    target = targets()[name]
    corpus = place / "corpus"
    corpus.mkdir()
    for number, data in enumerate(target.seeds):
        (corpus / str(number)).write_bytes(data)
    warnings.simplefilter("ignore")

    def one(data: bytes) -> None:
        said = complaint(target, data)
        if said is not None:
            sys.stderr.write(f"complaint: {said.splitlines()[0]}\n")
            raise RuntimeError(said)

    options = [f"-max_total_time={max(1, round(seconds))}", f"-seed={seed}",
               f"-artifact_prefix={place}/found-",
               f"-max_len={MAX_BYTES}", "-rss_limit_mb=3072", "-timeout=20"]  # fmt: skip
    atheris.Setup([sys.argv[0], *options, str(corpus)], one)
    atheris.Fuzz()


def _tell(name: str, how_much: str, found: Sequence[tuple[str, str, bytes]]) -> None:
    print(f"{name:20} {how_much}: {f'{len(found)} failures' if found else 'no failure'}", flush=True)
    for said, where, data in found:
        print(f"    {said[:160]} ({where}): {data[:120]!r}{'…' if len(data) > 120 else ''}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
