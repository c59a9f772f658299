"""The report page: the verdict in words, the figures, the rendering by templates, and the page as PDF."""

from __future__ import annotations

import base64
import hashlib
import io
import shlex
from collections.abc import Mapping
from contextlib import redirect_stdout
from dataclasses import dataclass, field, fields
from functools import cache
from types import ModuleType
from typing import Final, Literal

import numpy as np
from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup
from numpy.typing import NDArray
from PIL import Image

from pcwlad_geo.correction.proof_result import LOCKING_PX, CorrectionEntry, Difficulty, LimitEntry, Proof
from pcwlad_geo.errors import SettingsError
from pcwlad_geo.raster.file_tree import file_name
from pcwlad_geo.raster.gdal import ignoring
from pcwlad_geo.registration import (
    FAIR_PX,
    GOOD_PX,
    Grade,
    QualityParameters,
    Registration,
    RegistrationStatus,
)
from pcwlad_geo.report import figures as draw
from pcwlad_geo.report.charts import data_uri
from pcwlad_geo.report.content import GroupStatistics, Report, raster_entry, reference_entry
from pcwlad_geo.report.statistics import PrecisionMap, heights_m, precision_of
from pcwlad_geo.report.views import PairView, checkered, pair_views, read_backdrop
from pcwlad_geo.text import plain

ENOUGH_CHECK_POINTS: Final = 30
"""Least number of check points of the ASPRS Positional Accuracy Standards (2023)."""
UNEVEN_RATIO: Final = 1.5
"""Ratio of net check-point to fit-point errors from which the model is doubtful between the fit points."""
NOISY_RATIO: Final = 0.3
"""Ratio of net CE90 to CE90 below which the matching noise explains most of the error."""
CAUTION_SHARE: Final = 0.2
"""Share of the image beyond the tie points, or without any, from which the page gives a caution."""

State = Literal["good", "caution", "bad"]
MARKS: Final[Mapping[State, str]] = {"good": "✓", "caution": "!", "bad": "✗"}
"""Signs of the states, independent of colour."""


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to one of the page's main questions."""

    question: str
    text: str
    state: State


@dataclass(frozen=True, slots=True)
class Headline:
    """The verdict at the top of the page."""

    text: str
    state: State


HEADLINES: Final[Mapping[Grade, Headline]] = {
    "good": Headline("Registered", "good"),
    "fair": Headline("Registered, with care", "caution"),
    "poor": Headline("Registered, poorly", "bad"),
}
"""Headlines by the grade of a registered pair."""


def headline(status: RegistrationStatus, grade: Grade | None, passed: bool | None = None) -> Headline:
    """Return the verdict by `status`, and for a registered pair by `grade`.

    `passed` is whether the requirements are met, None if there are none.
    """
    if status == "rejected":
        return Headline("Could not be registered reliably", "bad")
    if passed is False:
        return Headline(f"{status.capitalize()}, but a requirement is not met", "bad")
    if status == "matched":
        return Headline("Tie points matched", "good")
    return HEADLINES[grade or "fair"]


def answers(report: Report) -> list[Answer]:
    """Return the answers for a registered pair; none for others."""
    judged, before = report.statistics.judged, report.statistics.before["all"]
    if report.status != "registered" or judged is None or before is None:
        return []
    return [
        _accuracy_answer(report, judged, before.px.radial.ce90),
        _coverage_answer(report),
        _reliability_answer(report),
    ]


def _accuracy_answer(report: Report, judged: GroupStatistics, before: float) -> Answer:
    ce90, net = judged.px.radial.ce90, judged.px.net.ce90
    text = f"CE90 {_px(before)} before, {_px(ce90)} after the correction"
    if judged.m:
        text += f" ({judged.m.radial.ce90:.2f} m)"
    if net < NOISY_RATIO * ce90:
        text += "; nearly all of what is left is noise of the matching itself."
    else:
        text += f"; {_px(net)} of it once the noise of the matching is taken out."
    if report.quality:
        expected, whole = report.quality.expected_ce90_px, report.quality.whole_ce90_px
        ground = "common ground" if whole is None else "ground that was compared"
        text += f" 90 % of the {ground} is expected to lie within {_px(expected)}"
        text += "." if whole is None else f", and of all that both show within {_px(whole)}."
    state: State = "good" if ce90 <= GOOD_PX else "caution" if ce90 <= FAIR_PX else "bad"
    if ce90 >= before:
        state = "bad" if state == "bad" else "caution"
        text += " The correction improves nothing."
    return Answer("How well?", text, state)


