"""Two rasters described, placed, and made ready to be matched."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pcwlad_geo.errors import InputError
from pcwlad_geo.events import EventCallback, JobLog, ignore
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Bands, RasterInfo, describe, plan_views
from pcwlad_geo.raster.band_pixels import BandPixels
from pcwlad_geo.raster.cameras import expected_scale
from pcwlad_geo.raster.combined_bands import with_bands
from pcwlad_geo.raster.compression import with_compression_blocks
from pcwlad_geo.raster.fill import without_shared_fill
from pcwlad_geo.raster.identity import digest
from pcwlad_geo.raster.matching_grid import ONLY_PIXELS, limited, limited_to_overlap
from pcwlad_geo.raster.rpc.frame_camera import FrameCamera
from pcwlad_geo.raster.rpc.planning import plan_rpc_views
from pcwlad_geo.raster.source import same_band, with_areas
from pcwlad_geo.raster.undeclared import without_undeclared
from pcwlad_geo.registration.inputs import Inputs, identify_inputs, resolve
from pcwlad_geo.registration.placing import place_pair
from pcwlad_geo.registration.result import Pair
from pcwlad_geo.types import PathLike

BY_POINTS = "only the tie points given tell how the two lie"
"""What is said instead where tie points are given."""


@dataclass(frozen=True, slots=True)
class OpeningParameters:
    """Numbers of the check of two rasters."""

    misfit_px: float = 0.05
    """Largest distance of ground control points of a reference from a geotransform, px."""


def prepare_pair(
    reference: PathLike,
    target: PathLike,
    settings: Settings,
    *,
    on_event: EventCallback = ignore,
) -> Pair:
    """Describe two rasters, or products (see `inputs.resolve`), and decide on which pixels they are compared.

    See `prepare_inputs`.
    """
    return prepare_inputs(resolve(reference, target, settings), on_event=on_event)


def prepare_inputs(
    inputs: Inputs,
    *,
    on_event: EventCallback = ignore,
    parameters: OpeningParameters = OpeningParameters(),
) -> Pair:
    """Describe the two rasters of a job and decide on which pixels they are compared.

    No pixel is read, but for those that tell whether a raster without nodata and mask has a constant border,
    and whether one of 8 bits shows the blocks of lossy compression.
    `on_event` receives warnings. Raises `InputError` if the input cannot be used, or the two do not overlap.
    """
    log, settings = JobLog(on_event), inputs.settings
    with log.stage("reading"):
        if settings.fiducials is not None:
            FrameCamera.of_file(settings.fiducials)  # before the work
        files = identify_inputs(inputs)  # before any of them is read
        content = digest(file.identity for file in files)
        ref, ref_said, ref_pixels = _described(inputs.reference, inputs.ref_bands, settings.ref_mask, content)
        tgt, tgt_said, tgt_pixels = _described(inputs.target, inputs.tgt_bands, settings.tgt_mask, content)
        ref, tgt, placement, by_rpc, warnings = place_pair(ref, tgt, settings)
        ref, tgt, shared = without_shared_fill(ref, tgt, ref_pixels, tgt_pixels)
        ref = with_areas(ref, settings.aoi, settings.exclude)
        notes = (
            *inputs.notes,
            *_camera_notes(ref, tgt),
            *_drawn_notes(ref),
            *(ref_said + tgt_said + shared),
            *_control_point_notes(ref, tgt, parameters),
        )
        for warning in (*notes, *warnings):
            log.warn(warning)
        _check_outputs(settings, ref, tgt, has_rpc=placement is not None)
        views = plan_rpc_views(ref, tgt) if by_rpc else plan_views(ref, tgt)
        views = limited_to_overlap(limited(views, settings.extent) if settings.extent else views)
        for warning in views.warnings:
            log.warn(warning.replace(ONLY_PIXELS, BY_POINTS) if settings.tie_points else warning)
        if same_band(ref, tgt):
            log.warn(
                "reference and target are the same file and band: the displacement is zero by construction"
            )
    return Pair(
        reference=ref,
        target=tgt,
        views=views,
        settings=settings,
        warnings=tuple(log.warnings),
        inputs=files,
        seconds=log.seconds,
        rpc=placement,
    )


def _described(
    uri: str, bands: Bands, mask: PathLike | None, content: str
) -> tuple[RasterInfo, tuple[str, ...], BandPixels]:
    """Return a raster as the matching takes it, notes of its border and values, and the pixels looked at."""
    pixels = BandPixels(describe(uri, band=bands.first, mask=mask, part=True))
    info, notes = without_undeclared(pixels.info, pixels)
    return replace(with_bands(with_compression_blocks(info), bands), content=content), notes, pixels


def _check_outputs(settings: Settings, ref: RasterInfo, tgt: RasterInfo, *, has_rpc: bool) -> None:
    """Raise `InputError` if an output that is asked for is not defined for a pair."""
    if ref.grid.swath_uri and not tgt.grid.swath_uri:
        raise InputError(
            f"{ref.uri} is a swath, which geolocation arrays place, and a reference must be on a map grid: "
            "warp it first (gdalwarp -geoloc)"
        )
    if ref.grid.swath_uri and settings.write_displacement:
        raise InputError(f"{ref.uri} is a swath, on which no raster lies: leave out --write-displacement")
    if settings.write_proj_grid and not (tgt.on_map and tgt.grid.crs is not None):
        what = "RPCs, whose correction depends on the height" if has_rpc else "no CRS and geotransform"
        raise InputError(f"the target has {what}: leave out --write-proj-grid")
    if settings.write_stac and ref.grid.crs is None:
        raise InputError(
            "the reference has no CRS, and a STAC item tells where on earth a raster lies: leave out "
            "--write-stac, or give the reference a CRS (gdal_edit.py -a_srs)"
        )
    if settings.write_iiif and ref.grid.crs is None:
        raise InputError(
            "the reference has no CRS, and a IIIF annotation tells longitudes and latitudes: leave out "
            "--write-iiif, or give the reference a CRS (gdal_edit.py -a_srs)"
        )
    if settings.write_displacement and settings.displacement_unit == "m" and ref.grid.crs is None:
        raise InputError(
            "the reference has no CRS, so that a displacement in metres is not known: leave out "
            "--displacement-unit m, or give the reference a CRS (gdal_edit.py -a_srs)"
        )


def _camera_notes(reference: RasterInfo, target: RasterInfo) -> list[str]:
    """Tell what scale the cameras' data make expect of two frames, or why they are ignored."""
    _, note = expected_scale(reference.camera, target.camera)
    return [] if note is None or reference.georeferenced or target.georeferenced else [note]


def _drawn_notes(reference: RasterInfo) -> list[str]:
    """Tell of a reference that is a drawn map."""
    if reference.basemap is None or not reference.basemap.drawn:
        return []
    return [
        f"the reference {reference.basemap.name} is a drawn map: its lines lie where they can be read, up to "
        "some metres beside the ground, and names and symbols show nothing of it; an image is better"
    ]


def _control_point_notes(
    reference: RasterInfo, target: RasterInfo, parameters: OpeningParameters
) -> list[str]:
    """Tell how well control points are fitted by a geotransform; the reference's must be."""
    off_px = reference.gcp_misfit_px
    if off_px is not None and off_px > parameters.misfit_px:
        raise InputError(
            f"{reference.uri} is georeferenced by ground control points that no geotransform fits (off by "
            f"up to {off_px:.2f} px): a reference must be on a map grid; warp it first (gdalwarp -tps)"
        )
    off_px = target.gcp_misfit_px
    if off_px is None or off_px <= parameters.misfit_px:
        return []
    return [
        f"{target.uri} is georeferenced by ground control points: displacements count from the geotransform "
        f"that fits them best, which is off by up to {off_px:.1f} px; if that is much, raise --search-radius"
    ]
