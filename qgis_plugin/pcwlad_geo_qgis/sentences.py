"""Sentences of the engine in the language of QGIS: reasons, advice and warnings, known by their text."""

from __future__ import annotations

import re

from .text import mark, tr

SENTENCES = (
    # Why a pair is refused
    mark("only {} of {} candidates agree with their neighbours, in {} of {} separate places"),
    mark("none of the {} candidates agrees with its neighbours"),
    mark("no better than chance"),
    mark("{} tie points agree, in {} of {} separate places, and so few say too little"),
    mark("at least {} are needed"),
    mark("points within a matching window say the same: more places are needed"),
    mark("use rasters that share more ground, masks that exclude less, or a smaller --window"),
    mark("no structure to match: the overlap is flat, masked or too small; check bands, masks and nodata"),
    mark("almost no window has enough valid pixels in both images; check masks, nodata and overlap"),
    mark(
        "the candidates agree only up to multiples of {} px: both images show the grid of blocks that JPEG "
        "compression leaves, and little else; use images without it, or mask what shows nothing else"
    ),
    mark(
        "the common area is {} x {} px of the matching grid: too small to match (at least {} px a side); "
        "use rasters that share more ground"
    ),
    mark(
        "has no valid pixel (nodata, masks) where the two overlap: check its nodata value, its mask, or "
        "choose another band"
    ),
    mark("is constant where the two overlap: there is nothing to match; choose another band"),
    mark(
        "the rasters do not overlap: in {}, {} covers {} and {} covers {}: give two rasters of the same "
        "ground, or correct their georeferencing"
    ),
    mark(
        "bands of a product lie within metres of each other, and the matches agree on {}, probably clouds: "
        "mask them (--ref-mask, --tgt-mask), or give --prealign search if a band has been moved"
    ),
    mark(
        "and nothing tells which is that of the ground: give a mask (--ref-mask, --tgt-mask) with 0 on "
        "clouds and what else moves, or --prealign georef with a small --search-radius"
    ),
    mark("only {} % of the matches agree with their neighbours"),
    mark("{} % of the common ground lies beyond the tie points"),
    mark("and the correction does not hold"),
    mark(
        "Mask what moves, or choose images that are alike in what they show and taken from nearby viewpoints"
    ),
    mark("the two agree at exactly the same pixels of both files, and"),
    mark("only in what stands still in both frames"),
    mark("perhaps only in what stands still in both frames"),
    mark("a fixed pattern of the sensor, dust, vignetting, or text, lines and masks burnt in"),
    mark("only {} % of the places with structure agree there"),
    mark("once smoothed"),
    mark("without small specks that both have"),
    mark("without what whole columns or rows share"),
    mark("without what differs from pixel to pixel as a sensor's pattern does"),
    mark("without it there is ground that has moved by about ({}, {}) px"),
    mark("mask it, correct the frames for it, or give their georeferencing"),
    mark(
        "by the positions in their tags the cameras were {} m apart, and by focal length and height the "
        "frames show"
    ),
    mark(
        "what agrees may belong to the camera (its fixed pattern, dust, burnt-in text), or the ground repeats"
    ),
    mark(
        "the {} points of {} describe no common displacement (they scatter by {} of their spread): check "
        "their columns, and whose they are"
    ),
    # What a refused pair is told to try
    mark(
        "the search proposes ({}, {}) px (col, row), as it does by chance in one of {} pairs, and no tie "
        "points confirm it: check it by eye"
    ),
    mark(
        "{} has little more than two values, as a mask or a map of classes: match an image that it was made "
        "from, and move it by what that gives (shift)"
    ),
    mark("fill small gaps (gdal_fillnodata.py), around which too few pixels are valid, or"),
    mark(
        "if the two share a small part only, or their pixels differ more than four times in size, give both "
        "a rough geotransform (gdal_edit.py -a_ullr), right to some pixels, or"
    ),
    mark(
        "choose bands that look alike, or mask clouds and what has changed, unless the two do not show the "
        "same place"
    ),
    mark("many best matches lie on the edge of the search radius of {} px"),
    mark("raise --search-radius, or give --prealign search"),
    mark(
        "the displacement may exceed the search radius of {} px (raise --search-radius), or the two may be "
        "turned against each other (give --prealign search)"
    ),
    mark("this is the best of {} starts, which a search over all rotations, scales and shifts found at"),
    mark("a search over the whole image found no start that holds"),
    mark(
        "around the shift that a search over the whole image found: give --prealign search with "
        "--search-radius"
    ),
    mark("this is from the shift that a search over the whole image found"),
    mark("rotation {} degrees, scale {} x {}, shear {} degrees"),
    mark(
        "The pixels of the {} may be {} times as small, and scales about that were tried too, as were those "
        "from ¼ to 4: if the true scale is another, reduce the larger frame first (gdal_translate "
        "-outsize)"
    ),
    mark(
        "check also that the RPC in {} belongs to the target as it is, not to an image that it was cropped "
        "or decimated from"
    ),
    # Why a result is not good
    mark(
        "{} % of the matches agree on another displacement, ({}, {}) px beside the correction: what has "
        "moved, or ground at another depth, where it does not hold"
    ),
    mark("a tenth of the common ground is expected to lie more than {} px off after the {} correction"),
    mark("clouds that moved, relief, parallax, or too few tie points"),
    mark("rows or columns move by {} px (RMS) within a matching window (jitter)"),
    mark("the displacement bends by {} px (RMS) within a matching window"),
    mark(
        "a tenth of the {} check points lies more than {} px off the correction, {} times what their sigmas "
        "say"
    ),
    mark(
        "local displacements of {} px (68 % of the points) remain that the {} model does not take out: "
        "parallax of another viewpoint, relief or sensor jitter"
    ),
    mark("the matching is no more precise on this pair"),
    mark("most of them fit; the others lie on what moved, such as clouds, or at another depth"),
    mark("noise of the images, or displacements smaller than a matching window"),
    mark(
        "{} % of the common ground lies beyond the tie points: there the correction is extrapolated, and "
        "nothing checks it"
    ),
    mark(
        "{} % of the common ground shows nothing that could be matched, such as water, and lies beyond the "
        "tie points: the grade and the expected error are of the rest"
    ),
    mark(
        "the {} correction bends beyond the tie points: {} % of the common ground shows nothing that could "
        "be matched, and lies up to {} px off the affine trend of the points. Choose --model affine if that "
        "ground matters"
    ),
    mark(
        "a tenth of the tie points say that bands of one product lie more than {} m apart, which its "
        "geometry hardly allows: they may be on clouds, which each band sees elsewhere"
    ),
    mark(
        "the ground repeats, and the whole scene fits better at {}{} px (col, row) from the georeferencing: "
        "the tie points are probably one or more periods off; give --prealign search, or a better "
        "geotransform"
    ),
    mark(
        "the ground repeats, and the whole scene fits about as well at {}{} px (col, row) from the "
        "georeferencing: the tie points may be one or more periods off; check a place that does not repeat"
    ),
    mark(
        "{} % of the ground with structure, in one part, has no tie points and lies at about ({}, {}) px "
        "(col, row) from the georeferencing, {} px from the rest: a seam of a mosaic, what has moved, or "
        "clouds; there the correction does not hold. Where it is ground, raise --search-radius"
    ),
    mark(
        "the residuals run along the parallax of height: a tenth of them are over {} px along it, {} px "
        "across: the DEM {} errs by {} m and more there, which no correction takes out; give a finer or "
        "better one"
    ),
    mark(
        "the tie points are of a file without the results of their matching beside it: their own errors, "
        "and whether they were chosen by their residuals, are not known, so all figures may be too good"
    ),
    # What is told of the pair
    mark("no georeferencing that the two share (CRS and geotransform) in"),
    mark("only their pixels tell how the two lie"),
    mark("only the tie points given tell how the two lie"),
    mark(
        "the two share too little structure and are matched by the relation of their grey values, from "
        "which slopes and shadows may depart: tie points share an error of some {} px per axis, which is "
        "part of their sigmas"
    ),
    mark("--place is off"),
    mark("the georeferencing is off"),
    mark("by about ({}, {}) px (col, row; of the coarser raster): found by a search"),
    mark("a search found the target at {}, beside where that puts it"),
    mark("tile {} left out"),
    mark("windows of {} px give too few separate places to judge by: matched again with windows of {} px"),
    mark("narrow overlap of {} px: matching windows shrunk to {} px (coarse), {} px (fine)"),
    mark("has an RPC, which counts for a reference with a DEM only: it is not used"),
    mark("has a geotransform and an RPC: the RPC is not used; give --dem to use it"),
    mark("the matches agree on {} different displacements"),
    mark("px by {} points in {} separate places"),
    mark(
        "the first was taken for that of the ground, the rest for clouds, what else moves or lies at "
        "another depth; there the correction does not hold"
    ),
    mark(
        "the displacement holds parallax: {} px (RMS) across the epipolar lines, {} px along them beside "
        "what one plane gives: the tie points are right at every depth, and one smooth correction cannot "
        "follow them all"
    ),
    mark(
        "{} tie points around ({}, {}) px (col, row) of the target agree among themselves and lie ({}, {}) "
        "px off what all others predict: rejected as wrong matches; if the ground has moved there, or is at "
        "another depth, they are right, and the correction does not hold there"
    ),
    mark(
        "{} points that the matching had kept are left out of {}: residuals of the fit are those of chosen "
        "points; the check points are still all that were held out before"
    ),
    mark(
        "rows or columns are displaced against each other by {} px (RMS) within a matching window, and a "
        "tie point is the mean over it: the raster was resampled by nearest neighbour, or its scanner shook "
        "(jitter: try a smaller --window with --model jitter)"
    ),
    mark(
        "rising and falling edges lie ({}, {}) px (col, row) apart, as where one image shows heights, or "
        "other shadows: the tie points are means of the two, and share an error of half of that, which no "
        "residual shows and their sigmas hold"
    ),
    mark(
        "grey values lie ({}, {}) px (col, row) beside what the edges tell, as in other light: the tie "
        "points share an error of up to that, which no residual shows and their sigmas hold"
    ),
    mark(
        "what stands still in both frames agrees at no displacement; the ground was found about ({}, {}) px "
        "off, and is matched there"
    ),
    mark("its sigmas are not calibrated"),
    mark(
        "is a drawn map: its lines lie where they can be read, up to some metres beside the ground, and "
        "names and symbols show nothing of it; an image is better"
    ),
    mark(
        "is georeferenced by ground control points: displacements count from the geotransform that fits "
        "them best, which is off by up to {} px; if that is much, raise --search-radius"
    ),
    mark("reference and target are the same file and band: the displacement is zero by construction"),
    mark(
        "reference and target are of the same product {}: the correction is applied to all its bands but "
        "the reference; it holds for those that lie as the target does"
    ),
    mark("a border of a scanned frame (tone about"),
    mark("a constant border (value"),
    mark("of {} % of {} is taken for nodata; if it is data, declare another nodata value, or give a mask"),
    mark(
        "values that nothing measures, such as {}, are taken for nodata ({} % of {}); declare them so "
        "(gdal_edit.py -a_nodata), or give a mask"
    ),
    mark(
        "the DEM {} covers {} of {}: the rest is neither matched nor warped, as its heights are not known; "
        "the image lies at {}: give a DEM of all of it"
    ),
)
"""Sentences and parts of them; values stand in `{}`. A test compares them with the engine."""


def in_language(message: str) -> str:
    """Return a message of the engine with the sentences that are known in the language of QGIS."""
    for sentence in sorted(SENTENCES, key=len, reverse=True):  # some are parts of others
        if (said := tr(sentence)) != sentence:
            message = pattern(sentence).sub(lambda found, said=said: said.format(*found.groups()), message)
    return message


def pattern(sentence: str) -> re.Pattern[str]:
    """Return what finds a sentence; a value is one word where it begins or ends it."""
    parts = sentence.split("{}")
    values = ["(.+?)" if before and after else r"(\S+)" for before, after in zip(parts, parts[1:])]
    return re.compile("".join(map("".join, zip(map(re.escape, parts), [*values, ""]))))
