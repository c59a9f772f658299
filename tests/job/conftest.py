"""No test of this room looks at the pictures of its reports: those of tests/report and of the commands do."""

from tests.pictures import without_pictures

__all__ = ["without_pictures"]
