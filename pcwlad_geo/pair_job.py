"""A pair that is registered or matched: its inputs, and where its outputs go."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, TypedDict

from pcwlad_geo.basemaps.composed import Composed, composed_as, resolvable
from pcwlad_geo.errors import SettingsError
from pcwlad_geo.options import Settings
from pcwlad_geo.outputs.files import outputs
from pcwlad_geo.outputs.folder import OutputFolder
from pcwlad_geo.outputs.places import check_outputs
from pcwlad_geo.products.finding import stem_of
from pcwlad_geo.raster import OutputFormat, file_name, plain_name
from pcwlad_geo.registration import Inputs, check_output, resolve
from pcwlad_geo.types import PathLike

if TYPE_CHECKING:
    from pcwlad_geo.products.product import ProductBand

Command = Literal["register", "match"]
Job = Literal["registered", "matched", "proof"]
JOB_OF: Final[Mapping[Command, Job]] = {"register": "registered", "match": "matched"}
"""How the output folder of a command is called by default, after the target."""


class OutputPlaces(TypedDict, total=False):
    """Where outputs go, as keywords."""

    out_dir: PathLike | None
    output_raster: PathLike | None
    output_tiepoints: PathLike | None
    output_report: PathLike | None
    output_points: PathLike | None


@dataclass(frozen=True, slots=True, eq=False)
class PairJob:
    """A pair that is registered or matched, and what is written of it."""

    command: Command
    names: tuple[str, str]
    """Reference and target as the user names them: paths, GDAL URIs or products."""
    composed: Composed | None
    """What is composed of the reference; None where it is a raster itself."""
    inputs: Inputs
    settings: Settings
    folder: Path
    inside: Mapping[str, Path]
    """Where each kind of output lies in the folder."""
    elsewhere: Mapping[str, Path]
    """Final places of the outputs that are wanted outside of it."""
    overwrite: bool

    @classmethod
    def of(
        cls,
        command: Command,
        names: tuple[str, str],
        settings: Settings,
        places: OutputPlaces,
        *,
        overwrite: bool,
    ) -> PairJob:
        """Find the inputs of a job, and the places of its outputs.

        Raises `InputError` if a product, or a band of it, is missing, or options contradict the places.
        """
        if settings.no_report and places.get("output_report") is not None:
            raise SettingsError("output_report names a page that no_report leaves out: give one of them")
        composed = composed_as(names[0])
        reference = resolvable(names[0], composed)
        inputs = resolve(reference, names[1], settings, all_bands=command == "register")
        folder = output_folder(names[1], JOB_OF[command], places.get("out_dir"))
        inside = output_paths(inputs.target_file, command, settings.of, folder)
        elsewhere = {
            name.removeprefix("output_"): Path(str(path))
            for name, path in places.items()
            if name != "out_dir" and path
        }
        outside = {kind: path for kind, path in elsewhere.items() if path != inside[kind]}
        return cls(command, names, composed, inputs, settings, folder, inside, outside, overwrite)

    @property
    def places(self) -> dict[str, Path]:
        """The final place of each kind of output."""
        return {**self.inside, **self.elsewhere}

    @property
    def files(self) -> list[PathLike | None]:
        """The files that it reads, and what else its inputs are named by."""
        return [*self.names, *self.settings.files]

    def band_paths(self, folder: OutputFolder) -> dict[ProductBand, Path]:
        """Return where the other bands of the target's product are written."""
        extension = OutputFormat.of(self.settings.of, self.settings.co).extension
        return {
            band: folder.path(plain_name(f"{Path(file_name(band.uri)).stem}_registered.{extension}"))
            for band in self.inputs.other_bands
        }

    def check_outputs(self) -> None:
        """Raise `InputError`, `SettingsError` or `OutputError` where an output cannot be made."""
        if self.settings.pdf:
            from pcwlad_geo.report.pdf import check_pdf

            check_pdf()
        check_outputs([*self.places.values()], self.files)
        check_outputs([*self.elsewhere.values()], overwrite=self.overwrite)
        OutputFormat.of(self.settings.of, self.settings.co)
        if self.command == "register" and self.composed is None:
            check_output(self.inputs)


def output_paths(target: PathLike, command: Command, driver: str, folder: Path) -> dict[str, Path]:
    """Return where each kind of output lies in a folder that a command may write.

    Files are named after the `target`, the band's file of a product, and the registered raster has the format
    `driver`.
    """
    name = plain_name(file_name(os.fspath(target)))
    stem, ending = Path(name).stem, OutputFormat(driver).extension
    return {
        output.kind: folder / output.name.format(name=name, stem=stem, ending=ending)
        for output in outputs()
        if command == "register" or not output.when.corrected
    }


def output_folder(target: PathLike, job: Job, out_dir: PathLike | None = None) -> Path:
    """Return `out_dir`, or the default output folder of a job, in the working folder."""
    return Path(out_dir or f"{plain_name(stem_of(target))}_{job}")
