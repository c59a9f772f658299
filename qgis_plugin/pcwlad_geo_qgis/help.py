"""Texts of the dialogs: titles and help of all parameters, labels of choices, names of options."""

from __future__ import annotations

from .text import mark

PARAMETERS = {
    "REFERENCE": mark("The raster whose place is right. It stays as it is."),
    "SHOWN": mark("QGIS draws these layers, and the target is registered onto the picture."),
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
    "DEM": mark("Heights of the ground, for images with rational polynomial coefficients (RPC)."),
    "DEM_VERTICAL": mark(
        "What is added to the heights to count from the ellipsoid, where the CRS of the DEM does not tell: "
        "metres, or the path of a geoid grid. 0: they count from the ellipsoid."
    ),
    "MAX_CE90": mark(
        "90 % of the check points must lie within so many pixels. Otherwise no raster is written."
    ),
    "REQUIRE": mark(
        "Limits on the figures, such as CE90<=0.5px; points>=100. Where one is not met, no raster is written."
    ),
    "qa.REQUIRE": mark("Limits that every pair must meet, such as CE90<=0.3px; closure<=0.05px."),
    "watch.REQUIRE": mark("Limits on the largest of any series or part, such as step<0.2px; motion<1px."),
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
    "PLACE": mark(
        "Six numbers with commas: the GDAL geotransform in the CRS of the reference that the target gets "
        "instead of its own."
    ),
    "KEEP": mark("Write the raster although a requirement is not met; the output PASSED says so."),
    "METHOD": mark("How two windows are compared. The first is the most precise."),
    "POINTS": mark(
        "At most so many, spread evenly, the most precise of each neighbourhood. Not set: 1000 of a scene, "
        "all of a small image."
    ),
    "SEARCH_RADIUS": mark(
        "The largest displacement, pixels of the coarser raster. Raise it where that may exceed 12 pixels."
    ),
    "WINDOW": mark(
        "Its side, odd, pixels of the coarser raster. Larger windows are more precise, smaller ones follow "
        "finer displacements."
    ),
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
    "shift.INPUTS": mark("Rasters in one CRS, and vector layers in any."),
    "applyvectors.INPUTS": mark("Layers that were drawn on the target as it was."),
    "DX": mark("In the units of the CRS of the first layer, to the right."),
    "DY": mark("In the units of the CRS of the first layer, up."),
    "ANGLE": mark("Counter-clockwise, about the middle of the first layer, before the shift."),
    "INVERSE": mark("From where the layers belong to where the uncorrected target draws them."),
    "CAPTURES": mark("Raw frames as the camera wrote them, one file a lens, of captures in flight."),
    "RIG": mark("What an earlier run has learned of this camera. Not set: it is learned from the frames."),
    "BANDS": mark("The bands that are compared. Not set: all."),
    "AGAINST": mark(
        "Compares every band with this one instead of each with each: the end of its name, such as B4."
    ),
    "PRESET": mark("The registration that a mission promises."),
    "MASK": mark("Excludes pixels of all rasters: those where this one is 0."),
    "stack.REFERENCE": mark("The raster whose grid all others get."),
    "REFERENCE_NAME": mark("The raster whose grid all others get: the name of its file without extension."),
    "DATES": mark(
        "One of each raster, in their order, separated by semicolons, such as 2024-05-01; 2024-06-02. Needed "
        "for “Watch a stack”. Not set: the time of a layer (Properties, Temporal), or the date in the name "
        "of its file (2024-05-01 or 20240501)."
    ),
    "DATUM": mark("One raster, which does not move; or the mean of all, if none is better than the others."),
    "BAND": mark("The band of each raster that is compared."),
    "MAX_PAIRS": mark("Fewer pairs are quicker, and less is checked."),
    "EFFORT": mark(
        "Full takes more points, and makes a part of the pair harder until it is refused: a minute or more."
    ),
    "STACK": mark("The folder that “Adjust a stack” wrote."),
    "OUTPUT_ERRORS": mark("A layer of points, coloured by the error of one match, in target pixels."),
    "OUTPUT_MOTION": mark("A raster of the velocity of the ground and the parts that move by themselves."),
    "WHEEL": mark("The file pcwlad_geo-….whl. Not set: the package index has it."),
    "FOLDER": mark("The folder with pyproject.toml."),
    "WHEELHOUSE": mark(
        "A folder filled by “pip download” on a computer with internet; nothing is downloaded then."
    ),
    "PYTHON": mark("The program python3 or python.exe. That of QGIS is taken if it is new enough."),
}
"""Help for each parameter, as QGIS shows it beside its widget."""
TITLES = {
    "REFERENCE": mark("Reference (stays)"),
    "REFERENCE_BAND": mark("Band of the reference"),
    "SHOWN": mark("Layers to draw as the reference"),
    "INPUT": mark("Target (moves)"),
    "apply.INPUT": mark("Another band of the target"),
    "INPUT_BAND": mark("Band of the target"),
    "EXTENT": mark("Extent (not set: all)"),
    "AREA": mark("Area of interest"),
    "EXCLUDED": mark("Excluded area"),
    "REFERENCE_MASK": mark("Mask of the reference (0 = excluded)"),
    "INPUT_MASK": mark("Mask of the target (0 = excluded)"),
    "DEM": mark("DEM, for a target with RPCs"),
    "stack.DEM": mark("DEM, for images with RPCs"),
    "DEM_VERTICAL": mark("DEM: what is added to its heights"),
    "MAX_CE90": mark("Required accuracy: CE90, target pixels"),
    "REQUIRE": mark("Requirements, separated by semicolons"),
    "MODEL": mark("Correction model"),
    "GEOREFERENCE": mark("Only georeference (a VRT, no registered raster)"),
    "LIKE": mark("Grid of another raster"),
    "RESAMPLING": mark("Resampling"),
    "TIE_POINTS": mark("Tie points of a file"),
    "PLACE": mark("Geotransform of the target, put by hand"),
    "KEEP": mark("Keep the raster although a requirement is not met"),
    "METHOD": mark("Matching method"),
    "POINTS": mark("Tie points wanted (0: all; not set: automatic)"),
    "SEARCH_RADIUS": mark("Search radius, pixels (not set: automatic)"),
    "WINDOW": mark("Matching window, pixels (not set: automatic)"),
    "PREALIGN": mark("Rough alignment"),
    "JOBS": mark("Processes (not set: one a core)"),
    "EXTRA": mark("More options, such as --features 500"),
    "OUTPUT": mark("Registered raster"),
    "OUTPUT_DISPLACEMENT": mark("Displacement field"),
    "OUTPUT_TIEPOINTS": mark("Tie points"),
    "OUTPUT_HTML": mark("Report"),
    "OUTPUT_POINTS": mark("Points for the Georeferencer"),
    "OUTPUT_FOLDER": mark("Folder of all results"),
    "OUTPUT_CSV": mark("Table, a line a pair"),
    "stack.OUTPUT_CSV": mark("Table, a line a raster"),
    "rig.OUTPUT_CSV": mark("Table, a line a capture"),
    "watch.OUTPUT_CSV": mark("Table, a line a raster"),
    "OUTPUT_JSON": mark("Figures (JSON)"),
    "OUTPUT_ERRORS": mark("Errors of the matching"),
    "OUTPUT_MOTION": mark("Motion of the ground"),
    "EFFORT": mark("Effort"),
    "STACK": mark("Stack (folder of all results)"),
    "watch.EXTRA": mark("More options, such as --add image.tif"),
    "REGISTRATION": mark("Registration (folder of all results)"),
    "INPUTS": mark("Rasters"),
    "shift.INPUTS": mark("Layers"),
    "applyvectors.INPUTS": mark("Vector layers"),
    "DX": mark("dx"),
    "DY": mark("dy"),
    "ANGLE": mark("Angle, degrees"),
    "INVERSE": mark("Back, onto the uncorrected target"),
    "CAPTURES": mark("Folder of raw frames"),
    "RIG": mark("RIG.json of this camera (not set: learned)"),
    "registermany.INPUTS": mark("Targets (move)"),
    "BANDS": mark("Bands of each, such as 2,4-6 (not set: all)"),
    "AGAINST": mark("Compare every band with this one only"),
    "PRESET": mark("Requirement of a mission"),
    "MASK": mark("Mask of all rasters (0 = excluded)"),
    "stack.REFERENCE": mark("Reference (not set: the first)"),
    "REFERENCE_NAME": mark("Reference by its name, instead"),
    "DATES": mark("Dates (not set: of layers or file names)"),
    "DATUM": mark("What stays"),
    "BAND": mark("Band of each"),
    "MAX_PAIRS": mark("Most pairs that are matched (not set: enough)"),
    "WHEEL": mark("Wheel of pcwlad-geo (not set: the index)"),
    "FOLDER": mark("Or source folder of pcwlad-geo"),
    "WHEELHOUSE": mark("Folder of wheels, without internet"),
    "PYTHON": mark("Python 3.10 or newer (not set: found)"),
    "out.POINTS": mark("Tie points"),
    "out.SHIFT": mark("Median displacement, target pixels"),
    "out.SHIFT_COL": mark("Median displacement to the right, target pixels"),
    "out.SHIFT_ROW": mark("Median displacement down, target pixels"),
    "out.RMSE": mark("RMSE at check points, target pixels"),
    "out.CE90": mark("CE90 at check points, target pixels"),
    "out.RMSE_M": mark("RMSE at check points, metres"),
    "out.CE90_M": mark("CE90 at check points, metres"),
    "out.QUALITY": mark("Quality: good, fair or poor"),
    "out.VERDICT": mark("Verdict, in a sentence"),
    "out.PASSED": mark("Requirements met"),
    "out.PAIRS": mark("Pairs"),
    "out.REFUSED": mark("Pairs refused"),
    "out.REGISTERED": mark("Targets registered"),
    "out.IMAGES": mark("Rasters"),
    "prove.out.RMSE": mark("RMSE of a tie point, target pixels"),
    "prove.out.CE90": mark("CE90 of a tie point, target pixels"),
    "out.BIAS_COL": mark("Bias to the right, target pixels"),
    "out.BIAS_ROW": mark("Bias down, target pixels"),
    "out.FALSE_MATCHES": mark("Wrong matches that passed every test"),
    "out.STEPS": mark("Steps"),
    "out.MOVING": mark("Parts of the ground that move"),
    "out.ENGINE": mark("Engine"),
    "out.VERSION": mark("Version of the engine"),
    "out.FITS": mark("Fits this plugin"),
}
"""Titles of parameters, where an algorithm has another one after its name; of outputs after `out`."""
LABELS = {
    "oriented": mark("Oriented phase congruency (precise)"),
    "gradient": mark("Gradients (fast)"),
    "pcwlad": mark("PCWLAD, as published"),
    "pclad": mark("PCLAD, as published"),
    "pclsm": mark("PCLSM, as published"),
    "coarse": mark("Whole pixels only"),
    "auto": mark("Automatic"),
    "shift": mark("Shift"),
    "rigid": mark("Shift and rotation (rigid)"),
    "similarity": mark("Shift, rotation and scale (similarity, Helmert)"),
    "affine": mark("Affine (Polynomial 1)"),
    "projective": mark("Projective"),
    "polynomial": mark("Polynomial"),
    "tps": mark("Thin-plate spline"),
    "field": mark("Measured field"),
    "jitter": mark("Affine and waves (jitter)"),
    "rpc": mark("RPC"),
    "georef": mark("The georeferencing only"),
    "search": mark("Search the whole image"),
    "none": mark("None"),
    "nearest": mark("Nearest neighbour (classes)"),
    "bilinear": mark("Bilinear"),
    "cubic": mark("Cubic"),
    "cubic_spline": mark("Cubic spline"),
    "lanczos": mark("Lanczos"),
    "sentinel2": mark("Sentinel-2"),
    "landsat-oli": mark("Landsat OLI"),
    "landsat-tirs": mark("Landsat TIRS"),
    "quick": mark("Quick (a sample of points)"),
    "full": mark("Full (more points, and what the pair tolerates)"),
    "reference": mark("The reference"),
    "mean": mark("The mean position of all"),
}
"""What the dialogs call the choices of the engine."""
TAGS = {
    "": mark("pcwlad,coregistration,coregister,image registration"),
    "register": mark("align,georeference,georeferencer,thermal,tie points,image matching,warp,rectify,gcp"),
    "match": mark("align,tie points,image matching,georeferencer,gcp,thermal"),
    "registermany": mark("align,georeference,thermal,batch,image matching"),
    "apply": mark("align,georeference,warp,rectify"),
    "stack": mark("align,time series,georeference,block adjustment"),
    "rig": mark("thermal,multispectral,drone,uav,bands"),
}
"""Words of a search that find the algorithms: of all, and of each."""
LEGEND = {
    r"rejected": mark("rejected"),
    r"not fitted": mark("not fitted"),
    r"check point": mark("check point"),
    r"residual up to (\S+) px": mark("residual up to {} px"),
    r"residual (\S+) to (\S+) px": mark("residual {} to {} px"),
    r"residual over (\S+) px": mark("residual over {} px"),
}
"""What the engine calls the classes of its styled layers."""
ARROWS = mark("{} (arrows × {})")
"""A class that is drawn by longer arrows."""
OPTIONS = {
    "--search-radius": mark("Search radius"),
    "--points": mark("Tie points wanted"),
    "--method": mark("Matching method"),
    "--model": mark("Correction model"),
    "--window": mark("Matching window"),
    "--prealign": mark("Rough alignment"),
    "--resampling": mark("Resampling"),
    "--like": mark("Grid of another raster"),
    "--jobs": mark("Processes"),
    "--tie-points": mark("Tie points of a file"),
    "--require": mark("Requirements"),
    "--extent": mark("Extent"),
    "--dem": mark("DEM, for a target with RPCs"),
    "--dem-vertical": mark("DEM: what is added to its heights"),
    "--aoi": mark("Area of interest"),
    "--exclude": mark("Excluded area"),
    "--ref-mask": mark("Mask of the reference"),
    "--tgt-mask": mark("Mask of the target"),
    "--ref-band": mark("Band of the reference"),
    "--tgt-band": mark("Band of the target"),
    "--place": mark("Geotransform of the target, put by hand"),
    "--keep": mark("Keep the registered raster although a requirement is not met"),
}
"""What the dialogs call the options that they have a widget for."""
STAGES = {
    "reading": mark("Reading"),
    "inspecting": mark("Inspecting the captures"),
    "fetching": mark("Fetching the map"),
    "prealignment": mark("Rough alignment"),
    "starts": mark("Rough alignment"),
    "matching": mark("Matching"),
    "pairs": mark("Pairs"),
    "refining": mark("Refining"),
    "overlaps": mark("Captures that overlap"),
    "testing": mark("Testing the rig"),
    "fitting": mark("Fitting the correction"),
    "proving": mark("Measuring the error of the matching"),
    "images": mark("Rasters"),
    "rasters": mark("Rasters"),
    "captures": mark("Captures"),
    "dates": mark("Dates"),
    "writing": mark("Writing"),
    "warping": mark("Warping"),
    "vectors": mark("Vectors"),
}
"""What the engine's stages are called."""
MODELS = {
    "shift": mark("Shift"),
    "affine": mark("Affine"),
    "projective": mark("Projective"),
    "polynomial2": mark("Polynomial 2"),
    "polynomial3": mark("Polynomial 3"),
    "tps": mark("Thin-plate spline"),
    "field": mark("Measured field"),
}
"""What the editor calls the models that it fits."""
COLUMNS = [
    mark("Enabled"),
    mark("ID"),
    mark("Source X"),
    mark("Source Y"),
    mark("Dest. X"),
    mark("Dest. Y"),
    mark("dX (pixels)"),
    mark("dY (pixels)"),
    mark("Residual (pixels)"),
    mark("Sigma (pixels)"),
    mark("Status"),
]
"""Columns of the editor's table: those of the Georeferencer, and two more."""
STATUSES = {
    "fit": mark("fit"),
    "matched": mark("matched"),
    "check": mark("check"),
    "unused": mark("unused"),
    "rejected": mark("rejected"),
}
"""What a tie point counts as."""
VERDICTS = {
    "good": (
        mark("The layers fit well: 90 % of the common ground is expected to lie within {}."),
        mark("The layers fit well: 90 % of the area is expected to lie within {}, of the whole layer {}."),
    ),
    "fair": (
        mark("The layers fit fairly: 90 % of the common ground is expected to lie within {}."),
        mark("The layers fit fairly: 90 % of the area is expected to lie within {}, of the whole layer {}."),
    ),
    "poor": (
        mark("The layers fit poorly: 90 % of the common ground is expected within {} only."),
        mark("The layers fit poorly: 90 % of the area is expected within {} only, of the whole layer {}."),
    ),
}
"""The quality in a sentence: of all that both layers show, or of an area and of all."""
QUALITY_LINES = (
    mark("Quality: {}; 90 % of the common ground is expected to lie within {}"),
    mark("Quality: {}; 90 % of the area is expected to lie within {}, of all that both rasters show {}"),
)
"""The same in the log."""
QA_LINE = mark(
    "{target} on {reference}: {n} points, mean {mean_col_px} px to the right, {mean_row_px} px down; "
    "CE90 {ce90_px} px"
)
"""What is told of a pair of bands."""
PROOF_LINE = mark(
    "Bias: {BIAS_COL:+.3f} px to the right, {BIAS_ROW:+.3f} px down. A tie point errs by RMSE {RMSE:.3f} px, "
    "CE90 {CE90:.3f} px; wrong matches that passed every test: {FALSE_MATCHES}"
)
"""What is told of a proof."""
WATCH_LINE = mark("Series: {series}; steps: {steps}; parts of the ground that move: {moving}")
"""What is told of a stack over time."""
IMPROVED = mark("{} of {} points are refined by matching. The others contradict {}: those are selected.")
"""What is told of points that were refined."""
PLACE_KEYS = mark(
    "Drag moves the layer, Ctrl-drag turns it, Alt-wheel scales it, arrow keys step, Ctrl-Z takes back."
)
PLACE_PAIRS = mark("Click a place of the layer, then where it belongs; up to three times.")
"""How a layer is placed by hand."""
GRADES = {"good": mark("good"), "fair": mark("fair"), "poor": mark("poor")}
"""The quality in a word."""
MARKED = {
    grade: tuple(f'<b style="color: {colour}">{sign} {{}}</b>' for colour in colours)
    for grade, sign, *colours in (
        ("good", "✔", "#116329", "#4ac26b"),
        ("fair", "▲", "#7d4e00", "#e3b341"),
        ("poor", "▲", "#953800", "#ffa657"),
        ("refused", "✖", "#a40e26", "#ff9492"),
    )
}
MARKED |= {"note": ("<b>{}</b>",) * 2, "": ("{}",) * 2}
"""How a verdict is shown on a light and on a dark window, by the quality or for what was refused."""
NOT_IN_INDEX = mark("The package index has no pcwlad-geo: choose “From a wheel…” or “From a folder…”.")
"""What is told where an index lacks the engine."""
NEEDS_TRUST = mark(
    "{}: files of this kind can name other files. QGIS has opened it; the engine does so once you trust it."
)
"""What is asked once of a layer that may name files elsewhere."""
NO_ENGINE = mark("No pcwlad-geo engine was found.")
"""What is told where there is no engine."""
INSTALL_ONE = mark(
    "Install one by “Install engine”, in the dock or the Processing toolbox. "
    "One that is somewhere else: name it in Processing options, Providers, pcwlad-geo."
)
"""What is advised where there is no engine that fits."""
OTHER_VERSION = mark("The engine {} has version {} (protocol {}), this plugin is {} and needs protocol {}.")
"""What is told of an engine that does not fit."""
THE_MAP = mark("What the map shows")
NO_FILE = mark(
    "The layer “{}” is no raster file (it comes from the provider “{}”). "
    "Save it first: right-click the layer, Export, Save As…, and use the file."
)
OPEN_OPTIONS = mark(
    "The layer “{}” is opened with options ({}) that the engine cannot use. Save it as a file first."
)
FILTERED = mark(
    "The layer “{}” shows a part of its file (filter {}). Remove the filter, or save it as a file."
)
NO_VECTOR = mark(
    "The layer “{}” is no file as QGIS shows it: it has unsaved edits, a filter, or another CRS, or is of a "
    "database. Save it as a file first."
)
"""What is told of layers that the engine cannot open."""
ONLY_GEOREFERENCE = mark(
    "Only georeferencing takes the models shift and affine: choose one of them, or automatic."
)
"""What is told of a model that a geotransform cannot hold."""
OTHER_ENGINE = mark("The {} names another engine, {}, which goes before this one: clear it to use this one.")
"""What is told where a new engine would not be used."""
NO_MATCH = mark(
    "No match within the radius: the point is where you have clicked, and counts as less certain."
)
"""What is told of a point that was placed by hand alone."""
MORE_LAYERS = mark("Other rasters that are aligned with the same reference, one after the other.")
DRAWN = mark("Vector layers that were drawn on the layer as it was. They are moved as its pixels were.")
OTHER_BANDS = mark(
    "Rasters of the same pixels' place as the layer, such as its other bands, of any pixel size."
)
"""Help for the lists of layers in the dock."""
