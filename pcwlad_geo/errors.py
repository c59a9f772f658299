"""The exception tree: every message says what was found, where, and what to do."""


class PcwladGeoError(Exception):
    """Base of all errors that pcwlad-geo raises on purpose."""

    exit_status = 1


class InputError(PcwladGeoError):
    """The input (file, band, mask, option, array) cannot be used."""

    exit_status = 2


class TrustError(InputError):
    """The input would make files or servers be opened that the user has not allowed."""


class SettingsError(InputError):
    """An option has a value that makes no sense."""


class OutputError(PcwladGeoError):
    """A result cannot be written (permissions, full disk, existing results)."""

    exit_status = 2


class ExecutionError(PcwladGeoError):
    """What a job runs on cannot be used or was lost: worker processes, an executor, a scheduler."""

    exit_status = 2


class RegistrationRejectedError(PcwladGeoError):
    """The pair could not be registered reliably, so no correction is given.

    Parameters
    ----------
    message : str
        The reason, and what to do about it.
    registration : object, optional
        The `Registration` with status ``"rejected"``: its tie points and figures.
    out_dir : pathlib.Path, optional
        Where the report of the refusal was written, if it was.
    """

    exit_status = 3

    def __init__(self, message: str, registration: object = None, out_dir: object = None) -> None:
        super().__init__(message)
        self.registration = registration
        self.out_dir = out_dir


class RequirementError(PcwladGeoError):
    """The pair was registered (or matched), but a requirement on its figures is not met.

    Parameters
    ----------
    message : str
        The requirements that are not met, with the figures.
    registration : object, optional
        The `Registration`: its `requirements` say what became of each.
    out_dir : pathlib.Path, optional
        Where the report was written; the corrected files only where they were to be kept.
    """

    exit_status = 4

    def __init__(self, message: str, registration: object = None, out_dir: object = None) -> None:
        super().__init__(message)
        self.registration = registration
        self.out_dir = out_dir


class CancelledError(PcwladGeoError):
    """The run was cancelled by its caller."""

    exit_status = 130
