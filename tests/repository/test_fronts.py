"""The fronts of the rooms: the written lists of what code outside of a room uses of it."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
USERS = ("pcwlad_geo", "benchmarks", "docs", "fuzz", "qgis_plugin", "tests")
STILL_INNER = {
    "matching": """
        ChannelPair Core GUIDANCE Lost MatchingWindow OUTCOMES Prediction
        Predictor PreparedPair Surface TRAITS WINDOWS WindowErrors calibrate can_try_again cell_side_px
        choose_scales confirmed consistent consistent_points contradicted_clusters contrast_weight
        displacement_by_stripes displacement_by_surroundings displacement_by_windows expect_lost fast_even
        fill_smoothly global_affine in_rounds in_threads jitter_px margin_px matched_again narrow_gaps
        noise_level predict prepare refine sample_size to_index try_again

        GREY Noise PoseProposal POSE Rival SCALES SearchResult Tones evidence_against_chance
        mean_distance_px noise_of_samples of_whole_image poses_by_grey_values rivals_of rounding_of
        scene_epsilon search_pose without_speckle

        EPIPOLAR EpipolarGeometry epipolar_evidence largest_distance_px on_their_lines parallax_evidence
        plane_of plane_residual_px

        ChannelMaps InitialEstimate POINTER Refined WHOLE address function oriented_gradients
        spline_coefficients

        NOISE ORIENTATIONS keypoints match_coarsely maximum_moment
        oriented_phase_congruency
    """,
    "registration": """
        Editor PLACE_STATES INLINE MatchRecord SAME_PIXELS check_model check_placed correct_other_image
        corrected_rpc describe_motions displaced_otherwise grid_request ground_crs identify_inputs
        position_conflict MotionParameters

        JudgeParameters PairParameters ProofParameters SceneParameters fit_correction height_errors moves_of
        plan read_overviews set_up
    """,
    "raster": """
        BIAS_TOLERANCE_PX BLOCK_PX BandPart BandPixels Camera FrameCamera GDAL_ERRORS HDF4_FILES
        LIBRARY_ERRORS SWATH_FILES MATCHING_GRIDS MM_PER_UNIT ONLY_PIXELS OUTPUT_GRIDS PLACEMENT
        Raster RasterLike Scratch TERMS TiltedGrid Undulation VectorLayer Vertical accepted apply apply_bias
        bands_of
        bias_error_px camera_of carried check_covered check_dataset check_format checked_vector
        corrected_outline corrected_transform covered_range current_trust derived_terms digest
        displacement_m exif_of expected_scale explained file_of files_of gcps_only geotransform_of
        grid_on_plane_of ground_grid guessed_scale has_quick_overview ignoring image_px is_archive
        is_dataset is_huge is_invertible is_quality_raster like_the_source limited limited_to_overlap
        linear_part lon_lat_bounds lon_lat_outline metres_between moved_xy name_in name_of number_of
        open_dem open_written_raster ortho ortho_grid orthorectify output_grid output_lattice parallax
        parse_rpc_text pixel_size_m place_by_rpc plain_uri plan_rpc_views polynomial_terms read_layers
        read_raster reading referred relief requested_ortho_grids root_cause same same_band scratch_folder
        share_plane sink small_block_cache source sqlite_file to_gdal to_raster tree_of utm_zone_of
        verify_output view vrt warp_in_memory warping with_areas with_bands with_compression_blocks
        with_height_offset without_shared_fill without_undeclared write_cog write_corrected_vrt
        write_rpc_text write_rpc_vrt
        xmp_of
    """,
}
"""Names of inner modules that code outside uses: for scenes and tiles, the initial alignment, perspective
images, rigs, reports, stacks, and tests and benchmarks of parts. The lists may only become shorter."""
MOST_INNER = {"matching": 85, "registration": 26, "raster": 119}
MOST_FRONT = {"matching": 15, "registration": 35, "raster": 40}
OF_THE_ROOM = {
    "matching": ("pcwlad_geo/matching", "tests/matching", "tests/oracles"),
    "registration": ("pcwlad_geo/registration", "tests/registration"),
    "raster": ("pcwlad_geo/raster", "tests/raster"),
}


@cache
def front_of(room: str) -> frozenset[str]:
    tree = ast.parse((REPOSITORY / "pcwlad_geo" / room / "__init__.pyi").read_text(encoding="utf-8"))
    return frozenset(
        alias.name for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names
    )


@cache
def imports() -> list[tuple[str, str, frozenset[str]]]:
    """Return the files that import names from modules of this package, the modules and the names."""
    paths = [path for folder in USERS for path in (REPOSITORY / folder).rglob("*.py")]
    return [
        (path.relative_to(REPOSITORY).as_posix(), node.module, frozenset(alias.name for alias in node.names))
        for path in paths
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("pcwlad_geo.")
    ]


def inner_uses(room: str) -> Iterator[tuple[str, str]]:
    """Yield the files outside of a room and the names that they import from its inner modules."""
    for file, module, names in imports():
        if file.startswith(OF_THE_ROOM[room]):
            continue
        if module == f"pcwlad_geo.{room}":
            yield from ((file, name) for name in names - front_of(room))
        elif module.startswith(f"pcwlad_geo.{room}."):
            yield from ((file, name) for name in names)


@pytest.mark.parametrize("room", STILL_INNER)
def test_code_outside_uses_the_front_of_a_room(room: str) -> None:
    front, inner = front_of(room), set(STILL_INNER[room].split())
    uses = sorted(inner_uses(room))
    assert [(file, name) for file, name in uses if name in front] == []
    assert [(file, name) for file, name in uses if name not in front | inner] == [], "use the front"


@pytest.mark.parametrize("room", STILL_INNER)
def test_the_list_of_exceptions_only_shrinks(room: str) -> None:
    inner = set(STILL_INNER[room].split())
    assert inner - {name for _, name in inner_uses(room)} == set(), "take these off the list"
    assert len(inner) <= MOST_INNER[room]
    assert len(front_of(room)) <= MOST_FRONT[room]
