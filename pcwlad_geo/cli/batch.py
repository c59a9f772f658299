"""``pcwlad-geo batch``: registration of many pairs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pcwlad_geo.cli import options as o
from pcwlad_geo.cli.job import UNEXPECTED, Ending, run_guarded, show_traceback
from pcwlad_geo.cli.options import collect
from pcwlad_geo.cli.outcome import table
from pcwlad_geo.errors import InputError, RegistrationRejectedError, RequirementError
from pcwlad_geo.events import EventCallback
from pcwlad_geo.options import Settings
from pcwlad_geo.text import visible

if TYPE_CHECKING:
    from pcwlad_geo.batches import BatchResult

STATUS_OF = {
    "failed": UNEXPECTED,
    "unusable": InputError.exit_status,
    "rejected": RegistrationRejectedError.exit_status,
    "not_passed": RequirementError.exit_status,
}
"""Exit status by status of a pair; the first one that any pair has applies."""

WORDS = {"not_passed": "of them against a requirement"}
"""Texts for statuses in the printed result that differ from their names."""

Pairs = Annotated[
    Path,
    typer.Argument(
        metavar="PAIRS.csv",
        help="Table, a line a pair: columns reference, target, out_dir and any option of register.",
        show_default=False,
    ),
]


@o.takes_settings("batch")
def batch(
    context: typer.Context,
    pairs: Pairs,
    out_dir: o.OutDir = None,
) -> None:
    """Register the pairs of a table one after another; pairs that an earlier run has finished are kept."""
    params = context.params
    folders: list[Path] = []  # output folders of the pairs, needed if the run is ended by force
    run_guarded(params, lambda on_event: _work(params, folders, on_event), lambda: _abandon(folders))


def _work(params: Mapping[str, Any], folders: list[Path], on_event: EventCallback) -> Ending:
    settings = collect(params, params["config"])
    Settings.from_options(settings)  # an invalid value is reported before the large libraries are loaded:
    from pcwlad_geo.batches import batch, batch_folder, read_pairs

    table_of_pairs, out_dir = params["pairs"], batch_folder(params["pairs"], params["out_dir"])
    folders += [pair.out_dir for pair in read_pairs(table_of_pairs, out_dir, settings)]
    result = batch(
        table_of_pairs,
        out_dir=out_dir,
        overwrite=params["overwrite"],
        on_event=on_event,
        **settings,
    )
    if params["debug"]:
        for outcome in result.pairs:
            if outcome.error is not None:
                show_traceback(outcome.error)
    return _ending(result)


def _abandon(folders: Sequence[Path]) -> None:
    from pcwlad_geo.outputs.folder import abandon

    for folder in folders:
        abandon(folder)


def _ending(result: BatchResult) -> Ending:
    rows = [outcome.row() for outcome in result.pairs]
    counts = {status: result.count(status) for status in ("registered", "rejected", "unusable", "failed")}
    counts["not_passed"] = sum(outcome.passed is False for outcome in result.pairs)
    summary = result.summary.absolute()
    status = next((STATUS_OF[each] for each in STATUS_OF if counts[each]), 0)
    figures = {**counts, "exit_status": status, "pairs": rows, "paths": {"summary": str(summary)}}
    counted = ", ".join(f"{count} {WORDS.get(each, each)}" for each, count in counts.items() if count)
    return Ending(figures, f"{table(rows)}\n{visible(counted)}\nsummary: {visible(str(summary))}\n", status)
