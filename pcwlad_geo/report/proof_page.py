"""The page of a proof, and its section on the page of a pair: answers, figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from pcwlad_geo.correction.proof_result import LOCKING_PX, CorrectionEntry, Difficulty, LimitEntry, Proof
from pcwlad_geo.raster import file_name
from pcwlad_geo.registration import FAIR_PX, GOOD_PX, Registration
from pcwlad_geo.report.answers import Answer, State
from pcwlad_geo.report.page_templates import page_environment
from pcwlad_geo.report.proof_figures import errors_figure, places_figure, trials_figure
from pcwlad_geo.report.summary import raster_entry, reference_entry
from pcwlad_geo.report.views import read_backdrop


@dataclass(frozen=True, slots=True)
class ProofAnswerParameters:
    """Thresholds of the words about a proof."""

    least_within_sigma: float = 0.6
    """Least share of errors within one sigma at which sigmas count as holding."""
    most_false_share: float = 0.002
    """Share of false matches up to which none to speak of get through."""


LIMIT_TEXTS: Final[dict[Difficulty, str]] = {
    "displacement": "a displacement of {:.0f} px",
    "rotation": "a rotation of {:.3g} degrees",
    "noise": "fresh noise of {:.2g} times the standard deviation of the images",
    "clouds": "clouds over a share of {:.2g} of the target",
}
"""What is tolerated, with its level."""
PROOF_ANSWERS: Final = ProofAnswerParameters()
"""As pages are written."""


def observability_sentence(proof: Proof) -> str:
    """Return the sentence that tells which errors the proof observes, and which none can."""
    unobservable = proof.unobservable
    return (
        "These figures show pixel locking, interpolation and noise. They do not show edges that lie "
        "elsewhere in the other band, such as shadows: allow up to "
        f"{unobservable.up_to_px:.2f} px for them. Halves of the evidence differ by "
        f"{unobservable.at_least_px:.3f} px or more, which is a lower bound. A third band shows more: the "
        "triangle of the three must close."
    )


def proof_answers(proof: Proof, parameters: ProofAnswerParameters = PROOF_ANSWERS) -> list[Answer]:
    """Return the answers to the questions at the top of the section."""
    locking, sigma = max(proof.locking_px), proof.sigma
    text = f"{100 * sigma.within_68:.0f} % of the errors lie within sigma (68 is right)"
    if sigma.within_68 < parameters.least_within_sigma:
        text += f": they would have to be {sigma.factor:.1f} times as large."
    else:
        text += ", which leaves room for errors that no proof shows." if sigma.factor < 1 else "."
    false_share = proof.false_matches / max(proof.false_matches + proof.matches, 1)
    correction = proof.correction
    error = f"90 % of the points lie within {proof.ce90_px:.3f} px"
    error += f", 90 % of the correction within {correction.ce90_px:.3f} px." if correction else "."
    return [
        Answer("How large is its own error?", error, _state(proof.ce90_px, GOOD_PX, FAIR_PX)),
        Answer(
            "Does it lock to whole pixels?",
            f"Its errors follow the fraction of a pixel by {locking:.3f} px, and scatter by "
            f"{max(proof.scatter_px):.3f} px.",
            _state(locking, LOCKING_PX, 5 * LOCKING_PX),
        ),
        Answer(
            "Do the sigmas hold?",
            text,
            "good" if sigma.within_68 >= parameters.least_within_sigma else "caution",
        ),
        Answer(
            "Do wrong matches get through?",
            f"{proof.false_matches} of {proof.false_matches + proof.matches} passed every test.",
            _state(false_share, parameters.most_false_share, 10 * parameters.most_false_share),
        ),
        *_answer_of_blind_spot(correction),
        *_answers_of_trials(proof),
    ]


def _answer_of_blind_spot(correction: CorrectionEntry | None) -> list[Answer]:
    """Return what a part without tie points would cost, where that was measured."""
    if correction is None or correction.blind_spot_px is None:
        return []
    text = (
        f"Without the tie points of a ninth of the scene the {correction.model} there would change by up to "
    )
    cost_px = correction.blind_spot_px
    state = _state(cost_px, GOOD_PX, FAIR_PX)
    return [Answer("What would a blind spot cost?", f"{text}{cost_px:.3f} px (RMS).", state)]


def tolerated_text(limit: LimitEntry) -> str:
    """Return how much of a difficulty a pair tolerates, in words."""
    if limit.tolerated is None:
        return f"not even {LIMIT_TEXTS[limit.name].format(limit.failed)}"
    return LIMIT_TEXTS[limit.name].format(limit.tolerated) + (" or more" if limit.failed is None else "")


def _answers_of_trials(proof: Proof) -> list[Answer]:
    """Return what a full proof answers beside: what the pair tolerates, and whether both directions agree."""
    sensitivity = proof.sensitivity
    if sensitivity is None:
        return []
    incorrect = sum(trial.outcome == "incorrect" for limit in sensitivity.limits for trial in limit.trials)
    said = [tolerated_text(limit) for limit in sensitivity.limits]
    if incorrect:
        said.append(f"{incorrect} results beyond were accepted, and wrong")
    elif any(limit.failed is not None for limit in sensitivity.limits):
        said.append("beyond, it was refused")
    answers = [
        Answer("What does it tolerate?", "; ".join(said).capitalize() + ".", "bad" if incorrect else "good")
    ]
    reversal = sensitivity.reversal
    if reversal is not None:
        text = f"Points return to {reversal.rms_px:.3f} px (RMS) from where they began."
        answers.append(Answer("Do both directions agree?", text, _state(reversal.rms_px, GOOD_PX, FAIR_PX)))
    return answers


def _state(value: float, good: float, fair: float) -> State:
    return "good" if value <= good else "caution" if value <= fair else "bad"


def proof_page(registration: Registration, proof: Proof) -> str:
    """Return the text of `proof.html`."""
    template = page_environment("pcwlad_geo.report").get_template("prove.html.j2")
    return template.render(
        **proof_section(registration, proof),
        target=raster_entry(registration.target),
        reference=reference_entry(registration.reference),
        target_name=file_name(registration.target.uri),
        reference_name=file_name(registration.reference.uri),
    )


def proof_section(registration: Registration, proof: Proof) -> dict[str, object]:
    """Return what the template of the section needs."""
    reference = registration.reference
    return {
        "proof": proof,
        "proof_answers": proof_answers(proof),
        "proof_sentence": observability_sentence(proof),
        "proof_figures": {
            "errors": errors_figure(proof),
            "places": places_figure(proof, reference.grid.shape, read_backdrop(reference)),
            "trials": trials_figure(proof.sensitivity) if proof.sensitivity else None,
        },
    }
