"""``pcwlad-geo warp``: a finished registration, applied to other bands of its target."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from pcwlad_geo.cli import options as o
from pcwlad_geo.cli.job import Ending, run_guarded
from pcwlad_geo.events import EventCallback
from pcwlad_geo.options import OutputGrid, Resampling
from pcwlad_geo.text import visible

Folder = Annotated[
    Path,
    typer.Argument(
        metavar="REGISTRATION", help="Output folder of an earlier pcwlad-geo register.", show_default=False
    ),
]
Rasters = Annotated[
    list[str],
    typer.Argument(metavar="RASTER...", help="Bands of its target, of any pixel size.", show_default=False),
]
WarpGrid = Annotated[
    OutputGrid | None,
    typer.Option("--grid", help="Output grid; the registration's by default.", show_default=False),
]
WarpFormat = Annotated[
    str | None,
    typer.Option("--of", metavar="DRIVER", help="Format, a GDAL driver; the registration's by default."),
]
WarpResampling = Annotated[
    Resampling | None,
    typer.Option("--resampling", help="Resampling; the registration's by default.", show_default=False),
]
Place = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--out-dir",
        metavar="OUT_DIR",
        help="Output folder.  [default: the working folder]",
        show_default=False,
    ),
]
WarpedRaster = Annotated[
    Path | None,
    typer.Option("--output-raster", metavar="FILE", help="The warped raster, of one RASTER, here instead."),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace rasters that exist.")]


@o.takes_settings("warp")
def warp(
    context: typer.Context,
    registration: Folder,
    rasters: Rasters,
    out_dir: Place = None,
    grid: WarpGrid = None,
    of: WarpFormat = None,
    resampling: WarpResampling = None,
    progress: o.ProgressOption = "auto",
    watch_stdin: o.WatchStdin = False,
    overwrite: Overwrite = False,
    output_raster: WarpedRaster = None,
    debug: o.Debug = False,
) -> None:
    """Apply the correction of REGISTRATION to other bands of its target."""
    given = {
        name: context.params[name] for name in ("grid", "like", "tr", "te", "t_srs", "of", "co", "resampling")
    }
    given |= {name: bool(context.params[name]) for name in ("allow_remote", "trust_vrt")}

    def work(on_event: EventCallback) -> Ending:
        from pcwlad_geo import band_warping  # slow to load

        places: dict[str, Any] = {"out_dir": out_dir, "output_raster": output_raster, "overwrite": overwrite}
        written = band_warping.warp(registration, rasters, **places, **given, on_event=on_event)
        paths = [str(path.absolute()) for path in written]
        return Ending({"status": "warped", "paths": paths}, visible("".join(f"{path}\n" for path in written)))

    def abandon() -> None:
        from pcwlad_geo.outputs import folder

        folder.abandon(output_raster.parent if output_raster else out_dir or ".")

    run_guarded(context.params, work, abandon)
