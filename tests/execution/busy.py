"""A module whose import does not end: what a process loads that is busy."""

import time

from tests.patience import FOR_EVER_S

time.sleep(FOR_EVER_S)
