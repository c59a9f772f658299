"""``pcwlad-geo shift``: rasters and vectors moved together by an amount that is known."""

from __future__ import annotations

from typing import Annotated

import typer

from pcwlad_geo.cli import options as o
from pcwlad_geo.cli.running import Ending, run_guarded
from pcwlad_geo.cli.warp import OverwriteRasters, Place
from pcwlad_geo.errors import SettingsError
from pcwlad_geo.events import EventCallback
from pcwlad_geo.text import visible

Files = Annotated[list[str], o.argument("FILE...", "Rasters in one CRS, and vectors in any.")]
By = Annotated[
    str,
    o.option(
        "--by",
        help="Movement along x and y in units of the first file's CRS, and a rotation before it, degrees "
        "counter-clockwise.",
        metavar="DX,DY[,ANGLE]",
    ),
]
About = Annotated[
    str | None,
    o.option(
        "--about",
        help="What the rotation leaves in place.  [default: the first file's middle]",
        metavar="X,Y",
    ),
]
Copy = Annotated[
    bool, o.option("--copy", help="Write copies of the rasters (COG) instead of VRTs of the originals.")
]


@o.takes_settings("shift")
def shift(
    context: typer.Context,
    files: Files,
    by: By,
    about: About = None,
    out_dir: Place = None,
    copy: Copy = False,
    progress: o.ProgressOption = "auto",
    watch_stdin: o.WatchStdin = False,
    overwrite: OverwriteRasters = False,
    debug: o.Debug = False,
) -> None:
    """Move rasters and vectors by the same amount; pixels stay untouched."""
    x, y, *angle = _numbers("--by", by, (2, 3))
    centre = None if about is None else _numbers("--about", about, (2,))
    trust = {name: bool(context.params[name]) for name in ("allow_remote", "trust_vrt")}

    def work(on_event: EventCallback) -> Ending:
        from pcwlad_geo import shifting  # slow to load

        written = shifting.shift_files(
            files,
            (x, y),
            angle_deg=angle[0] if angle else 0.0,
            about=None if centre is None else (centre[0], centre[1]),
            copy=copy,
            out_dir=out_dir,
            overwrite=overwrite,
            on_event=on_event,
            **trust,
        )
        paths = [str(path.absolute()) for path in written]
        return Ending(
            {"status": "shifted", "paths": paths}, visible("".join(f"{path}\n" for path in written))
        )

    def abandon() -> None:
        from pcwlad_geo.outputs import folder

        folder.abandon(out_dir or ".")

    run_guarded(context.params, work, abandon)


def _numbers(option: str, text: str, counts: tuple[int, ...]) -> list[float]:
    """Return the numbers of a text with commas; raise `SettingsError` if there are not so many."""
    try:
        numbers = [float(part) for part in text.replace(",", " ").split()]
    except ValueError:
        numbers = []
    if len(numbers) not in counts:
        expected = " or ".join(map(str, counts))
        raise SettingsError(f"{option} {text}: give {expected} numbers, separated by commas")
    return numbers
