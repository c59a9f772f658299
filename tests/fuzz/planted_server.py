"""A fork server whose command does, on purpose, what the judge must notice: the first argument says what."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from fuzz import server
from tests.patience import FOR_EVER_S


def say(text: str) -> None:
    sys.stderr.write(text + "\n")


def planted(argv: tuple[str, ...]) -> int:
    """Behave as the third argument says; else be an orderly run of `match`."""
    what = argv[3]
    out = Path("o")
    if what == "hang":
        time.sleep(FOR_EVER_S)
    elif what == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    elif what == "memory":
        held = []
        while True:
            held.append(b"x" * (8 << 20))
    elif what == "unexpected":
        say("error: unexpected ValueError: 12 (--debug shows where)")
        return 1
    elif what == "escaped exception":
        raise ValueError("not caught")
    elif what == "noise":
        say("ERROR 1: TIFFReadDirectory:Failed")
        say("error: t.tif is damaged")
        return 2
    elif what == "two errors":
        say("error: one\nerror: two")
        return 2
    elif what == "no reason":
        return 2
    elif what == "control":
        say("error: \x1b[31mred\x1b[0m")
        return 2
    elif what == "refused with files":
        out.mkdir()
        (out / "report.html").write_text("x")
        say("error: refused")
        return 2
    elif what == "nothing written":
        return 0
    elif what == "stage":
        Path(".o.stage-host-1").mkdir()
        (Path(".o.stage-host-1") / "report.json").write_text("{}")
    elif what == "lock":
        Path(".o.lock").write_text("1")
    elif what == "temporary":
        Path(os.environ["TMPDIR"], "left.tif").write_text("x")
    elif what == "beside":
        Path("t.tif.aux.xml").write_text("<PAMDataset/>")
    elif what == "above":
        Path("../../escaped.tif").write_text("x")
    elif what == "changed":
        Path("t.tif").write_bytes(b"changed")
    elif what == "removed":
        Path("t.tif").unlink()
    elif what == "orphan":
        subprocess.Popen(["sleep", str(FOR_EVER_S)], start_new_session=True)
    out.mkdir()
    (out / "tiepoints.csv").write_text("id\n")
    outputs = ["tiepoints.csv", *(["absent.tif"] if what == "partial" else [])]
    status = "rejected" if what == "other status" else "matched"
    (out / "report.json").write_text(
        "{" if what == "cut off" else json.dumps({"outputs": outputs, "status": status})
    )
    say("warning: windows shrunk")
    return 0


server.warm_up = lambda: b""
server._show_instead = lambda figure: None
server._main = planted

if __name__ == "__main__":
    server.serve()
