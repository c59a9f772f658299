"""Public names of 1.0.0rc1 that 1.0 has no longer, and what takes their place."""

from typing import Final

_RESULT: Final = "it is the type of a result: use its attributes, or import it from {} in annotations"
"""What is said of types that nobody makes."""
DROPPED: Final = {
    "Accuracy": _RESULT.format("pcwlad_geo.correction.error_statistics"),
    "BatchResult": _RESULT.format("pcwlad_geo.multi.batch.run"),
    "CaptureOutcome": _RESULT.format("pcwlad_geo.rigs.applying"),
    "DataArrayLike": "give an xarray.DataArray; open takes any raster",
    "Decision": _RESULT.format("pcwlad_geo.registration"),
    "Event": "events are Progress or Warned",
    "EventCallback": "events are Progress or Warned, and on_event takes a function of one of them",
    "FittedCorrection": "fit returns a Correction",
    "MatchSettings": "give the options to match as keywords, such as match(reference, target, window=41)",
    "Matches": "match returns TiePoints, and raises RegistrationRejectedError where the pair is refused",
    "Options": "options are keywords with the names of the command line",
    "Pair": "match takes the two rasters: match(reference, target)",
    "PairOptions": "options are keywords with the names of the command line",
    "PairResult": _RESULT.format("pcwlad_geo.multi.qa.band_pairs"),
    "Pose": _RESULT.format("pcwlad_geo.registration"),
    "Prealignment": _RESULT.format("pcwlad_geo.registration"),
    "Proof": _RESULT.format("pcwlad_geo.correction.proof_result"),
    "QaResult": _RESULT.format("pcwlad_geo.multi.qa.numbers"),
    "Quality": _RESULT.format("pcwlad_geo.registration"),
    "RasterInfo": "open returns a Raster, with its grid, crs and nodata",
    "RasterLike": "open takes a path, a dataset, an array, an array with its Grid, a Raster or a DataArray",
    "RequirementResult": _RESULT.format("pcwlad_geo.requirements"),
    "RigApplied": _RESULT.format("pcwlad_geo.rigs.applying_run"),
    "RigLens": _RESULT.format("pcwlad_geo.rigs.rig"),
    "Runner": "executor takes any concurrent.futures.Executor",
    "Settings": "options are keywords with the names of the command line",
    "StackImage": _RESULT.format("pcwlad_geo.multi.stack.result"),
    "StackPair": _RESULT.format("pcwlad_geo.multi.stack.pair"),
    "StackQuality": _RESULT.format("pcwlad_geo.multi.stack.quality"),
    "TiePointTable": "tie points are TiePoints, which know their pair",
    "Trust": "give allow_remote=True or trust_vrt=True to open, match or register",
    "WarpOptions": "options are keywords of warp",
    "WatchNumbers": _RESULT.format("pcwlad_geo.multi.watch.numbers"),
    "match_arrays": "match takes arrays: match(reference, target)",
    "match_files": "match(reference, target) returns the tie points, and to_file writes them",
    "open_pair": "match takes the two rasters: match(reference, target); open describes one",
}
"""What to do instead, by name."""
