"""The maker of registrations, and pages of text alone, as fixtures."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from pcwlad_geo.registration import Registration
from tests.pictures import text_alone
from tests.registrations import make_registration

__all__ = ["registration", "text_alone"]


@pytest.fixture
def registration() -> Callable[..., Registration]:
    """Maker of registrations."""
    return make_registration
