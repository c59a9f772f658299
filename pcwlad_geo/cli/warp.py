"""``pcwlad-geo warp``: the correction of a finished registration applied to other bands of its target."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from pcwlad_geo.cli import options as o
from pcwlad_geo.cli.running import Ending, run_guarded
from pcwlad_geo.events import EventCallback
from pcwlad_geo.options import OutputGrid, Resampling
from pcwlad_geo.text import visible

Folder = Annotated[Path, o.argument("REGISTRATION", "Output folder of an earlier pcwlad-geo register.")]
WarpRasters = Annotated[
    list[str], o.argument("FILE...", "Bands of its target, of any pixel size, and vectors drawn on it.")
]
WarpGrid = Annotated[
    OutputGrid | None, o.option("--grid", help="Output grid; the registration's by default.")
]
WarpFormat = Annotated[
    str | None,
    o.option("--of", help="Format, a GDAL driver; the registration's by default.", metavar="DRIVER"),
]
WarpResampling = Annotated[
    Resampling | None, o.option("--resampling", help="Resampling; the registration's by default.")
]
Place = Annotated[
    Path | None,
    o.option("-o", "--out-dir", help="Output folder.  [default: the working folder]", metavar="OUT_DIR"),
]
WarpedRaster = Annotated[
    Path | None,
    o.option("--output-raster", help="Write the warped raster, of one RASTER, to this file.", metavar="FILE"),
]
Inverse = Annotated[
    bool, o.option("--inverse", help="Move vectors from where they belong to where the target draws them.")
]
Sigma = Annotated[
    bool, o.option("--write-sigma", help="Give vectors a field sigma_m: the precision of their places.")
]
OverwriteRasters = Annotated[bool, o.option("--overwrite", help="Replace files that exist.")]


@o.takes_settings("warp")
def warp(
    context: typer.Context,
    registration: Folder,
    rasters: WarpRasters,
    out_dir: Place = None,
    grid: WarpGrid = None,
    of: WarpFormat = None,
    resampling: WarpResampling = None,
    progress: o.ProgressOption = "auto",
    watch_stdin: o.WatchStdin = False,
    inverse: Inverse = False,
    write_sigma: Sigma = False,
    overwrite: OverwriteRasters = False,
    output_raster: WarpedRaster = None,
    debug: o.Debug = False,
) -> None:
    """Correct other bands and vectors by a finished REGISTRATION."""
    options = {
        name: context.params[name] for name in ("grid", "like", "tr", "te", "t_srs", "of", "co", "resampling")
    }
    options |= {name: bool(context.params[name]) for name in ("allow_remote", "trust_vrt")}

    def work(on_event: EventCallback) -> Ending:
        from pcwlad_geo import band_warping  # slow to load

        places: dict[str, Any] = {"out_dir": out_dir, "output_raster": output_raster, "overwrite": overwrite}
        places |= {"inverse": inverse, "write_sigma": write_sigma}
        written = band_warping.warp(registration, rasters, **places, **options, on_event=on_event)
        paths = [str(path.absolute()) for path in written]
        return Ending({"status": "warped", "paths": paths}, visible("".join(f"{path}\n" for path in written)))

    def abandon() -> None:
        from pcwlad_geo.outputs import folder

        folder.abandon(output_raster.parent if output_raster else out_dir or ".")

    run_guarded(context.params, work, abandon)
