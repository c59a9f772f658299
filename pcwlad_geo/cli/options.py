"""The options that the commands share, named as the fields of `Settings`.

None means "not given": the config file, then the default of `Settings`, decides.
"""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from pcwlad_geo.registration import settings as s
from pcwlad_geo.registration.option_values import WORDS

ProgressStyle = Literal["auto", "bar", "json", "none"]

_DEFAULTS = {field.name: field.default for field in fields(s.Settings)}


def _setting(name: str, help_text: str, **more: Any) -> Any:  # noqa: ANN401  # typer's own type
    """Return the option of a field of `Settings`, its default shown in the help."""
    default = _DEFAULTS[name]
    shown = WORDS.get(name) if default is None else default
    if shown not in (None, ()):
        help_text += f"  [default: {shown}]"
    return typer.Option("--" + name.replace("_", "-"), help=help_text, show_default=False, **more)


Reference = Annotated[
    str, typer.Argument(metavar="REFERENCE", help="Raster that stays, or a product.", show_default=False)
]
Target = Annotated[
    str, typer.Argument(metavar="TARGET", help="Raster that moves, or a product.", show_default=False)
]

RefBand = Annotated[
    str | None, _setting("ref_band", "Band of the reference; of a product, its name.", metavar="N|NAME")
]
TgtBand = Annotated[
    str | None, _setting("tgt_band", "Band of the target; of a product, its name.", metavar="N|NAME")
]
RefMask = Annotated[
    str | None,
    _setting(
        "ref_mask", "Mask of the reference: 0 = excluded, or QA_PIXEL, SCL, MSK_CLASSI.", metavar="FILE"
    ),
]
TgtMask = Annotated[str | None, _setting("tgt_mask", "Mask of the target.", metavar="FILE")]
TiePoints = Annotated[
    str | None,
    _setting("tie_points", "Fit the tie points of this file, match nothing.", metavar="FILE"),
]
Dem = Annotated[str | None, _setting("dem", "Heights of the ground, for images with RPCs.", metavar="FILE")]
DemVertical = Annotated[
    str | None,
    _setting(
        "dem_vertical",
        "What is added to the DEM's heights to count from the ellipsoid (0: they do), where its CRS does not "
        "tell: metres, or a geoid grid.",
        metavar="METRES|GRID",
    ),
]
TrustRpc = Annotated[
    bool | None,
    typer.Option("--trust-rpc", help="Use RPCs as they are, wherever they put an image."),
]

Method = Annotated[s.Method | None, _setting("method", "Fine matching method.")]
Points = Annotated[
    str | None,
    _setting(
        "points",
        "Most tie points to keep, spread evenly; auto: about 1000 of a scene, all of a small image.",
        metavar="N|all|auto",
    ),
]
Features = Annotated[int | None, _setting("features", "Candidates a tile.", metavar="N")]
Keypoints = Annotated[
    s.Keypoints | None, _setting("keypoints", "Spread the candidates by cell, or take the strongest.")
]
Template = Annotated[int | None, _setting("template", "Side of the coarse window, odd, px.", metavar="PX")]
Window = Annotated[int | None, _setting("window", "Side of the refinement window, odd, px.", metavar="PX")]
SearchRadius = Annotated[
    str | None,
    _setting("search_radius", "Largest displacement looked for, matching-grid px.", metavar="PX|auto"),
]
SsimMin = Annotated[float | None, _setting("ssim_min", "Least SSIM of a coarse match.", metavar="X")]
Iterations = Annotated[int | None, _setting("iterations", "Most refinement iterations.", metavar="N")]
Consensus = Annotated[
    s.Consensus | None,
    _setting("consensus", "Second pass guided by the neighbours, in smooth fields."),
]
Prealign = Annotated[s.Prealign | None, _setting("prealign", "Rough alignment before matching.")]

