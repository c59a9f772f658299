"""The fronts of the rooms: the written lists of what code outside of a room uses of it."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
USERS = ("pcwlad_geo", "benchmarks", "docs", "fuzz", "qgis_plugin", "tests")
STILL_INNER = {
    "matching": """
        ChannelPair Core GUIDANCE Lost OTHER_WINDOWS_PX LARGE_WINDOWS_PX FIRST_WINDOW_PX OUTCOMES Prediction
        Predictor PreparedPair Surface TRAITS WINDOWS WindowErrors calibrate can_try_again cell_side_px
        choose_scales confirmed consistent consistent_points contradicted_clusters contrast_weight
        displacement_by_stripes displacement_by_surroundings displacement_by_windows expect_lost fast_even
        fill_smoothly global_affine in_rounds in_threads jitter_px margin_px matched_again narrow_gaps
        noise_level predict prepare refine to_index try_again window_sample

        GREY Noise PoseProposal POSE Rival SCALES SearchResult Tones evidence_against_chance
        mean_distance_px noise_of_samples of_whole_image poses_by_grey_values rivals_of rounding_of
        scene_epsilon search_pose without_speckle

        EPIPOLAR EpipolarGeometry epipolar_evidence largest_distance_px on_their_lines parallax_evidence
        plane_of plane_residual_px

        ChannelMaps InitialEstimate POINTER Refined WHOLE address function oriented_gradients
        spline_coefficients

        CoarseMatches NOISE ORIENTATIONS keypoints match_coarsely maximum_moment measure_noise
        oriented_phase_congruency
    """,
    "registration": """
        Editor GROUND INLINE MatchRecord SAME_PIXELS check_model check_placed correct_other_image
        corrected_rpc describe_motions displaced_otherwise grid_request ground_crs identify_inputs
        position_conflict MotionParameters

        JudgeParameters PairParameters ProofParameters SceneParameters fit_correction height_errors moves_of
        plan read_overviews set_up
    """,
}
"""Names of inner modules that code outside uses: for scenes and tiles, the initial alignment, perspective
images, rigs, reports, stacks, and tests and benchmarks of parts. The lists may only become shorter."""
MOST_INNER = {"matching": 87, "registration": 27}
MOST_FRONT = {"matching": 15, "registration": 35}
OF_THE_ROOM = {
    "matching": ("pcwlad_geo/matching", "tests/matching", "tests/oracles"),
    "registration": ("pcwlad_geo/registration", "tests/registration"),
}


def front_of(room: str) -> set[str]:
    tree = ast.parse((REPOSITORY / "pcwlad_geo" / room / "__init__.pyi").read_text(encoding="utf-8"))
    return {alias.name for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names}


def inner_uses(room: str) -> Iterator[tuple[str, str]]:
    """Yield the files outside of a room and the names that they import from its inner modules."""
    for path in (path for folder in USERS for path in (REPOSITORY / folder).rglob("*.py")):
        file, text = path.relative_to(REPOSITORY).as_posix(), path.read_text(encoding="utf-8")
        if file.startswith(OF_THE_ROOM[room]) or f"pcwlad_geo.{room}" not in text:
            continue
        for node in ast.walk(ast.parse(text)):
            module = (node.module or "") if isinstance(node, ast.ImportFrom) else ""
            names = {alias.name for alias in node.names} if isinstance(node, ast.ImportFrom) else set()
            if module == f"pcwlad_geo.{room}":
                names -= front_of(room)
            elif not module.startswith(f"pcwlad_geo.{room}."):
                continue
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