def _coverage_answer(report: Report) -> Answer:
    empty_share = report.coverage.empty_share
    sigma = report.model and report.model.predicted_sigma_px
    extrapolated = sigma.extrapolated_share if sigma else 0.0
    parts = []
    if extrapolated > 0:
        parts.append(f"{percent(extrapolated)} of the target lies beyond the tie points (hatched below)")
    if empty_share > 0:
        parts.append(f"{percent(empty_share)} of the image has no tie point near (see Coverage)")
    if not parts:
        return Answer("Where not?", "Tie points cover the whole common area.", "good")
    text = "; ".join(parts) + "."
    return Answer(
        "Where not?",
        text[0].upper() + text[1:],
        "caution" if max(extrapolated, empty_share) > CAUTION_SHARE else "good",
    )


def _reliability_answer(report: Report) -> Answer:
    fit, check = report.statistics.after["fit"], report.statistics.after["check"]
    if check is None:
        return Answer(
            "Can I trust the figure?",
            "With care: there were too few points to keep some out of the fit.",
            "caution",
        )
    doubts = []
    if check.n < ENOUGH_CHECK_POINTS:
        doubts.append(f"only {check.n} check points, {ENOUGH_CHECK_POINTS} are asked for (ASPRS 2023)")
    if fit and check.px.net.ce90 > max(UNEVEN_RATIO * fit.px.radial.ce90, QualityParameters().noticeable_px):
        doubts.append(
            "check points are much worse than fit points: the model does not hold between its points"
        )
    if report.warnings:
        doubts.append("there are warnings below")
    if doubts:
        return Answer("Can I trust the figure?", "With care: " + "; ".join(doubts) + ".", "caution")
    text = f"Yes: it is counted at {check.n} check points that the fit has not seen."
    return Answer("Can I trust the figure?", text, "good")


def percent(share: float) -> str:
    """Return a share as a percentage in text."""
    return f"{100 * share:.0f} %" if share >= 0.005 else "less than 1 %"


def _px(value: float) -> str:
    return f"{value:.3f} px"


OPTIONAL: Final = ("residuals", "distribution", "trends", "profiles", "candidates", "sigma")
"""Names of the figures that not every page has."""


@dataclass(frozen=True, slots=True, eq=False)
class Drawings:
    """The parts of the page that are not in the report."""

    target_name: str
    reference_name: str
    figures: Mapping[str, str | None]
    """SVG by name; None for figures without data."""
    missing: list[tuple[draw.GapStyle, int]]
    """Kinds of squares without tie points, and their numbers."""
    views: list[PairView]
    warp_line: str | None
    """Shell command that warps the target by a thin-plate spline."""
    proved: Mapping[str, object] = field(default_factory=dict)
    """What the section on the tool's own error needs; empty without a proof."""


def report_page(report: Report, drawings: Drawings, *, paper: bool = False) -> str:
    """Return the page: the template reads the fields of `report` and `drawings` by their names.

    That on `paper` is for renderers without scripts and masks, such as PDF converters.
    """
    names = {each.name: getattr(part, each.name) for part in (report, drawings) for each in fields(part)}
    grade = report.quality.grade if report.quality else None
    verdict = headline(report.status, grade, report.passed)
    return page_template().render(
        {**names, **drawings.proved}, headline=verdict, answers=answers(report), paper=paper
    )


def compose(
    registration: Registration, report: Report, gcps_vrt: str | None, precision: PrecisionMap | None = None
) -> Drawings:
    """Draw the figures of the page.

    The files of the registration are read for small views, which are left out if that fails. `gcps_vrt` is
    the name of the VRT with the GCPs, for the gdalwarp line; None if none was written. The predicted sigma
    `precision` is given if it is already computed.
    """
    image = read_backdrop(registration.reference)
    return Drawings(
        target_name=file_name(registration.target.uri),
        reference_name=file_name(registration.reference.uri),
        figures=_figures(registration, report, precision or precision_of(registration), image),
        missing=draw.missing_kinds(report.coverage),
        views=pair_views(registration),
        warp_line=warp_line(gcps_vrt) if gcps_vrt else None,
        proved=proof_section(registration, registration.proof) if registration.proof else {},
    )


def warp_line(gcps_vrt: str) -> str:
    """Return the shell command that warps the target by a thin-plate spline through its tie points."""
    stem = gcps_vrt.removesuffix("_gcps.vrt")
    return shlex.join(["gdalwarp", "-tps", "-r", "lanczos", gcps_vrt, f"{stem}_tps.tif"])


def page_template() -> Template:
    """Return the template of the page, which takes a while the first time."""
    return page_environment("pcwlad_geo.report").get_template("report.html.j2")


