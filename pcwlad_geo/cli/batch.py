"""``pcwlad-geo batch``: the pairs of a table, and the table of their results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from pcwlad_geo.cli import options as o
from pcwlad_geo.cli.options import checked_options
from pcwlad_geo.cli.running import UNEXPECTED, Ending, run_guarded, show_traceback
from pcwlad_geo.cli.tables import table
from pcwlad_geo.errors import InputError, RegistrationRejectedError, RequirementError
from pcwlad_geo.events import EventCallback
from pcwlad_geo.text import visible

if TYPE_CHECKING:
    from pcwlad_geo.multi.batch.run import BatchResult


STATUS_OF = {
    "failed": UNEXPECTED,
    "unusable": InputError.exit_status,
    "rejected": RegistrationRejectedError.exit_status,
    "not_passed": RequirementError.exit_status,
}
"""Exit status by status of a pair; the first one that any pair has applies."""
STATUS_TEXTS = {"not_passed": "of them against a requirement"}
"""Texts for statuses in the printed result that differ from their names."""
BATCH_COLUMNS: Final = ("target", "status", "points", "RMSE px", "shift px", "folder or reason")
"""Columns of the printed table of pairs."""
NUMERIC_COLUMNS: Final = ("points", "RMSE px", "shift px")
"""Those with numbers, aligned on the right."""

FLIGHT_OPTIONS: Final = ("reference", "photos", "name_column", "within", "photo_size")
"""Options of a flight index."""

PairTable = Annotated[
    Path,
    o.argument(
        "PAIRS.csv",
        "Table, a line a pair: columns reference, target, out_dir and any option of register. With "
        "--reference the index of a flight: points or footprints with a column of file names.",
    ),
]
Reference = Annotated[
    Path | None,
    o.option(
        "--reference",
        help="Look for each photograph of a flight index around its place on this raster.",
        metavar="FILE",
    ),
]
Photos = Annotated[
    Path | None,
    o.option("--photos", help="Folder of the photographs.  [default: that of the index]", metavar="FOLDER"),
]
NameColumn = Annotated[
    str | None,
    o.option("--name-column", help="Column of their file names.  [default: the one that has them]"),
]
Within = Annotated[
    float,
    o.option("--within", help="How far they may lie from where the index says.  [default: 300]", metavar="M"),
]
PhotoSize = Annotated[
    float | None,
    o.option(
        "--photo-size",
        help="Longer side of a photograph on the ground, for an index of points.",
        metavar="M",
    ),
]


@o.takes_settings("batch")
def batch(
    context: typer.Context,
    pairs: PairTable,
    out_dir: o.OutDir = None,
    reference: Reference = None,
    photos: Photos = None,
    name_column: NameColumn = None,
    within: Within = 300.0,
    photo_size: PhotoSize = None,
) -> None:
    """Register the pairs of a table, or old photographs; what an earlier run has finished is kept."""
    params = context.params
    folders: list[Path] = []  # output folders of the pairs, needed if the run is ended by force
    run_guarded(params, lambda on_event: _batch(params, folders, on_event), lambda: _abandon_pairs(folders))


def _batch(params: Mapping[str, Any], folders: list[Path], on_event: EventCallback) -> Ending:
    settings = checked_options(params)
    from pcwlad_geo.multi.batch.run import batch, batch_folder
    from pcwlad_geo.multi.batch.table import read_pairs

    table_of_pairs, out_dir = params["pairs"], batch_folder(params["pairs"], params["out_dir"])
    flight = {name: params[name] for name in FLIGHT_OPTIONS}
    if flight["reference"] is None:
        folders += [pair.out_dir for pair in read_pairs(table_of_pairs, out_dir, settings)]
    result = batch(
        table_of_pairs,
        out_dir=out_dir,
        overwrite=params["overwrite"],
        on_event=on_event,
        **flight,
        **settings,
    )
    if params["debug"]:
        for outcome in result.pairs:
            if outcome.error is not None:
                show_traceback(outcome.error)
    return _batch_ending(result)


def _abandon_pairs(folders: Sequence[Path]) -> None:
    from pcwlad_geo.outputs.folder import abandon

    for folder in folders:
        abandon(folder)


def _batch_ending(result: BatchResult) -> Ending:
    rows = [outcome.row() for outcome in result.pairs]
    text = pair_table(rows)
    counts = {status: result.count(status) for status in ("registered", "rejected", "unusable", "failed")}
    counts["not_passed"] = sum(outcome.passed is False for outcome in result.pairs)
    summary = result.summary.absolute()
    status = next((STATUS_OF[name] for name in STATUS_OF if counts[name]), 0)
    paths = {"summary": str(summary)}
    if result.to_place is not None:
        paths["to_place"] = str(result.to_place.absolute())
    figures = {**counts, "pairs": rows, "paths": paths}
    counted = ", ".join(f"{count} {STATUS_TEXTS.get(name, name)}" for name, count in counts.items() if count)
    places = "".join(f"{name.replace('_', ' ')}: {visible(path)}\n" for name, path in paths.items())
    return Ending(figures, f"{text}\n{visible(counted)}\n{places}", status)


def pair_table(rows: Sequence[Mapping[str, object]]) -> str:
    """Return the lines of the summary of a batch as a table."""
    return table(BATCH_COLUMNS, [_cells(row) for row in rows], NUMERIC_COLUMNS)


def _cells(row: Mapping[str, object]) -> list[str]:
    shift = [row["d_col_px"], row["d_row_px"]]
    cells = [
        Path(str(row["target"])).name,
        f"{row['status']}{' before' if row['done_before'] else ''}",
        str(row["tie_points"]) if row["tie_points"] is not None else "",
        f"{row['rmse_px']:.3f}" if isinstance(row["rmse_px"], float) else "",
        " ".join(f"{value:+.2f}" for value in shift if isinstance(value, float)),
        str(row["reason"] or row["out_dir"]),
    ]
    return [visible(cell) for cell in cells]
