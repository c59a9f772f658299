"""The numbers of a proof as they stand in proof.json."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timezone

from pcwlad_geo.correction.proof_result import Proof
from pcwlad_geo.registration import Registration
from pcwlad_geo.report.content import ProofNumbers
from pcwlad_geo.report.json_content import PX_DIGITS, SECONDS_DIGITS, filled, rounded, versions
from pcwlad_geo.report.summary import raster_entry, reference_entry


def proof_numbers(registration: Registration, proof: Proof, outputs: Sequence[str]) -> ProofNumbers:
    """Return the content of `proof.json`.

    The proof is of the pair of the `registration`; `outputs` are the names of the files in the folder.
    """
    return filled(
        ProofNumbers,
        registration,
        schema_version=1,
        kind="proof",
        created=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        reference=reference_entry(registration.reference),
        target=raster_entry(registration.target),
        proof=rounded(proof, PX_DIGITS),
        seconds=rounded(registration.seconds, SECONDS_DIGITS),
        versions=versions(),
        outputs=tuple(outputs),
    )
