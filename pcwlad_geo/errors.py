"""The exceptions; every message says what was found, where, and what to do."""

from typing import Any


class PcwladGeoError(Exception):
    """Base class of all errors that pcwlad-geo raises."""

    exit_status = 1


class InputError(PcwladGeoError):
    """The input (file, band, mask, option, array) cannot be used."""

    exit_status = 2


class TrustError(InputError):
    """The input refers to files or servers that the user has not allowed to be opened."""


class SettingsError(InputError):
    """An option has an invalid value."""


class OutputError(PcwladGeoError):
    """A result cannot be written (permissions, full disk, existing results)."""

    exit_status = 2


class ExecutionError(PcwladGeoError):
    """The worker processes, the executor or the scheduler of a job cannot be used or were lost."""

    exit_status = 2


class _NoResultError(PcwladGeoError):
    """A job that ran to its end without the result asked for.

    Parameters
    ----------
    message : str
        The reason, and what to do about it.
    registration : object, optional
        The `Registration`: its status, tie points and figures.
    out_dir : pathlib.Path, optional
        Folder in which the report was written, if it was.
    """

    def __init__(self, message: str, registration: object = None, out_dir: object = None) -> None:
        super().__init__(message)
        self.registration = registration
        self.out_dir = out_dir

    @property
    def tie_points(self) -> Any:  # noqa: ANN401  # TiePoints, which this cannot import
        """The tie points that were found, as `TiePoints`; None where there are none."""
        return getattr(self.registration, "tie_points", None)


class RegistrationRejectedError(_NoResultError):
    """The pair could not be registered reliably, so no correction is given."""

    exit_status = 3


class RequirementError(_NoResultError):
    """The pair was registered (or matched), but a requirement on its figures is not met."""

    exit_status = 4


class CancelledError(PcwladGeoError):
    """The run was cancelled by its caller."""

    exit_status = 130
