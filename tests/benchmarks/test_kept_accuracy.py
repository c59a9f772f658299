import json

from benchmarks.kept_accuracy import KEPT, compared


def held(figures: dict[str, float], kept: dict[str, float]) -> list[bool]:
    return [check.holds for check in compared("a pair", figures, kept)]


def test_an_error_may_grow_by_a_tenth_and_points_fall_by_a_twentieth() -> None:
    kept = {"points": 1000.0, "rmse_px": 0.2}
    assert held({"points": 951.0, "rmse_px": 0.219}, kept) == [True, True]
    assert held({"points": 949.0, "rmse_px": 0.222}, kept) == [False, False]
    assert held({"points": 1500.0, "rmse_px": 0.01}, kept) == [True, True]


def test_what_was_not_measured_is_worse_than_any_kept_figure() -> None:
    assert held({"points": 0.0, "rmse_px": float("nan")}, {"points": 10.0, "rmse_px": 0.2}) == [False, False]


def test_a_pair_of_each_kind_is_kept() -> None:
    kinds = json.loads(KEPT.read_text())
    assert set(kinds) == {
        "synthetic, exact truth",
        "landsat_sub1, pointwise",
        "landsat_sub1",
        "uav_1, distance to epipolar lines",
    }
    assert all(each["points"] > 150 for each in kinds.values())
