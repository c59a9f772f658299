"""The points of a pair that are matched again, and the parts of the scene around them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pcwlad_geo.correction import Effort
from pcwlad_geo.correction.error_statistics import FloatPair
from pcwlad_geo.correction.proof_result import Move
from pcwlad_geo.errors import InputError
from pcwlad_geo.matching import MatchSettings, Scales
from pcwlad_geo.matching.noise import noise_level
from pcwlad_geo.raster import Patch, Window, file_px_per_px
from pcwlad_geo.registration.proof.parameters import ProofParameters
from pcwlad_geo.registration.proof.resampling import Resampler
from pcwlad_geo.registration.result import Matches
from pcwlad_geo.registration.tiles import TileJob
from pcwlad_geo.types import Float64, Index


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """A part of the scene with some of the points, read once."""

    job: TileJob
    index: Index
    """Which of the points lie in it."""
    reference: Patch
    resampler: Resampler


@dataclass(frozen=True, slots=True, eq=False)
class ProofSetup:
    """What is needed to match some points of a pair again, on images that may differ from the files'."""

    sites: tuple[Site, ...]
    reference_px: Float64
    """(n, 2) positions (col, row) of the points, reference view px."""
    rows: Index
    """(n,) their rows in the table of tie points."""
    sigma_px: Float64
    """(n, 2) their sigmas, target view px."""
    settings: MatchSettings
    scales: Scales
    noise: FloatPair
    """Standard deviation of the noise of the reference and of the target, in units of their values."""
    centre_px: Float64
    """(2,) centre of the moves, target view px."""
    unit_px: Float64
    """(2,) px of the target file per view px."""
    parameters: ProofParameters


def set_up(matches: Matches, effort: Effort, parameters: ProofParameters = ProofParameters()) -> ProofSetup:
    """Choose points of a pair that is matched, and read the images around them.

    Raises `InputError` if the pair has too few points that were matched here, or a file cannot be read.
    """
    job, scales, least = matches.job, matches.scales, parameters.least_points
    table = matches.tie_points
    rows = np.flatnonzero(table.status == "matched")
    if job is None or scales is None or not matches.accepted or len(rows) < least:
        raise InputError(
            f"nothing can be proved: {len(rows) if matches.accepted else 0} tie points were matched here "
            f"reliably, and {least} are the least"
        )
    places = job.reference.from_file_px(table.reference_px[rows])
    settings = replace(job.settings, search_radius=job.settings.search_radius + 3, spare=0)  # for the moves
    job = replace(job, settings=settings)
    selection, of_site = _spread(places, job, effort, np.random.default_rng(0), parameters)
    unit_px = file_px_per_px(job.target)
    members = [np.flatnonzero(of_site == site) for site in np.unique(of_site)]
    sites = tuple(_read(job, index, places[selection], parameters) for index in members)
    moved_px = np.median(job.target.from_file_px(table.target_px[rows]) - places, axis=0)
    noise = [_noise(site, moved_px, parameters) for site in sites]
    reference_noise, target_noise = np.median(noise, axis=0).tolist()
    return ProofSetup(
        sites=sites,
        reference_px=places[selection],
        rows=rows[selection],
        sigma_px=table.sigma_px[rows[selection]] / unit_px,
        settings=settings,
        scales=scales,
        noise=(reference_noise, target_noise),
        centre_px=places.mean(axis=0) + job.target_offset_px,
        unit_px=unit_px,
        parameters=parameters,
    )


def _noise(site: Site, moved_px: Float64, parameters: ProofParameters) -> FloatPair:
    """Return the noise of both images, each compared with the other one, shifted by the displacement."""
    col, row = (moved_px - site.job.target_offset_px).tolist()
    reference = Resampler(site.reference.values, site.reference.valid, parameters)
    target = site.resampler
    moved_target, target_valid = target.moved(Move("shift", (-col, -row)), np.zeros(2))
    moved_reference, reference_valid = reference.moved(Move("shift", (col, row)), np.zeros(2))
    return (
        noise_level(reference.values, moved_target, reference.valid & target_valid),
        noise_level(target.values, moved_reference, target.valid & reference_valid),
    )


def _spread(
    places: Float64,
    job: TileJob,
    effort: Effort,
    random: np.random.Generator,
    parameters: ProofParameters,
) -> tuple[Index, Index]:
    """Choose points at random, of a large scene in some parts of it; return them and the part of each.

    The most precise ones are not preferred, as the errors of all are wanted.
    """
    region, order = job.region, random.permutation(len(places))
    count = parameters.of(parameters.points, effort)
    if max(region.shape) <= parameters.site_px:
        return np.sort(order[:count]), np.zeros(min(count, len(order)), np.intp)
    size = np.array([region.cols, region.rows])
    side_px = size / np.ceil(
        size / parameters.site_px
    )  # of equal size: a narrow one at an edge would count as much
    cell = np.floor((places - (region.col, region.row)) / side_px).astype(np.intp)
    _, of_point, counts = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    of_point = of_point.ravel()
    full = random.permutation(np.flatnonzero(counts >= min(parameters.least_points, counts.max())))
    full = full[: parameters.of(parameters.sites, effort)]
    share = -(-count // len(full))
    parts = [order[of_point[order] == site][:share] for site in full]
    return np.concatenate(parts), np.repeat(np.arange(len(parts)), [len(part) for part in parts])


def _read(job: TileJob, index: Index, places: Float64, parameters: ProofParameters) -> Site:
    """Read the part of both images that the matching of the points at an index needs."""
    low = np.floor(places[index].min(axis=0)).astype(int)
    high = np.floor(places[index].max(axis=0)).astype(int) + 1
    core = Window.from_bounds(int(low[1]), int(low[0]), int(high[1]), int(high[0]))
    job = replace(job, core=core, cell_margin_px=0)
    window, (col, row) = job.read_window, job.target_offset_px
    target = job.target.read(window.moved(row, col))
    resampler = Resampler(target.values, target.valid, parameters)
    return Site(job, index, job.reference.read(window), resampler)