Model = Annotated[s.Model | None, _setting("model", "Correction model.")]
Grid = Annotated[
    s.OutputGrid | None,
    _setting(
        "grid",
        "Grid of the registered raster: the reference's CRS and alignment, exactly the reference's grid, or "
        "the target's own.",
    ),
]
Like = Annotated[
    str | None,
    _setting("like", "Write exactly the CRS, geotransform and size of this raster.", metavar="FILE"),
]
Tr = Annotated[
    tuple[float, float] | None,
    _setting("tr", "Pixel size of the registered raster, units of its CRS.", metavar="XRES YRES"),
]
Te = Annotated[
    tuple[float, float, float, float] | None,
    _setting("te", "Extent of the registered raster, in its CRS.", metavar="XMIN YMIN XMAX YMAX"),
]
TSrs = Annotated[
    str | None,
    _setting("t_srs", "CRS of the registered raster instead of the reference's.", metavar="SRS"),
]
Of = Annotated[
    str | None, _setting("of", "Format of the registered raster, a GDAL driver.", metavar="DRIVER")
]
Co = Annotated[
    list[str] | None,
    _setting("co", "Creation option of that format; may be given again.", metavar="KEY=VALUE"),
]
Resampling = Annotated[s.Resampling | None, _setting("resampling", "Resampling of the registered raster.")]
WriteSigma = Annotated[
    bool | None,
    typer.Option("--write-sigma", help="Write the predicted sigma of the correction as a raster too."),
]
Pdf = Annotated[
    bool | None,
    typer.Option("--pdf", help="Write the report as PDF too; needs pip install 'pcwlad-geo[pdf]'."),
]
Require = Annotated[
    list[str] | None,
    typer.Option(
        "--require",
        metavar="EXPRESSION",
        help="Requirement, such as 'CE90<=0.5px' or 'points>=100'; exit status 4 where it is not met; "
        "repeatable.",
    ),
]
Keep = Annotated[
    bool | None,
    typer.Option("--keep", help="Write the corrected files although a requirement is not met."),
]
Jobs = Annotated[str | None, _setting("jobs", "Processes, at most; all: one a core.", metavar="N|all")]
Scheduler = Annotated[
    str | None,
    _setting("scheduler", "Run the tiles on a dask cluster, tcp://host:port.", metavar="ADDRESS"),
]

AllowRemote = Annotated[
    bool | None,
    typer.Option(
        "--allow-remote", help="Read rasters over a network: URLs, /vsicurl/, /vsis3/ and the like."
    ),
]
TrustVrt = Annotated[
    bool | None,
    typer.Option(
        "--trust-vrt", help="Let rasters name files anywhere: VRTs of your own, HDF5, formats with labels."
    ),
]

OutDir = Annotated[
    Path | None,
    typer.Option("-o", "--out-dir", metavar="OUT_DIR", help="Output folder.", show_default=False),
]
OutputRaster = Annotated[
    Path | None,
    typer.Option("--output-raster", metavar="FILE", help="Registered raster, here instead."),
]
OutputTiepoints = Annotated[
    Path | None,
    typer.Option("--output-tiepoints", metavar="FILE", help="Tie points CSV, here instead."),
]
OutputReport = Annotated[
    Path | None, typer.Option("--output-report", metavar="FILE", help="Report page, here instead.")
]
OutputPoints = Annotated[
    Path | None,
    typer.Option("--output-points", metavar="FILE", help="QGIS Georeferencer points, here instead."),
]
Overwrite = Annotated[
    bool, typer.Option("--overwrite", help="Replace the results of an earlier run in OUT_DIR.")
]
ProgressOption = Annotated[
    ProgressStyle,
    typer.Option("--progress", help="auto: a bar on a terminal; json: one object a line on standard output."),
]
WatchStdin = Annotated[bool, typer.Option("--watch-stdin", help="Cancel the run when standard input ends.")]
Config = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE.toml", help="Options by name; the command line wins."),
]
Debug = Annotated[
    bool, typer.Option("--debug", help="Show the traceback of an error, and what libraries write meanwhile.")
]
