"""Help for each parameter of the algorithms, as QGIS shows it beside its widget."""

from __future__ import annotations

from .text import mark

PARAMETERS = {
    "REFERENCE": mark("The raster whose place is right. It stays as it is."),
    "REFERENCE_BAND": mark("The band of the reference that is compared."),
    "INPUT": mark("The raster that is moved onto the reference."),
    "INPUT_BAND": mark("The band of the target that is compared. All bands are corrected."),
    "EXTENT": mark("Only this part of the two rasters is read, compared and written."),
    "AREA": mark("Tie points are sought inside these polygons only."),
    "EXCLUDED": mark("No tie points are sought inside these polygons, such as clouds, water or forest."),
    "REFERENCE_MASK": mark(
        "Excludes pixels of the reference: those where this raster is 0. QA_PIXEL, SCL and "
        "MSK_CLASSI rasters are understood."
    ),
    "INPUT_MASK": mark("Excludes pixels of the target: those where this raster is 0."),
    "DEM": mark("Heights of the ground, for a target with rational polynomial coefficients (RPC)."),
    "DEM_VERTICAL": mark("Metres, or the path of a geoid grid. 0: the heights count from the ellipsoid."),
    "MAX_CE90": mark(
        "90 % of the check points must lie within so many pixels. Otherwise no raster is written."
    ),
    "REQUIRE": mark(
        "Limits on the figures, such as CE90<=0.5px; points>=100. Where one is not met, no raster is written."
    ),
    "MODEL": mark(
        "How the displacement may change over the image. Automatic takes the simplest model that "
        "predicts points left out as well as any other."
    ),
    "GEOREFERENCE": mark(
        "The pixels stay as they are; a small file shows them at the right place. For shifts and "
        "affine corrections."
    ),
    "LIKE": mark("The registered raster gets exactly the CRS, pixels and size of this one."),
    "RESAMPLING": mark(
        "How pixels are interpolated. Nearest neighbour for classes, Lanczos for everything else."
    ),
    "TIE_POINTS": mark(
        "Fits the points of this file and matches nothing: tiepoints.csv, QGIS points, ENVI points."
    ),
    "KEEP": mark("Write the raster although a requirement is not met; the output PASSED says so."),
    "METHOD": mark("How two windows are compared. The first is the most precise."),
    "POINTS": mark("At most so many, spread evenly, the most precise of each neighbourhood."),
    "SEARCH_RADIUS": mark("Raise it where the displacement may exceed 12 pixels."),
    "WINDOW": mark("Larger windows are more precise, smaller ones follow finer displacements."),
    "PREALIGN": mark("Automatic believes the georeferencing, and searches the whole image where that fails."),
    "JOBS": mark("Number of processes that share a large scene. The result does not depend on it."),
    "EXTRA": mark("Any other option of the command line, as written there."),
    "OUTPUT": mark("The target, warped once from its original pixels. A GeoTIFF."),
    "OUTPUT_DISPLACEMENT": mark(
        "A raster of the displacement in metres east and north, its sigma and its quality."
    ),
    "OUTPUT_TIEPOINTS": mark("A layer of points, with an arrow for what is left at each, exaggerated."),
    "OUTPUT_HTML": mark("A page that says how well the two fit, where not, and what to do."),
    "OUTPUT_POINTS": mark(
        "Saved beside the target as <target>.points, the Georeferencer loads it by itself."
    ),
    "OUTPUT_FOLDER": mark("Keeps all files of the job. “Apply registration” and the editor need it."),
    "OUTPUT_CSV": mark("The figures as a table."),
    "REGISTRATION": mark("The folder that “Register raster” wrote as “Folder of all results”."),
    "INPUTS": mark("Rasters of the same ground."),
    "BANDS": mark("The bands that are compared. Not set: all."),
    "AGAINST": mark("Compares every band with this one instead of each with each."),
    "PRESET": mark("The registration that a mission promises."),
    "MASK": mark("Excludes pixels of all rasters: those where this one is 0."),
    "REFERENCE_NAME": mark("The raster whose grid all others get."),
    "DATUM": mark("One raster, which does not move; or the mean of all, if none is better than the others."),
    "BAND": mark("The band of each raster that is compared."),
    "MAX_PAIRS": mark("Fewer pairs are quicker, and less is checked."),
    "WHEEL": mark("The file pcwlad_geo-….whl."),
    "FOLDER": mark("The folder with pyproject.toml."),
    "WHEELHOUSE": mark(
        "A folder filled by “pip download” on a computer with internet; nothing is downloaded then."
    ),
    "PYTHON": mark("The program python3 or python.exe. That of QGIS is taken if it is new enough."),
}
