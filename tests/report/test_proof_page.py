"""proof.json is as its schema says, and the page tells what is seen from what is not."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import jsonschema
import pytest

from pcwlad_geo.cli.prove import proof_text
from pcwlad_geo.correction.proof_result import (
    ClassEntry,
    CorrectionEntry,
    EvidenceEntry,
    LimitEntry,
    PhaseEntry,
    PointEntry,
    Proof,
    Reversal,
    Sensitivity,
    SigmaEntry,
    TrialEntry,
    UnobservableError,
)
from pcwlad_geo.registration.proof.resampling import moves_of
from pcwlad_geo.report.json_content import to_json
from pcwlad_geo.report.proof_numbers import proof_numbers
from pcwlad_geo.report.proof_page import proof_page
from tests.registrations import make_registration

SCHEMA = Path(__file__).resolve().parents[2] / "docs" / "proof.schema.json"
KIND = ClassEntry("shift", 16, (0.001, -0.002), (0.012, 0.011))
PROOF = Proof(
    effort="quick",
    moves=moves_of("quick", 81),
    points=2,
    matches=16,
    lost=0,
    false_matches=1,
    noise=(1.5, float("nan")),
    resampling_px=1e-5,
    bias_px=(0.012, -0.003),
    bias_error_px=(0.002, 0.002),
    scatter_px=(0.021, 0.019),
    shrunk=1.0,
    rmse_px=0.03,
    ce90_px=0.045,
    locking_px=(0.018, 0.002),
    locking_error_px=(0.003, 0.003),
    phases=tuple(PhaseEntry((n + 0.5) / 8, (2, 2), (0.01, 0.0)) for n in range(8)),
    moved=(KIND,),
    texture=(KIND,),
    windows=(),
    sigma=SigmaEntry(0.41, 0.7, 2.04, 2.04),
    correction=CorrectionEntry("shift", (0.012, -0.003), 0.012, 0.02, None),
    unobservable=UnobservableError(
        (EvidenceEntry("channels", 2, (0.04, 0.0), (0.01, 0.01), (0.0, 0.0)),), 0.01, 0.1
    ),
    map=tuple(PointEntry(n, (100.0 * n + 50, 80.0), ((0.01, 0.02), (-0.01, 0.0))) for n in range(2)),
)


RIGHT, REFUSED = TrialEntry(0.5, "correct", 80, 0.02), TrialEntry(0.71, "refused", 0, None)
TOLERATES = Sensitivity(
    (512, 400),
    100,
    (
        LimitEntry("displacement", "px", 181.02, None, (replace(RIGHT, level=181.02),)),
        LimitEntry("noise", "share of the standard deviation", 0.5, 0.71, (RIGHT, REFUSED)),
        LimitEntry("clouds", "share of the pixels", None, 0.06, (replace(REFUSED, level=0.06),)),
    ),
    Reversal("affine", "shift", (0.01, -0.02), 0.034),
)


def test_proof_json_is_as_its_schema_says() -> None:
    numbers = json.loads(to_json(proof_numbers(make_registration(), PROOF, ["proof.json"])))
    full = json.loads(
        to_json(proof_numbers(make_registration(), replace(PROOF, sensitivity=TOLERATES), ["proof.json"]))
    )
    checked = jsonschema.Draft202012Validator(json.loads(SCHEMA.read_text(encoding="utf-8")))
    checked.validate(numbers | {"noise": [1.5, 1.5]})
    checked.validate(full | {"noise": [1.5, 1.5]})
    assert numbers["sensitivity"] is None
    assert full["sensitivity"]["limits"][0]["failed"] is None
    assert numbers["noise"] == [1.5, None]
    with pytest.raises(jsonschema.ValidationError):
        checked.validate({**numbers, "noise": [1.5, 1.5], "effort": "lazy"})


def words(page: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<[^>]*>", " ", page))


def test_the_page_tells_the_error_and_what_no_image_tells() -> None:
    text = words(proof_page(make_registration(), PROOF))
    assert "On this pair the matching itself errs by 0.045 px" in text
    assert "fraction of a pixel by 0.018 px" in text
    assert "1 of 17 passed every test" in text
    assert "0.010 px or more, which is a lower bound" in text
    assert "allow up to 0.10 px for them" in text


@pytest.mark.parametrize(
    ("sigma", "says"),
    [
        (
            SigmaEntry(0.41, 0.7, 2.04, 2.04),
            "41 % of the errors lie within sigma (68 is right): they would have",
        ),
        (SigmaEntry(1.0, 1.0, 0.2, 1.0), "leaves room for errors that no proof shows"),
    ],
)
def test_sigmas_are_called_too_small_but_never_too_large(sigma: SigmaEntry, says: str) -> None:
    assert says in words(proof_page(make_registration(), replace(PROOF, sigma=sigma)))


def test_what_is_printed_has_the_figures() -> None:
    text = proof_text(PROOF)
    assert "bias                      +0.0120  -0.0030" in text
    assert "CE90 0.0450 px" in text
    assert "1 of 17" in text
    without = proof_text(replace(PROOF, correction=None))
    assert "correction" not in without


def test_the_page_tells_what_the_pair_tolerates_and_whether_it_returns() -> None:
    page = proof_page(make_registration(), replace(PROOF, sensitivity=TOLERATES))
    assert (
        "A displacement of 181 px or more; fresh noise of 0.5 times the standard deviation of the images; "
        "not even clouds over a share of 0.06 of the target; beyond, it was refused." in words(page)
    )
    assert "Points return to 0.034 px (RMS)" in words(page)
    assert page.count("<img") == proof_page(make_registration(), PROOF).count("<img") + 1
    assert "What does it tolerate?" not in words(proof_page(make_registration(), PROOF))


def test_a_wrong_result_that_was_accepted_is_told() -> None:
    wrong = replace(REFUSED, outcome="incorrect", points=40, error_px=12.0)
    limit = replace(TOLERATES.limits[1], trials=(RIGHT, wrong))
    page = words(
        proof_page(make_registration(), replace(PROOF, sensitivity=replace(TOLERATES, limits=(limit,))))
    )
    assert "1 results beyond were accepted, and wrong" in page
    assert "beyond, it was refused" not in page


def test_what_a_blind_spot_costs_is_told_where_it_was_asked() -> None:
    assert "blind spot" not in words(proof_page(make_registration(), PROOF))
    told = replace(PROOF, correction=CorrectionEntry("tps", (0.0, 0.0), 0.01, 0.02, 0.31))
    page = words(proof_page(make_registration(), told))
    assert "What would a blind spot cost?" in page
    assert "0.310 px" in page


def test_nothing_is_called_refused_where_all_was_tolerated() -> None:
    limits = tuple(replace(each, tolerated=0.5, failed=None, trials=(RIGHT,)) for each in TOLERATES.limits)
    page = words(
        proof_page(make_registration(), replace(PROOF, sensitivity=replace(TOLERATES, limits=limits)))
    )
    assert "What does it tolerate?" in page
    assert "beyond, it was refused" not in page


def test_what_is_printed_of_a_full_proof_has_what_it_tolerates() -> None:
    text = proof_text(replace(PROOF, sensitivity=TOLERATES))
    assert "tolerates a displacement of 181 px or more; fresh noise of 0.5" in text
    assert "both directions: RMS 0.0340 px, bias +0.0100, -0.0200 px" in text
