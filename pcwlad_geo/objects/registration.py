"""The result of a whole job as an object, whose folder may be written later."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from pcwlad_geo import registration as inner
from pcwlad_geo.errors import RegistrationRejectedError
from pcwlad_geo.events import EventCallback, ignore
from pcwlad_geo.job import write_pair
from pcwlad_geo.objects.correction import Correction
from pcwlad_geo.objects.tie_points import TiePoints
from pcwlad_geo.options import Settings
from pcwlad_geo.pair_job import Command, OutputPlaces
from pcwlad_geo.raster.scratch import Scratch
from pcwlad_geo.report.finished import finished
from pcwlad_geo.types import PathLike

if TYPE_CHECKING:
    from typing_extensions import Self


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Registration(inner.Registration):
    """What a job found, written or not."""

    matches: inner.Matches | None = None
    """What the matching knows besides the tie points."""
    scratch: Scratch | None = None
    """The files of arrays, which live as long as this does."""
    asked: tuple[tuple[str, str], Settings] | None = None
    """Reference and target as they were named, and the options as they were given, if others than those of
    the result."""

    @classmethod
    def of(
        cls,
        result: inner.Registration,
        matches: inner.Matches | None = None,
        scratch: Scratch | None = None,
        asked: tuple[tuple[str, str], Settings] | None = None,
    ) -> Self:
        """Return the result of a job as an object of the interface."""
        values = {field.name: getattr(result, field.name) for field in fields(inner.Registration)}
        values["tie_points"] = TiePoints.of(result.tie_points, matches)
        return cls(**values, matches=matches, scratch=scratch, asked=asked)

    @property
    def correction(self) -> Correction | None:
        """The correction; None where the pair was refused, or only matched."""
        if self.model is None:
            return None
        return Correction(
            model=self.model,
            pair=finished(self),
            precision=self.selection,
            points=TiePoints.of(self.tie_points, self.matches),
            evidence=None if self.quality is None else (self.accuracy, self.quality),
            warnings=self.warnings,
            trust=self.settings.trust,
            keep=self.scratch,
        )

    def report(
        self,
        out_dir: PathLike,
        *,
        overwrite: bool = False,
        on_event: EventCallback = ignore,
        output_raster: PathLike | None = None,
        output_tiepoints: PathLike | None = None,
        output_report: PathLike | None = None,
        output_points: PathLike | None = None,
    ) -> Self:
        """Write the folder with report, tie points and registered raster, of a refused pair its report.

        Parameters are those of `register`. The folder of a pair that was only matched is that of
        ``pcwlad-geo match``. Rasters in memory are written to the folder ``<out_dir>_inputs`` first, as files
        of the results refer to them.

        Returns
        -------
        Registration
            The same, with its `outputs`: the files by kind.

        Raises
        ------
        OutputError
            If the results cannot be written; nothing is left half-written.
        InputError
            If an input was changed meanwhile.
        """
        places: OutputPlaces = {
            "out_dir": out_dir,
            "output_raster": output_raster,
            "output_tiepoints": output_tiepoints,
            "output_report": output_report,
            "output_points": output_points,
        }
        result: Registration = self
        asked = self.asked
        if self.scratch is not None and self.scratch.holds(self.reference.uri, self.target.uri):
            result = _with_files(self, self.scratch, Path(f"{Path(out_dir)}_inputs"), overwrite=overwrite)
            asked = None
        names, settings = asked or ((result.reference.uri, result.target.uri), result.settings)
        command: Command = "match" if self.status == "matched" else "register"
        try:
            written = write_pair(
                command,
                names,
                settings,
                places,
                overwrite=overwrite,
                on_event=on_event,
                registration=result,
            ).registration
        except RegistrationRejectedError as error:  # that is known, and its report is written
            written = cast(inner.Registration, error.registration)
        return replace(self, outputs=written.outputs, warnings=written.warnings)


def _with_files(result: Registration, scratch: Scratch, folder: Path, *, overwrite: bool) -> Registration:
    """Return a result whose rasters are files of a folder instead of a temporary place."""
    copies: dict[str, str] = {}

    def moved_to(uri: Any) -> Any:  # noqa: ANN401  # a path, a text or None
        if uri is None or not scratch.holds(os.fspath(uri)):
            return uri
        if os.fspath(uri) not in copies:
            copies[os.fspath(uri)] = scratch.copy(os.fspath(uri), folder, overwrite=overwrite)
        return copies[os.fspath(uri)]

    reference, target = (
        replace(info, uri=moved_to(info.uri), mask_uri=moved_to(info.mask_uri))
        for info in (result.reference, result.target)
    )
    masks = {name: moved_to(getattr(result.settings, name)) for name in ("ref_mask", "tgt_mask")}
    settings = replace(result.settings, **masks)
    return replace(result, reference=reference, target=target, settings=settings)
