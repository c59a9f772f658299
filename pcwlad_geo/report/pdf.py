"""A page as PDF, by WeasyPrint."""

from __future__ import annotations

import io
from contextlib import redirect_stdout
from types import ModuleType

from pcwlad_geo.errors import SettingsError
from pcwlad_geo.raster.gdal import ignoring


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
