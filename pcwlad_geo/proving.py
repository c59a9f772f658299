"""The job that measures the tool's own error on a pair, and writes it."""

from __future__ import annotations

import warnings
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Final, get_args

from rasterio.errors import NotGeoreferencedWarning

from pcwlad_geo.arguments import checked, fits, shown
from pcwlad_geo.basemaps.services import is_service
from pcwlad_geo.correction import Effort
from pcwlad_geo.errors import SettingsError
from pcwlad_geo.events import EventCallback, ignore
from pcwlad_geo.execution.runner import Runner
from pcwlad_geo.options import Settings
from pcwlad_geo.outputs.folder import OutputFolder
from pcwlad_geo.products.unpacking import unpacked
from pcwlad_geo.raster import check_unchanged, trusting
from pcwlad_geo.raster.scratch import file_of
from pcwlad_geo.types import PathLike

if TYPE_CHECKING:
    from rasterio.io import DatasetReader
    from typing_extensions import Unpack

    from pcwlad_geo.correction.proof_result import Proof
    from pcwlad_geo.options import Options

from pcwlad_geo.job import open_job_runner
from pcwlad_geo.pair_job import output_folder

PROOF_NAMES: Final = {"numbers": "proof.json", "report": "proof.html"}
"""File names of a proof."""
BASEMAP: Final = "basemap.tif"
"""File name of what is fetched of a web map."""


@checked("reference", "target", "effort")
def prove(
    reference: PathLike | DatasetReader,
    target: PathLike | DatasetReader,
    *,
    effort: Effort = "quick",
    out_dir: PathLike | None = None,
    overwrite: bool = False,
    on_event: EventCallback = ignore,
    executor: Executor | Runner | None = None,
    **options: Unpack[Options],
) -> Proof:
    """Measure the tool's own error on a pair, and write `proof.json` and `proof.html`.

    The target is moved by known amounts, by a resampling that adds no bias of its own, with fresh noise of
    the level of each image, and matched again at tie points of the pair. Structure that lies elsewhere in the
    other band cannot be seen by this.

    Parameters
    ----------
    reference, target : path or rasterio dataset
        As for `register`; the reference may be a web map.
    effort : {"quick", "full"}
        quick: a sample of the points; full: more points and moves, and how much a part of the pair tolerates.
    out_dir : path, optional
        Output folder; ``<target stem>_proof`` in the working folder by default.
    overwrite : bool
        Replace the results of an earlier run in `out_dir`.
    on_event : callable
        Receives `Progress` and `Warned` events; an exception that it raises ends the job.
    executor : concurrent.futures.Executor or Runner, optional
        Runs the tiles of the matching; None = `jobs` processes, or the workers of `scheduler`.
    **options
        The fields of `Settings` that concern the matching, and `model`.

    Returns
    -------
    Proof
        Errors in target px (col, row).

    Raises
    ------
    InputError
        If a raster or an option cannot be used, or too few tie points are matched; nothing is written.
    OutputError
        If the results cannot be written.
    ExecutionError
        If what the matching runs on cannot be used or is lost.
    RegistrationRejectedError
        If the pair cannot be matched reliably; nothing is written.
    """
    names, settings = (file_of(reference), file_of(target)), Settings.from_options(options)
    if not fits(effort, Effort):
        raise SettingsError(f"effort = {shown(effort)}: give one of {', '.join(get_args(Effort))}")
    place = OutputFolder(
        output_folder(names[1], "proof", out_dir),
        overwrite=overwrite,
        results=PROOF_NAMES["numbers"],
        inputs=[*names, *settings.files],
    )
    with (
        warnings.catch_warnings(),
        trusting(settings.trust),
        unpacked(names, place.out_dir, overwrite=overwrite) as (reference, target),
        place as folder,
    ):
        names = (reference, target)
        warnings.simplefilter("ignore", NotGeoreferencedWarning)  # of tiles; before there are threads
        from pcwlad_geo.registration import prove_pair, resolve  # slow to load
        from pcwlad_geo.report.json_content import to_json
        from pcwlad_geo.report.proof_numbers import proof_numbers
        from pcwlad_geo.report.proof_page import proof_page

        read, files = names, sorted(PROOF_NAMES.values())
        if is_service(names[0]):
            from pcwlad_geo.basemaps.fetching import fetch

            read, files = (str(folder.path(BASEMAP)), names[1]), sorted([BASEMAP, *files])
            settings = fetch(names[0], resolve(*names, settings), Path(read[0]), on_event)
        with open_job_runner(settings, executor, on_event) as runner:
            registration, proof = prove_pair(*read, settings, effort, on_event=on_event, runner=runner)
        named = registration if read == names else registration.fetched_to(folder.final_path(BASEMAP))
        with folder.writing():
            content = proof_numbers(named, proof, files)
            texts = {"report": proof_page(registration, proof), "numbers": to_json(content)}
            for kind, text in texts.items():
                folder.path(PROOF_NAMES[kind]).write_text(text, encoding="utf-8", newline="")
        check_unchanged(file.identity for file in registration.inputs)
        folder.commit()
    return proof
