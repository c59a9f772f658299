"""From arrays to tie points, without files and CRS; here what options name, without arrays."""

from __future__ import annotations

from typing import Literal

Method = Literal["oriented", "gradient", "pcwlad", "pclad", "pclsm", "coarse"]
Keypoints = Literal["cells", "strongest"]
Consensus = Literal["auto", "off"]