@cache  # templates are compiled once per process
def page_environment(package: str) -> Environment:
    """Return the templates of a subpackage with the style, script and filters of this page."""
    environment = templates_of(package)
    environment.filters["figure"] = _figure
    environment.filters["percent"] = percent
    environment.filters["pair"] = _pair
    environment.filters["plain"] = plain
    environment.filters["svg"] = _svg
    environment.filters["jpeg"] = _jpeg
    environment.globals |= {
        "style": _source(environment, "style.css"),
        "checkered": checkered,
        "marks": MARKS,
        **page_script(environment, "slider.js"),
    }
    return environment


def page_script(environment: Environment, name: str) -> dict[str, str]:
    """Return the script of a page, and the hash by which the page allows it to run."""
    script = _source(environment, name)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    return {"script": script, "script_hash": f"sha256-{digest}"}


def _source(environment: Environment, name: str) -> Markup:
    """Return one of the page's own files, which is not escaped."""
    if environment.loader is None:
        raise TypeError("templates have no loader")
    return Markup(environment.loader.get_source(environment, name)[0])


def _figures(
    registration: Registration,
    report: Report,
    precision: PrecisionMap | None,
    image: NDArray[np.uint8] | None,
) -> dict[str, str | None]:
    """Return the figures as SVG by name; None for figures without data."""
    table, shape = registration.tie_points, registration.reference.grid.shape
    judged = report.statistics.judged
    figures: dict[str, str | None] = dict.fromkeys(OPTIONAL)
    figures["displacements"] = draw.displacement_figure(table, shape, image)
    figures["coverage"] = draw.coverage_figure(report.coverage, shape, image)
    if judged:
        figures["residuals"] = draw.residual_figure(table, shape, image)
        figures["distribution"] = draw.distribution_figure(table, judged.px.radial.ce90)
        points = table.select("fit", "check")
        heights = heights_m(registration, points.predicted_px)
        figures["trends"] = draw.trend_figure(points, registration.target.grid.shape, heights)
    if report.profiles and any(part.place for part in report.profiles.parts):
        figures["profiles"] = draw.profile_figure(report.profiles)
    candidates = [
        each for each in (report.model.candidates if report.model else ()) if each.rmse_px is not None
    ]
    if len(candidates) > 1:
        figures["candidates"] = draw.candidate_figure(candidates)
    if precision is not None:
        figures["sigma"] = draw.sigma_figure(precision, table.select("fit").predicted_px)
    return figures


def _svg(text: str) -> str:
    return data_uri("image/svg+xml", text.encode())


def _jpeg(image: NDArray[np.uint8]) -> str:
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "jpeg", quality=82)
    return data_uri("image/jpeg", buffer.getvalue())


def _figure(value: object, digits: int = 3) -> str:
    """Return a number with a true minus sign; a dash for None."""
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.{digits}f}".replace("-", "−")
    return str(value)


def _pair(statistics: object, name: str, digits: int = 3) -> str:
    if statistics is None:
        return "–"
    return ", ".join(_figure(float(value), digits) for value in getattr(statistics, name))


def templates_of(package: str) -> Environment:
    """Return the templates of a subpackage and what pages share; undefined names in them raise errors."""
    return Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader("pcwlad_geo.report")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def check_pdf() -> None:
    """Check, before the work, that PDF files can be made.

    Raises `SettingsError` if WeasyPrint or Pango is missing, or WeasyPrint is too old.
    """
    _weasyprint()


def to_pdf(page: str) -> bytes:
    """Return an HTML page as PDF. Nothing outside the page is read.

    Raises `SettingsError` if WeasyPrint or Pango is missing, or WeasyPrint is too old. The `page` has its
    images embedded.
    """
    weasyprint = _weasyprint()
    only_inside = weasyprint.urls.URLFetcher(allowed_protocols=["data"])
    document = weasyprint.HTML(string=page, url_fetcher=only_inside).write_pdf()
    return bytes(document)


def _weasyprint() -> ModuleType:
    try:
        # it prints advice if Pango is missing, and deprecation warnings
        with redirect_stdout(io.StringIO()), ignoring(DeprecationWarning):
            import weasyprint
    except ImportError as error:
        raise SettingsError(
            f"pdf = true needs WeasyPrint: pip install 'pcwlad-geo[pdf]', or leave it out ({error})"
        ) from error
    except OSError as error:  # one of the libraries that it loads
        raise SettingsError(
            "pdf = true: WeasyPrint finds no Pango: install it (Debian, Ubuntu: apt install libpango-1.0-0 "
            "libpangoft2-1.0-0 libharfbuzz-subset0; Fedora: dnf install pango; macOS: brew install pango; "
            f"conda install pango), or leave it out ({error})"
        ) from error
    module: ModuleType = weasyprint
    if not hasattr(module.urls, "URLFetcher"):
        raise SettingsError(
            f"pdf = true needs WeasyPrint 68 or newer, and {module.__version__} is installed: "
            "pip install 'pcwlad-geo[pdf]', or leave it out"
        )
    return module


