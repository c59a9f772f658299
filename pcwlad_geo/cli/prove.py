"""The work of ``prove``, and the summary that it prints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from pcwlad_geo.cli.options import checked_options
from pcwlad_geo.cli.running import Ending
from pcwlad_geo.cli.tables import columns
from pcwlad_geo.events import EventCallback
from pcwlad_geo.text import check_exists, visible

if TYPE_CHECKING:
    from pcwlad_geo.correction.proof_result import Proof


def proof_text(proof: Proof) -> str:
    """Return what is printed of a proof, without the place of its files."""
    bias, scatter, locking = (
        [f"{value:+.4f}" if name == "bias" else f"{value:.4f}" for value in values]
        for name, values in (
            ("bias", proof.bias_px),
            ("scatter", proof.scatter_px),
            ("locking", proof.locking_px),
        )
    )
    rows = [
        ("", "column", "row"),
        ("bias", *bias),
        ("scatter", *scatter),
        ("pixel locking, amplitude", *locking),
    ]
    lines = [
        f"the tool's own error, target px: {proof.points} tie points matched again after {len(proof.moves)} "
        "known moves of the target",
        *columns(rows, (0,)),
        f"points: RMSE {proof.rmse_px:.4f} px, CE90 {proof.ce90_px:.4f} px",
    ]
    if proof.correction is not None:
        fit = proof.correction
        lines.append(f"correction ({fit.model}): RMSE {fit.rmse_px:.4f} px, CE90 {fit.ce90_px:.4f} px")
    lines += [
        f"within sigma {100 * proof.sigma.within_68:.0f} % (68 is right), within 1.96 sigma "
        f"{100 * proof.sigma.within_95:.0f} % (95); right sigmas are {proof.sigma.factor:.2f} times as large",
        f"wrong matches that passed every test: {proof.false_matches} of "
        f"{proof.matches + proof.false_matches}; lost: {proof.lost}",
    ]
    if proof.sensitivity is not None:
        from pcwlad_geo.report.proof_page import tolerated_text

        lines.append("tolerates " + "; ".join(map(tolerated_text, proof.sensitivity.limits)))
        if (reversal := proof.sensitivity.reversal) is not None:
            col, row = reversal.bias_px
            lines.append(f"both directions: RMS {reversal.rms_px:.4f} px, bias {col:+.4f}, {row:+.4f} px")
    return "\n".join(lines) + "\n"


def prove_pair(params: Mapping[str, Any], on_event: EventCallback) -> Ending:
    """Prove a pair with the parameters of the command."""
    settings = checked_options(params)
    for name in (params["reference"], params["target"]):
        check_exists(name)
    from pcwlad_geo.pair_job import output_folder
    from pcwlad_geo.proving import PROOF_NAMES, prove

    proof = prove(
        params["reference"],
        params["target"],
        effort=params["effort"],
        out_dir=params["out_dir"],
        overwrite=params["overwrite"],
        on_event=on_event,
        **settings,
    )
    folder = output_folder(params["target"], "proof", params["out_dir"])
    figures: dict[str, object] = {
        **{
            name: getattr(proof, name)
            for name in ("bias_px", "scatter_px", "rmse_px", "ce90_px", "false_matches")
        },
        "paths": {kind: str((folder / name).absolute()) for kind, name in PROOF_NAMES.items()},
    }
    text = f"{proof_text(proof)}report: {folder / PROOF_NAMES['report']}\n"
    return Ending(figures, visible(text))