SIGMA_HOLDS: Final = 0.6
"""Least share of errors within one sigma at which sigmas count as holding."""
FALSE_SHARE: Final = 0.002
"""Share of false matches up to which none to speak of get through."""


def observability_sentence(proof: Proof) -> str:
    """Return the sentence that tells which errors the proof observes, and which none can."""
    unobservable = proof.unobservable
    return (
        "Observed, by moving the target: pixel locking, interpolation and noise, which these figures are of. "
        "Not observable: structure that lies elsewhere in the other band; halves of the evidence differ by "
        f"{unobservable.at_least_px:.3f} px or more in it (a lower bound, not the error), and up to "
        f"{unobservable.up_to_px:.2f} px have to be allowed for unless a third band closes a triangle."
    )


def proof_answers(proof: Proof) -> list[Answer]:
    """Return the answers to the questions at the top of the section."""
    locking, sigma = max(proof.locking_px), proof.sigma
    text = f"{100 * sigma.within_68:.0f} % of the errors lie within sigma (68 is right)"
    if sigma.within_68 < SIGMA_HOLDS:
        text += f": they would have to be {sigma.factor:.1f} times as large."
    else:
        text += ", which leaves room for what is not observable." if sigma.factor < 1 else "."
    false_share = proof.false_matches / max(proof.false_matches + proof.matches, 1)
    correction = proof.correction
    error = f"90 % of the points lie within {proof.ce90_px:.3f} px"
    error += f", 90 % of the correction within {correction.ce90_px:.3f} px." if correction else "."
    return [
        Answer("How large is its own error?", error, _state(proof.ce90_px, GOOD_PX, FAIR_PX)),
        Answer(
            "Does it lock to whole pixels?",
            f"By {locking:.3f} px, beside a scatter of {max(proof.scatter_px):.3f} px.",
            _state(locking, LOCKING_PX, 5 * LOCKING_PX),
        ),
        Answer("Do the sigmas hold?", text, "good" if sigma.within_68 >= SIGMA_HOLDS else "caution"),
        Answer(
            "Do wrong matches get through?",
            f"{proof.false_matches} of {proof.false_matches + proof.matches}, with every test passed.",
            _state(false_share, FALSE_SHARE, 10 * FALSE_SHARE),
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


LIMIT_TEXTS: Final[dict[Difficulty, str]] = {
    "displacement": "a displacement of {:.0f} px",
    "rotation": "a rotation of {:.3g} degrees",
    "noise": "fresh noise of {:.2g} times the standard deviation of the images",
    "clouds": "clouds over a share of {:.2g} of the target",
}
"""What is tolerated, with its level."""


def tolerated_text(limit: LimitEntry) -> str:
    """Return how much of a difficulty a pair tolerates, in words."""
    if limit.tolerated is None:
        return f"not even {LIMIT_TEXTS[limit.name].format(limit.failed)}"
    return LIMIT_TEXTS[limit.name].format(limit.tolerated) + (" or more" if limit.failed is None else "")


def _answers_of_trials(proof: Proof) -> list[Answer]:
    """Return what a full proof answers beside: what the pair tolerates, and whether both directions agree."""
    found = proof.sensitivity
    if found is None:
        return []
    incorrect = sum(each.outcome == "incorrect" for limit in found.limits for each in limit.trials)
    said = [tolerated_text(limit) for limit in found.limits]
    if incorrect:
        said.append(f"{incorrect} results beyond were accepted, and wrong")
    elif any(limit.failed is not None for limit in found.limits):
        said.append("beyond, it was refused")
    answers = [
        Answer("What does it tolerate?", "; ".join(said).capitalize() + ".", "bad" if incorrect else "good")
    ]
    back = found.reversal
    if back is not None:
        text = f"Points return to {back.rms_px:.3f} px (RMS) from where they began."
        answers.append(Answer("Do both directions agree?", text, _state(back.rms_px, GOOD_PX, FAIR_PX)))
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
            "errors": draw.errors_figure(proof),
            "places": draw.places_figure(proof, reference.grid.shape, read_backdrop(reference)),
            "trials": draw.trials_figure(proof.sensitivity) if proof.sensitivity else None,
        },
    }
